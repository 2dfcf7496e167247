# SPDX-License-Identifier: Apache-2.0
"""docking_node on mocks that misbehave: every failure ends with its code and reason, and the contactor open.

One charger serves all scenarios; between them it undocks. The launch test does this in separate processes.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.parameter import Parameter

from deltacharger_records.replay.recorder import Recorder
from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.mocks import mock_tactile_node
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, new_namespace
from ..marks import rest

pytestmark = pytest.mark.ros

PLACE = Pose(0.0, 0.0, 0.080)
MOCKS = ("mock_servo_node", "mock_tactile_node", "mock_detector_node")


class Charger:
    """The charger under test and its client."""

    def __init__(self, scene: Scene, context: Any) -> None:
        self.fault = "none"
        self.namespace = new_namespace()
        self.context = context
        self.composition = Composition(scene, context, self.namespace)
        self.client = ChargerClient(self.namespace, context)
        self.composition.start()
        assert self.client.wait_until_ready(DEADLINE)

    def set_fault(self, node: str, fault: str) -> None:
        self.fault = fault
        result = self.composition.node(node).set_parameters([Parameter("fault", value=fault)])[0]
        assert result.successful, result.reason

    def dock(self, request: DockRequest | None = None, **options: Any) -> Outcome:
        """Dock; if a stalled mock arm spoilt the estimate, which is retriable, try once more as a fleet would."""
        goal = request or DockRequest(PLACE)
        outcome = self.client.dock(goal, deadline=DEADLINE, **options)
        if outcome.error_name == "ESTIMATE_UNSURE" and self.fault != "unsure":
            outcome = self.client.dock(goal, deadline=DEADLINE, **options)
        return outcome

    def heal(self) -> bool:
        """Return whether it is ready for the next scenario."""
        for node in MOCKS:
            self.set_fault(node, "none")
        self.composition.node("mock_servo_node").reboot()
        return self.client.undock(deadline=DEADLINE).success

    def close(self) -> None:
        self.composition.close()
        self.client.close()


@pytest.fixture(scope="module")
def shared(quick_scene: Scene, context: Any) -> Iterator[list[Charger]]:
    """The charger of all scenarios; empty after one that broke it, so that the next one starts a new charger."""
    chargers: list[Charger] = []
    yield chargers
    for charger in chargers:
        charger.close()


@pytest.fixture
def charger(shared: list[Charger], quick_scene: Scene, context: Any) -> Iterator[Charger]:
    if not shared:
        shared.append(Charger(quick_scene, context))
    yield shared[0]
    if not shared[0].heal():
        shared.pop().close()


def open_contactor(charger: Charger) -> bool:
    return not charger.composition.node("mock_tactile_node").contactor_closed


def test_docking_charges_and_reports_it_and_undocking_ends_it(charger: Charger) -> None:
    seen: list[Progress] = []
    with Recorder(charger.context, charger.namespace) as recorder:

        def on_progress(progress: Progress) -> None:
            seen.append(progress)
            recorder.on_progress(progress)

        outcome = charger.dock(on_progress=on_progress)
        recorder.finish(outcome)
    assert outcome.success, outcome
    assert (outcome.error_code, outcome.error_name) == (0, "NONE")
    assert 0.4 <= outcome.details["contact_current"] <= 0.5
    assert outcome.details["charge_current"] > 0.5
    assert {"approach", "contact", "measure", "energise"} <= {progress.phase for progress in seen}
    assert {"predict_misalignment", "probe"} <= {progress.waiting_for for progress in seen}
    assert "redockings" in outcome.details
    assert not open_contactor(charger)
    run = recorder.run
    assert run.frames is not None
    assert run.motion.arrays()["z"].max() == pytest.approx(0.0809, abs=2e-3)
    assert run.power.arrays()["current"].max() > 0.5
    again = charger.dock()
    assert again.success, "docking when docked succeeds"
    undocked = charger.client.undock(deadline=DEADLINE)
    assert undocked.success, undocked
    assert open_contactor(charger)


def test_without_coordinates_the_camera_locates_the_target(charger: Charger) -> None:
    outcome = charger.dock(DockRequest(None, start_charging=False))
    assert outcome.success, outcome
    assert outcome.details["charge_current"] < 0.1
    assert open_contactor(charger)


@pytest.mark.parametrize(
    ("node", "fault", "names"),
    [
        ("mock_servo_node", "silence", {"SERVO_FAULT"}),
        rest("mock_servo_node", "nan_current", {"SERVO_FAULT"}),
        rest("mock_servo_node", "missing", {"SERVO_FAULT"}),
        ("mock_servo_node", "hardware_error", {"SERVO_FAULT"}),
        ("mock_tactile_node", "silence", {"TACTILE_STALE"}),
        rest("mock_tactile_node", "zero_frames", {"NO_TACTILE_CONTACT"}),
        rest("mock_tactile_node", "unsure", {"ESTIMATE_UNSURE"}),
        ("mock_tactile_node", "power_silence", {"POWER_STALE"}),
        ("mock_tactile_node", "short", {"SHORT_CIRCUIT"}),
        rest("mock_tactile_node", "open_circuit", {"NO_CHARGE_CURRENT"}),
        rest("mock_tactile_node", "reverse_polarity", {"REVERSE_POLARITY"}),
        rest("mock_tactile_node", "no_charge_current", {"NO_CHARGE_CURRENT"}),
    ],
)
def test_a_fault_ends_docking_with_its_code_and_an_open_contactor(
    charger: Charger, node: str, fault: str, names: set[str]
) -> None:
    charger.set_fault(node, fault)
    outcome = charger.dock()
    assert not outcome.success
    assert outcome.error_name in names, outcome
    assert outcome.error_message
    assert open_contactor(charger)


def test_a_battery_out_of_range_in_charger_power_keeps_the_contactor_open(
    charger: Charger, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mock_tactile_node, "BATTERY", 20.0)
    outcome = charger.dock()
    assert outcome.error_name == "VOLTAGE_OUT_OF_RANGE", outcome
    assert "own battery has 20.0 V" in outcome.error_message
    assert open_contactor(charger)


@pytest.mark.parametrize(
    ("fault", "name"),
    [
        ("nothing", "ELECTRODES_NOT_FOUND"),
        ("stale", "DETECTION_STALE"),
        ("beyond_reach", "UNREACHABLE"),
        ("unsure_roll", "CRITICAL_ANGLE"),
        ("leaning", "LEANING"),
    ],
)
def test_a_bad_detection_is_refused_before_anything_moves(charger: Charger, fault: str, name: str) -> None:
    before = charger.composition.node("mock_servo_node").position
    charger.set_fault("mock_detector_node", fault)
    outcome = charger.dock(DockRequest(None))
    assert outcome.error_name == name, outcome
    assert charger.composition.node("mock_servo_node").position == pytest.approx(before, abs=1e-3)
    if name == "LEANING":
        assert outcome.details["suggested_base_pose"]["yaw"] == pytest.approx(math.radians(10.0))
        assert "to the left" in outcome.error_message


def test_a_refused_contactor_is_reported_with_the_boards_message(charger: Charger) -> None:
    charger.set_fault("mock_tactile_node", "contactor_refusal")
    outcome = charger.dock()
    assert not outcome.success
    assert "interlock" in outcome.error_message, outcome
    assert open_contactor(charger)


def test_a_cancelled_docking_ends_as_canceled_with_an_open_contactor(charger: Charger) -> None:
    cancel = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == "contact":
            cancel.set()

    outcome = charger.dock(on_progress=on_progress, cancel=cancel)
    assert (outcome.success, outcome.error_name) == (False, "CANCELED"), outcome
    assert open_contactor(charger)


def test_a_deadline_cancels(charger: Charger) -> None:
    outcome = charger.client.dock(DockRequest(PLACE), deadline=0.5)
    assert outcome.error_name == "CANCELED", outcome


def test_closing_the_charger_opens_the_contactor_and_makes_the_arm_safe(quick_scene: Scene, context: Any) -> None:
    charger = Charger(quick_scene, context)
    servos = charger.composition.node("mock_servo_node")
    pads = charger.composition.node("mock_tactile_node")
    states: list[tuple[bool, bool]] = []
    closing = type(pads).close

    def record_then_close(node: Any) -> None:
        states.append((pads.contactor_closed, servos.torque_enabled))
        closing(node)

    try:
        assert charger.dock().success
        pads.close = lambda: record_then_close(pads)
    finally:
        charger.close()
    assert states[0] == (False, False), "docking_node had made both safe before tactile_node closed"


def test_without_a_charger_the_client_reports_it(context: Any) -> None:
    with ChargerClient(new_namespace(), context) as client:
        stop = threading.Event()
        stop.set()
        assert not client.wait_until_ready(10.0, stop)
        with pytest.raises(ClientError, match="deltacharger up"):
            client.dock(DockRequest(PLACE), cancel=stop)
