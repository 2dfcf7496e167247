# SPDX-License-Identifier: Apache-2.0
"""Dockings recorded by the node, replayed and compared with their clients' results. One charger serves all tests."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from ..chargers import DEADLINE, new_namespace, wait_until
from .docking_tapes import patient

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import DockingDecision, DockingState
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_records.recording.docking_recorder_node import DockingRecorderNode
from deltacharger_records.recording.own import PARTIAL
from deltacharger_records.replay.record import Replay, replay
from deltacharger_records.replay.words import why
from deltacharger_ros import qos
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.messages import PHASES
from deltacharger_ros.node_support import StartupError
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.overrides import RECORDER, recorder_alone, with_recorder
from deltacharger_scenes.scene import Scene

from ..marks import rest
from ..nodes import options

pytestmark = pytest.mark.ros

STRANGE = "20260101T000000Z-my_bag_of_yesterday.mcap"
PLACE = Pose(0.0, 0.0, 0.080)


class Cell:
    """A charger of mocks with its recorder, a client and a listener."""

    def __init__(self, scene: Scene, context: Any, folder: Path) -> None:
        self.folder = folder
        self.namespace = new_namespace()
        self.states: list[str] = []
        self.decisions: list[str] = []
        self.diagnostics: list[str] = []
        self.left_alone = ""
        self.composition = Composition(with_recorder(patient(scene), str(folder)), context, self.namespace)
        self.client = ChargerClient(self.namespace, context)
        node = Node("listener", **options(context, self.namespace))
        node.create_subscription(DockingState, "docking_state", self._on_state, qos.STATE)
        node.create_subscription(
            DockingDecision, "docking_decision", lambda message: self.decisions.append(message.kind), 50
        )
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._listener = Spinner(node)
        self.composition.start()
        assert self.client.wait_until_ready(DEADLINE)

    def _on_state(self, message: DockingState) -> None:
        if not self.states or self.states[-1] != PHASES[message.state]:
            self.states.append(PHASES[message.state])

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == f"{self.namespace}/{RECORDER}: recording":
                self.diagnostics.append(status.message)
                self.left_alone = {each.key: each.value for each in status.values}["left_alone"]

    def forget(self) -> None:
        self.states, self.decisions = self.states[-1:], []

    def heard(self) -> list[str]:
        """Return the decisions since the goal was accepted; late ones of an earlier undocking are left out."""
        return self.decisions[self.decisions.index("accepted") :]

    def record(self, request: str, ending: str) -> Replay:
        """Return the record of a request with this ending, once it is complete."""

        def complete() -> list[Path]:
            return sorted(
                path for path in self.folder.glob(f"*-{request}-{ending}*") if not path.name.endswith(PARTIAL)
            )

        return replay(wait_until(complete, "a record")[-1])

    def idle(self) -> None:
        """Wait until no record is open."""
        wait_until(lambda: not any(path.name.endswith(PARTIAL) for path in self.folder.iterdir()), "no open record")

    def undock(self) -> None:
        wait_until(lambda: self.client.undock(deadline=DEADLINE).success, "an arm at home")

    def close(self) -> None:
        self.client.close()
        self.composition.close()
        self._listener.close()


@pytest.fixture(scope="module")
def cell(quick_scene: Scene, context: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cell]:
    folder = tmp_path_factory.mktemp("records")
    (folder / STRANGE).write_text("mine")
    os.mkfifo(folder / "20260101T000000Z.mcap")
    made = Cell(quick_scene, context, folder)
    yield made
    made.close()


@pytest.fixture(autouse=True)
def quiet(request: pytest.FixtureRequest) -> Iterator[None]:
    """Leave the shared charger at home and its last record complete, even after a failed test."""
    yield
    if "cell" in request.fixturenames:
        shared: Cell = request.getfixturevalue("cell")
        for node in ("mock_servo_node", "mock_tactile_node", "mock_detector_node"):
            shared.composition.node(node).set_parameters([Parameter("fault", value="none")])
        shared.undock()
        shared.idle()


def assert_same(found: Replay, outcome: Outcome) -> None:
    """The record agrees with the client's outcome."""
    recorded = found.result_of("dock")
    assert recorded is not None
    assert recorded.as_dict() == outcome.as_dict()
    assert found.outcome()["code"] == outcome.error_code
    assert found.outcome()["message"] == outcome.error_message


