# SPDX-License-Identifier: Apache-2.0
"""Faults of every family during real Dock goals: while the arm approaches, presses and charges.

One charger serves all goals; no node is restarted, which every goal after a fault confirms.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import pytest
from deltacharger.msg import DockingState, ServoState, TactileFrame
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from std_srvs.srv import Trigger

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import parse_scene
from deltacharger_sim.charger.faults import Fault

from .. import quick
from ..chargers import DEADLINE, new_namespace, wait_until
from ..nodes import call
from .fault_pulse import Pulse

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))
# Touch counts as aligned after one docking; alignment is not tested here.
STEPS = {**quick.STEPS, "overlap_loss_max": 0.02, "landing_limit": 0.02}
BY_ITSELF = ("servo_missing", "servo_overload")  # a servo loses its torque at once: no driver can open before that
BORNE = "NONE"  # the fault is tolerated


PHASES = ("approach", "contact", "charging")


@dataclass(frozen=True)
class Family:
    """One fault and the possible codes of a goal when it occurs in each phase."""

    kind: str
    approach: str | tuple[str, ...]
    contact: str
    charging: str
    amount: float | None = None
    recovery: str = ""


FAMILIES = (
    Family("servo_missing", "SERVO_FAULT", "SERVO_FAULT", "SERVO_FAULT"),
    Family("servo_overload", "SERVO_FAULT", "SERVO_FAULT", "SERVO_FAULT", recovery="reboot_servos"),
    Family("servo_unplugged", "SERVO_FAULT", "SERVO_FAULT", "SERVO_FAULT"),
    # The approach begins with a tare: a reboot before it has no effect, a later one is detected.
    Family("board_reboot", (BORNE, "TACTILE_STALE"), "TACTILE_STALE", "POWER_STALE"),
    Family("board_unplugged", "TACTILE_STALE", "TACTILE_STALE", "POWER_STALE"),
    Family("board_trip", BORNE, BORNE, "OVERCURRENT", amount=9.0),
    Family("board_corrupt", BORNE, BORNE, BORNE, amount=0.01),
    Family("servo_watchdog", BORNE, BORNE, BORNE),
)


QUICK = {("contact", "servo_missing"), ("charging", "servo_overload"), ("charging", "board_unplugged")}
CELLS = [
    pytest.param(
        phase, each, id=f"{phase}-{each.kind}", marks=[] if (phase, each.kind) in QUICK else [pytest.mark.rest]
    )
    for phase in PHASES
    for each in FAMILIES
]


class Charger:
    """A simulated charger with all parts, and its client."""

    def __init__(self, composition: Composition, client: ChargerClient) -> None:
        assert composition.charger is not None
        self.simulated = composition.charger
        self.client = client
        self.pulse = Pulse()
        self.state = DockingState()  # until the first message
        self._servo: Any = None
        self._frame: Any = None
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        client.node.create_subscription(DockingState, "docking_state", self._on_state, latched)
        client.node.create_subscription(ServoState, "servo_state", self._on_servo, QoSProfile(depth=1))
        client.node.create_subscription(TactileFrame, "tactile_frame", self._on_frame, qos_profile_sensor_data)
        self._reboot = client.node.create_client(Trigger, "reboot_servos")

    def dock_with_fault(self, fault: Fault, phase: str) -> Outcome:
        """Dock, and cause `fault` when `phase` begins; in charging, after success."""
        once = threading.Event()

        def on_progress(progress: Progress) -> None:
            if progress.phase == phase and not once.is_set():
                once.set()
                self.begin(fault)

        outcome = self.client.dock(GOAL, on_progress, deadline=100.0)
        if phase == "charging":
            assert outcome.success, outcome
            self.begin(fault)
        else:
            assert once.is_set(), f"{phase} was never entered: {outcome}"
        return outcome

    def begin(self, fault: Fault) -> None:
        assert self.simulated.faults is not None
        self.simulated.faults.begin(fault)

    def recover(self, service: str) -> None:
        """End the fault, perform a person's recovery, and wait until everything works again."""
        assert self.simulated.faults is not None
        self.simulated.faults.clear()
        if service:
            wait_until(self._is_rebooted, f"{service} to succeed")
        self._servo = self._frame = None
        wait_until(lambda: self._servo and all(self._servo.valid) and self._frame, "servos and frames")

    def _is_rebooted(self) -> bool:
        return bool(call(self._reboot, Trigger.Request()).success)

    def assert_safe(self) -> None:
        """True state: the contactor opened before torque was lost and before the electrodes parted, without shorts."""
        record = self.simulated.world.record
        assert not self.simulated.world.snapshot().contactor_closed
        assert record.energised_shorts == 0
        assert record.energised_unsafe == 0.0
        assert record.parted_live == 0

    def _on_state(self, message: DockingState) -> None:
        self.state = message

    def _on_servo(self, message: ServoState) -> None:
        self._servo = message

    def _on_frame(self, message: TactileFrame) -> None:
        self._frame = message

    def restore(self) -> None:
        """Undo a failed attempt, so that the next one begins normally."""
        if any(self._servo.hardware_error):
            self.recover("reboot_servos")
        else:
            self.recover("")
        wait_until(lambda: self.client.undock(deadline=60.0).success, "the arm back home")


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Charger]:
    namespace = new_namespace()
    scene = parse_scene({**quick.SCENE, "parameters": {"docking_node": STEPS}}, "faults")
    with Composition(scene, context, namespace) as composition, ChargerClient(namespace) as client:
        assert client.wait_until_ready(DEADLINE)
        charger = Charger(composition, client)
        yield charger
        charger.pulse.close()


@pytest.mark.parametrize(("phase", "family"), CELLS)
def test_a_goal_under_a_fault(charger: Charger, family: Family, phase: str) -> None:
    """Recovery means: the previous goal had its fault, and nothing was restarted since."""
    charger.pulse.attempt(lambda: check_goal(charger, family, phase), charger.restore)


def check_goal(charger: Charger, family: Family, phase: str) -> None:
    fault = Fault(kind=family.kind, amount=family.amount)
    record = charger.simulated.world.record
    lost_before, expected = record.unpowered_live, getattr(family, phase)
    codes = (expected,) if isinstance(expected, str) else expected
    outcome = charger.dock_with_fault(fault, phase)
    ended, message = outcome.error_name, outcome.error_message
    if phase == "charging" and BORNE not in codes:
        wait_until(lambda: charger.state.error_code, f"{codes} in docking_state")
        wait_until(lambda: charger.state.state == DockingState.STATE_IDLE, "the arm back")
        ended, message = CODES[charger.state.error_code], charger.state.error_message
    charger.recover(family.recovery)
    if ended == BORNE:
        assert charger.client.undock(deadline=60.0).success
    assert message or ended == BORNE
    charger.assert_safe()
    assert record.unpowered_live - lost_before <= (family.kind in BY_ITSELF)
    assert ended in codes, f"{ended}: {message}"


def test_after_all_faults_it_docks_and_undocks(charger: Charger) -> None:
    assert charger.client.dock(GOAL, deadline=100.0).success
    assert charger.client.undock(deadline=60.0).success
    charger.assert_safe()
