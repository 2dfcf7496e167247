# SPDX-License-Identifier: Apache-2.0
"""A foreign node with random messages at every topic and service of a simulated charger does no harm.

Drivers, bytes and nodes are real, the world is simulated and shows the true state. If the foreign node interferes
with docking's inputs, no contactor closes. Elsewhere a docking may succeed or fail, with a code and without an
internal error. Current never flows where it must not. The next goal is served.
"""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import pytest
from deltacharger.action import Dock, Undock
from deltacharger.msg import ChargerPower, DockingState, ServoState, TactileFrame
from deltacharger.srv import (
    PredictMisalignment,
    Probe,
    SetContactor,
    SolveForwardKinematics,
    SolveInverseKinematics,
)
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_ros.qos import STATE
from deltacharger_scenes.composition import Composition

from ..chargers import DEADLINE, new_namespace, wait_until
from ..marks import rest
from ..quick import quick_simulation
from .strangers import Stranger, lie

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))
Wire: TypeAlias = Callable[[Stranger], None]
Come: TypeAlias = Callable[[Wire], Stranger]

ACTS = 100  # of a foreign node while electrodes are live
WAITS = {"duplicate_source_timeout": 0.5}
TOPICS = {
    "servo_state": ServoState,
    "tactile_frame": TactileFrame,
    "charger_power": ChargerPower,
    "joint_trajectory": JointTrajectory,
}
SERVICES = {
    "predict_misalignment": PredictMisalignment,
    "probe": Probe,
    "set_contactor": SetContactor,
    "set_torque": SetBool,
    "tare": Trigger,
}
ASKED = {
    **SERVICES,
    "reboot_servos": Trigger,
    "solve_inverse_kinematics": SolveInverseKinematics,
    "solve_forward_kinematics": SolveForwardKinematics,
}


class Charger:
    """A simulated charger, its client, and its world's records."""

    def __init__(self, context: Any) -> None:
        self.namespace = new_namespace()
        self.context = context
        self.composition = Composition(quick_simulation("simulated", WAITS), context, self.namespace).start()
        self.client = ChargerClient(self.namespace, context)
        self.codes: set[int] = set()
        self.client.node.create_subscription(
            DockingState, "docking_state", lambda state: self.codes.add(state.error_code), STATE
        )
        assert self.client.wait_until_ready(DEADLINE)

    @property
    def world(self) -> Any:
        assert self.composition.charger is not None
        return self.composition.charger.world

    def assert_unharmed(self) -> None:
        record = self.world.record
        assert record.parted_live == 0, "electrodes were torn apart while live"
        assert record.energised_shorts == 0
        assert record.energised_unsafe == 0.0
        assert self.composition.failed() == []

    def serves(self, ask: Callable[[], Outcome]) -> None:
        """Send requests until one succeeds, as a fleet would; a response may be lost while a node leaves the graph."""

        def served() -> bool:
            with contextlib.suppress(ClientError):
                return ask().success
            return False

        wait_until(served, "the next goal's success")

    def goes_home(self) -> None:
        self.serves(lambda: self.client.undock(deadline=DEADLINE))
        assert not self.world.snapshot().contactor_closed

    def close(self) -> None:
        self.composition.close()
        self.client.close()


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Charger]:
    charger = Charger(context)
    yield charger
    charger.close()


@pytest.fixture
def stranger(charger: Charger) -> Iterator[Come]:
    """Add a foreign node, with the given behaviour; remaining ones are removed at the end."""
    came: list[Stranger] = []

    def come(wire: Wire) -> Stranger:
        came.append(Stranger(charger.context, charger.namespace, seed=len(came)))
        wire(came[-1])
        return came[-1].begin()

    yield come
    for each in came:
        each.leave()


def dock_beside(charger: Charger, come: Come, wire: Wire) -> tuple[Outcome, float]:
    """Dock beside a foreign node, then without it, and add it again while current flows.

    Returns:
        Outcome of the first docking, and time (s) for which current flowed during it.
    """
    energised = charger.world.record.energised
    visitor = come(wire)
    outcome = charger.client.dock(GOAL, deadline=DEADLINE)
    current = charger.world.record.energised - energised
    visitor.leave()
    charger.assert_unharmed()
    charger.goes_home()
    charger.serves(lambda: charger.client.dock(GOAL, deadline=DEADLINE))
    assert charger.world.snapshot().contactor_closed
    visitor = come(wire)
    wait_until(lambda: visitor.acts >= ACTS, "the stranger's acts")
    visitor.leave()
    charger.assert_unharmed()
    charger.goes_home()
    assert outcome.error_name != "INTERNAL", outcome
    assert Dock.Result.INTERNAL not in charger.codes
    return outcome, current


@pytest.mark.parametrize("topic", [rest(name) for name in TOPICS])
def test_no_contactor_closes_beside_a_second_publisher(charger: Charger, stranger: Come, topic: str) -> None:
    outcome, current = dock_beside(charger, stranger, lambda each: each.speaks(TOPICS[topic], topic))
    assert not outcome.success
    assert current == 0.0


@pytest.mark.parametrize("service", [name if name == "predict_misalignment" else rest(name) for name in SERVICES])
def test_no_contactor_closes_beside_a_second_server(charger: Charger, stranger: Come, service: str) -> None:
    outcome, current = dock_beside(charger, stranger, lambda each: each.answers(SERVICES[service], service))
    assert not outcome.success
    assert current == 0.0


@pytest.mark.parametrize("service", [rest(name) for name in ASKED])
def test_absurd_service_calls_do_no_harm(charger: Charger, stranger: Come, service: str) -> None:
    dock_beside(charger, stranger, lambda each: each.asks(ASKED[service], service))


@pytest.mark.rest
@pytest.mark.parametrize("action", [Dock, Undock])
def test_random_goals_do_no_harm(charger: Charger, stranger: Come, action: Any) -> None:
    dock_beside(charger, stranger, lambda each: each.sends_goals(action, action.__name__.lower()))


def test_random_messages_cover_all_kinds() -> None:
    dice = random.Random(1)
    points = [point for _ in range(100) for point in lie(JointTrajectory, dice).points]
    assert any(len(point.positions) == 3 for point in points)
    messages = [lie(ServoState, dice) for _ in range(100)]
    assert {len(message.position) for message in messages} >= {0, 1, 3, 100}
    assert any(message.header.stamp.sec < 0 for message in messages)
    assert any(len(message.header.frame_id) > 1000 for message in messages)