def test_a_docking_is_recorded_as_its_client_saw_it(cell: Cell) -> None:
    seen: list[Progress] = []

    def dock() -> Outcome | None:
        cell.idle()
        cell.forget()
        seen.clear()
        outcome = cell.client.dock(DockRequest(PLACE, request_id="robot/7"), seen.append, deadline=DEADLINE)
        return outcome if outcome.success else None  # a mock arm that stalled spoils an estimate

    outcome = wait_until(dock, "a docking that succeeds")
    cell.undock()
    found = cell.record("robot_7", "OK")
    assert_same(found, outcome)
    assert found.is_complete
    assert found.request_id == "robot/7"
    assert "robot_7-OK" in found.recording.path.name
    phases = [phase.state for phase in found.phases]
    assert phases == cell.states
    reported = [progress.phase for progress in seen if progress.phase != "idle"]
    changes = [phase for phase, before in zip(reported, ["", *reported], strict=False) if phase != before]
    assert changes == phases[phases.index("approach") : phases.index("charging") + 1], "the client saw every state"
    assert [each.kind for each in found.run.decisions] == cell.heard()
    assert found.about["scene"] == "quick"
    assert found.parameters.travel_speed == 0.5
    assert 0.4 <= found.run.contact.arrays()["current"].max() <= 1.0  # what a stalled arm may overshoot to
    assert found.run.touches
    assert found.run.touches[-1].frames is not None
    assert found.run.motion.arrays()["time"][0] < 0.0, "it begins before the goal"
    assert why(found).startswith("Docked and charging in ")
    assert (cell.folder / STRANGE).read_text() == "mine"
    assert f"'{STRANGE}': docking_recorder_node did not write it" in cell.left_alone
    assert "'20260101T000000Z.mcap': it is a pipe" in cell.left_alone


@pytest.mark.parametrize(
    ("node", "fault", "name", "reason"),
    [
        rest("mock_tactile_node", "unsure", "ESTIMATE_UNSURE", "measurements were unsure"),
        ("mock_detector_node", "nothing", "ELECTRODES_NOT_FOUND", "move the robot"),
        ("mock_servo_node", "silence", "SERVO_FAULT", "servo_state"),
    ],
)
def test_the_record_of_a_refusal_states_the_reason(cell: Cell, node: str, fault: str, name: str, reason: str) -> None:
    cell.forget()
    cell.composition.node(node).set_parameters([Parameter("fault", value=fault)])
    outcome = cell.client.dock(DockRequest(None if "detector" in node else PLACE, request_id=fault), deadline=DEADLINE)
    cell.composition.node(node).set_parameters([Parameter("fault", value="none")])
    assert outcome.error_name == name, outcome
    found = cell.record(fault, name)
    assert_same(found, outcome)
    assert name in found.recording.path.name
    assert reason.lower() in why(found).lower()
    assert [each.kind for each in found.run.decisions] == cell.heard()


def test_an_unwritable_folder_stops_recording_but_not_docking(quick_scene: Scene, context: Any, tmp_path: Path) -> None:
    folder = tmp_path / "records"
    folder.write_text("in the way")
    cell = Cell(quick_scene, context, folder)
    try:
        goal = DockRequest(PLACE, start_charging=False)
        wait_until(lambda: cell.client.dock(goal, deadline=DEADLINE).success, "a docking")
        wait_until(lambda: any("recording ended" in text for text in list(cell.diagnostics)), "a diagnostic")
        cell.undock()
        assert not cell.composition.failed()
    finally:
        cell.close()


def test_a_charger_completes_its_record_when_it_ends(quick_scene: Scene, context: Any, tmp_path: Path) -> None:
    cell = Cell(quick_scene, context, tmp_path)
    ended: list[Outcome] = []
    reached = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == "contact":
            reached.set()

    goal = threading.Thread(
        target=lambda: ended.append(
            cell.client.dock(DockRequest(PLACE, request_id="ends"), on_progress, deadline=DEADLINE)
        )
    )
    goal.start()
    try:
        assert reached.wait(DEADLINE)
        cell.composition.close()
        goal.join(DEADLINE)
        assert ended[0].error_name == "CANCELED", ended
        assert "shutting down" in ended[0].error_message
    finally:
        cell.close()
    found = cell.record("ends", "CANCELED")
    assert not found.recording.damage
    assert "contact" in {phase.state for phase in found.phases}


def test_without_mcap_the_message_states_how_to_install_it(
    context: Any, namespace: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(StartupError, match=r"deltacharger\[record\]"):
        DockingRecorderNode(**options(context, namespace))


def test_a_scene_without_a_recorder_starts_none(quick_scene: Scene) -> None:
    assert RECORDER not in quick_scene.nodes
    assert with_recorder(quick_scene, None) is quick_scene
    scene = with_recorder(quick_scene, "/records")
    assert scene.node_parameters(RECORDER, {}) == {"scene": "quick", "folder": "/records"}
    assert scene.start_order()[-2:] == [RECORDER, "docking_node"], "docking_node closes first, and is still recorded"
    assert recorder_alone(quick_scene, "/records").nodes == (RECORDER,)
