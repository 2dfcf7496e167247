# SPDX-License-Identifier: Apache-2.0
"""Arguments that change a scene, equal for `deltacharger up` and charger.launch.py, and refused ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.overrides import RECORDER, Overrides, override
from deltacharger_scenes.scene import SceneError, load_scene

HARDWARE = "ports: {servo: /dev/no_servo, board: /dev/no_board}\nparameters: {servo_node: {port: /dev/own, rate: 50.0}}"


@pytest.fixture
def hardware(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text(HARDWARE, encoding="utf-8")
    return path


def test_given_ports_override_the_scenes_and_the_nodes(hardware: Path, tmp_path: Path) -> None:
    servo, board = tmp_path / "servo", tmp_path / "board"
    servo.touch()
    board.touch()
    scene = override(load_scene(hardware), Overrides(servo_port=str(servo), board_port=str(board)))
    assert scene.node_parameters("servo_node", {}) == {"port": str(servo), "rate": 50.0}
    assert scene.node_parameters("tactile_node", {}) == {"port": str(board)}


def test_one_argument_sets_the_prefix_of_every_node(tmp_path: Path) -> None:
    for name in ("simulated", "camera", "mocks", "bench", "mission"):
        scene = override(load_scene(name), Overrides(frame_prefix="left/", joint_prefix="left_"))
        parameters = {node: scene.node_parameters(node, {}) for node in scene.nodes}
        without = {node for node, values in parameters.items() if values.get("frame_prefix") != "left/"}
        assert without <= {"docking_recorder_node", "recording_player_node", "mock_navigator_node"}
        assert [node for node, values in parameters.items() if "joint_prefix" in values] == [
            node for node in scene.nodes if node.endswith("servo_node")
        ]


@pytest.mark.parametrize("prefix", ["/left/", "left side/", "left/\n", "x" * 65])
@pytest.mark.parametrize("name", ["frame_prefix", "joint_prefix"])
def test_a_prefix_that_is_invalid_for_tf_is_refused(name: str, prefix: str) -> None:
    with pytest.raises(SceneError, match=name):
        override(load_scene("mocks"), Overrides(**{name: prefix}))


@pytest.mark.parametrize(
    ("scene", "camera", "here", "gone"),
    [
        ("bench", "oak", {"camera_node", "electrode_detector_node"}, set()),
        ("bench", "topics", {"electrode_detector_node"}, {"camera_node"}),
        ("camera", "topics", {"electrode_detector_node"}, {"simulated_camera_node"}),
        ("camera", "none", set(), {"simulated_camera_node", "electrode_detector_node"}),
        ("mocks", "oak", {"camera_node", "electrode_detector_node"}, {"mock_detector_node"}),
        ("mocks", "none", set(), {"mock_detector_node"}),
    ],
)
def test_the_camera_is_chosen_with_its_detector(scene: str, camera: str, here: set[str], gone: set[str]) -> None:
    before = load_scene(scene)
    after = override(before, Overrides(camera=camera))
    assert here <= set(after.nodes)
    assert not gone & set(after.nodes)
    assert not gone & set(after.parameters)
    assert set(before.nodes) - gone <= set(after.nodes)
    assert after.start_order()[-1] == "docking_node"


def test_files_reach_their_nodes_with_their_full_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.npz").touch()
    scene = override(load_scene("bench"), Overrides(model="mine.npz"))
    assert scene.node_parameters("misalignment_node", {}) == {"model": str(tmp_path / "mine.npz")}
    Path("one.mcap").touch()
    scene = override(load_scene("replay"), Overrides(recording="one.mcap"))
    assert scene.node_parameters("recording_player_node", {})["file"] == str(tmp_path / "one.mcap")


def test_records_go_to_the_given_folder_or_nowhere(tmp_path: Path) -> None:
    bench = load_scene("bench")
    assert override(bench, Overrides()) == bench
    recorded = override(bench, Overrides(record=str(tmp_path)))
    assert recorded.parameters[RECORDER]["folder"] == str(tmp_path)
    usual = override(bench, Overrides(record="true"))
    assert "folder" not in usual.parameters.get(RECORDER, {})
    assert override(recorded, Overrides(record="True")) == recorded
    assert override(recorded, Overrides(record="false")) == bench


REFUSED = [
    ("simulated", {"servo_port": "/dev/null"}, "has its own ports"),
    ("mocks", {"board_port": "/dev/null"}, "no node of this scene opens it"),
    ("bench", {"servo_port": "/dev/no_such_servo"}, "there is no such port"),
    ("bench", {"camera": "usb"}, "give oak, topics, none"),
    ("bench", {"model": "nowhere.npz"}, "there is no such file"),
    ("bench", {"recording": __file__}, "starts no recording_player_node"),
    ("bench", {"record": __file__}, "is a file"),
    ("bench", {"record": "/proc/records"}, "cannot be written"),
]


@pytest.mark.parametrize(("scene", "arguments", "expected"), REFUSED, ids=lambda value: str(value)[:40])
def test_an_unsuitable_argument_is_refused_by_its_name(scene: str, arguments: dict[str, str], expected: str) -> None:
    with pytest.raises(SceneError, match=expected) as caught:
        override(load_scene(scene), Overrides(**arguments))
    assert caught.value.key == next(iter(arguments))


def test_nodes_that_move_or_carry_current_do_not_restart() -> None:
    restarted = {name for name, spec in NODES.items() if spec.may_restart}
    hands = {"servo_node", "tactile_node", "docking_node", "mission_node", "recording_player_node"}
    assert not {name for name in restarted if {name, NODES[name].stands_in_for} & hands}
    assert "electrode_detector_node" in restarted
