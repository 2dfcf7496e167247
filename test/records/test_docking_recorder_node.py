# SPDX-License-Identifier: Apache-2.0
"""A docking recorded by the node, replayed and compared with its client's result."""

import sys
from pathlib import Path
from typing import Any

import pytest

from ..chargers import Spin, wait_until
from ..nodes import options

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import DockingDecision
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from deltacharger_bringup.records.recording.docking_recorder_node import DockingRecorderNode
from deltacharger_bringup.records.recording.folder import PARTIAL
from deltacharger_bringup.records.replay.record import Replay, replay
from deltacharger_bringup.records.replay.words import why
from deltacharger_bringup.scenes.scene import RECORDER, Scene, with_recorder
from deltacharger_core.ros import log, messages, outcomes

from ..running_charger import RunningCharger

pytestmark = pytest.mark.ros

PLACE = outcomes.Pose(0.0, 0.0, 0.080)


class Recorded(RunningCharger):
    """A charger of mocks with its recorder."""

    def __init__(self, scene: Scene, context: Any, folder: Path) -> None:
        self.folder = folder
        self.decisions: list[str] = []
        super().__init__(with_recorder(scene, str(folder)), context)
        node = self.client.node
        topic = f"/{self.namespace}/docking_decision"
        node.create_subscription(DockingDecision, topic, lambda message: self.decisions.append(message.kind), 50)
        wait_until(lambda: node.count_publishers(topic) and node.count_subscribers(topic) > 1, "the recorder")

    def record(self, request: str, ending: str) -> Replay:
        """Return the complete record of a request with this ending, once there is no open one."""

        def complete() -> list[Path]:
            if any(path.name.endswith(PARTIAL) for path in self.folder.iterdir()):
                return []
            return sorted(self.folder.glob(f"*-{request}-{ending}*"))

        return replay(wait_until(complete, "a record")[-1])


@pytest.mark.version
@pytest.mark.witness
def test_a_docking_is_recorded_as_its_client_saw_it(quick_scene: Scene, context: Any, tmp_path: Path) -> None:
    seen: list[outcomes.Progress] = []
    with Recorded(quick_scene, context, tmp_path) as cell:
        outcome = cell.dock(outcomes.DockRequest(PLACE, request_id="robot/7"), seen.append)
        assert outcome.success, outcome
        cell.go_home()
        found = cell.record("robot_7", "OK")
    recorded = found.result_of("dock")
    assert recorded is not None
    assert recorded.as_dict() == outcome.as_dict()
    assert (found.is_complete, found.request_id, found.about["scene"]) == (True, "robot/7", "quick")
    phases = [phase.state for phase in found.phases]
    heard = [messages.PHASES[state.state] for state in cell.states]
    assert [name for name, before in zip(heard, ["idle", *heard], strict=False) if name != before] == phases[1:]
    reported = [progress.phase for progress in seen if progress.phase != "idle"]
    changes = [phase for phase, before in zip(reported, ["", *reported], strict=False) if phase != before]
    assert changes == phases[phases.index("approach") : phases.index("charging") + 1], "the client saw every state"
    assert [each.kind for each in found.decisions] == cell.decisions
    assert found.parameters.travel_speed == 0.5
    assert 0.4 <= found.contact.arrays()["current"].max() <= 1.0  # what a stalled arm may overshoot to
    assert found.touches
    assert found.touches[-1].frames is not None
    assert found.motion.arrays()["time"][0] < 0.0, "it begins before the goal"
    assert why(found).startswith("Docked and charging in ")


@pytest.mark.rest
def test_a_charger_completes_its_record_when_it_ends(quick_scene: Scene, context: Any, tmp_path: Path) -> None:
    with Recorded(quick_scene, context, tmp_path) as cell:
        goal = cell.begin("contact", lambda: cell.dock(outcomes.DockRequest(PLACE, request_id="ends")))
        assert cell.composition is not None
        cell.composition.close()
        assert goal.result(60.0).error_name == "CANCELED"
        found = cell.record("ends", "CANCELED")
    assert not found.recording.damage
    assert "contact" in {phase.state for phase in found.phases}


def test_without_mcap_the_node_runs_and_names_what_to_install(
    context: Any, namespace: str, spin: Spin, monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[DiagnosticStatus] = []
    listener = spin(Node("listener", **options(context)))
    listener.create_subscription(DiagnosticArray, "/diagnostics", lambda message: heard.extend(message.status), 10)
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    logged: list[str] = []
    monkeypatch.setattr(log.Log, "error", lambda self, line, pause=0.0: logged.append(line))
    node = spin(DockingRecorderNode(**options(context, namespace)))
    found = wait_until(lambda: [each for each in heard if each.name == f"{namespace}/{RECORDER}: recording"], "status")
    assert (found[0].level, found[0].message, logged) == (DiagnosticStatus.ERROR, node.problem, [node.problem])
    assert "install deltacharger[record]" in node.problem
