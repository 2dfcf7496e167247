# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile record` with a running charger: real nodes, real bytes, simulated world."""

from __future__ import annotations

import dataclasses
import json
import math
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ..chargers import DEADLINE, Process, new_namespace, wait_until

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import ServoState, TactileFrame
from rclpy.serialization import deserialize_message

from deltacharger_bringup.cli.output import DONE, FAILED, INTERRUPTED, WRONG_INPUT
from deltacharger_core.mcap_file import McapFile
from deltacharger_records.datasets.journal import Journal
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import parse_scene
from deltacharger_sim.charger.faults import Fault
from deltacharger_sim.world import World
from deltacharger_tactile import default_model
from deltacharger_tactile.dataset import SUBSET_ANGLE, SUBSET_POSITION, Dataset

from ..marks import rest

pytestmark = pytest.mark.ros

QUICK = {
    "standoff": 0.006,
    "search_depth": 0.005,
    "coarse_step": 0.005,
    "search_speed": 0.1,
    "press_speed": 0.1,
    "travel_speed": 0.5,
    "servo_age_max": 1.0,
    "tactile_age_max": 1.0,
    "power_age_max": 1.0,
}
"""Of docking_node: large steps, and timeouts that tolerate a loaded computer."""
FRAMES = 3
NODES = ["servo_node", "tactile_node", "docking_node"]


class Charger:
    """A simulated charger with its target level at (0, 0, 80) mm, and its true state."""

    def __init__(self, composition: Composition, namespace: str) -> None:
        assert composition.charger is not None
        self.namespace = namespace
        self.faults: Any = composition.charger.faults
        self.world: World = composition.charger.world

    def turn(self, degrees: float) -> None:
        """Turn the target, as a person would."""
        target = dataclasses.replace(self.world.parameters.target, roll=math.radians(degrees))
        self.world.parameters = dataclasses.replace(self.world.parameters, target=target)

    def touches(self) -> bool:
        return self.world.snapshot().misalignment is not None

    def torque(self) -> bool:
        return any(self.world._enabled)

    def is_home(self) -> bool:
        return math.dist(self.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003

    def assert_safe(self) -> None:
        assert self.is_home()
        assert not self.torque()
        assert self.world.record.energised == 0.0


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Charger]:
    namespace = new_namespace()
    simulation = {"seed": 3, "rig_seed": 602, "world": {"target": {"x": 0.0, "y": 0.0, "z": 0.080, "roll": 0.0}}}
    content = {"nodes": NODES, "simulation": simulation, "parameters": {"docking_node": QUICK}}
    with Composition(parse_scene(content, "recorded"), context, namespace) as composition:
        with ChargerClient(namespace) as client:
            assert client.wait_until_it_answers(DEADLINE)
        yield Charger(composition, namespace)


Recorder = Callable[..., Process]


@pytest.fixture
def record(
    start: Callable[..., Process], deltacharger: tuple[str, ...], charger: Charger, tmp_path: Path
) -> Iterator[Recorder]:
    """Start the command on the charger; F.npz is the data set unless the options differ."""

    def begin(*words: str) -> Process:
        place = ("--namespace", charger.namespace, "--out", str(tmp_path / "F.npz"), "--json")
        return start(*deltacharger, "tactile", "record", *place, *words)

    yield begin
    charger.turn(0.0)
    charger.faults.clear()


def answer(process: Process, code: int, number: int | None = None) -> dict[str, Any]:
    assert process.end(number) == code, (process.out, process.err)
    assert len(process.out) == 1
    return dict(json.loads(process.out[0]))


def complete(record: Recorder, *words: str) -> dict[str, Any]:
    """Call until the set is complete: on a loaded computer servos lose their torque, and the next call continues."""
    for _ in range(4):
        process = record(*words)
        if process.end() == DONE:
            return dict(json.loads(process.out[0]))
        assert "SERVO_FAULT" in process.out[0], (process.out, process.err)
    raise AssertionError("servo faults in every call")


@pytest.mark.rest
def test_the_papers_sets_make_one_file_whose_offsets_the_estimator_finds(
    record: Recorder, charger: Charger, tmp_path: Path
) -> None:
    shape = ("--frames", str(FRAMES), "--rows", "2", "--rig", "7")
    position = ("--set", "position", "--repeat", "1", "--offsets-mm", "-5", "5", *shape)
    result = complete(record, *position)
    assert (result["dockings"], result["remaining"], result["n"], result["simulated"]) == (4, 0, 8, True)
    charger.assert_safe()

    contacts = charger.world.record.contacts
    again = record(*position, "--namespace", "nobody_here")  # a complete set needs no charger
    assert answer(again, DONE)["recorded"] == 0
    assert charger.world.record.contacts == contacts

    other = record(*position, "--rig", "8", "--repeat", "2")
    assert all(name in answer(other, WRONG_INPUT)["error"] for name in ("--rig 7 (not 8)", "--repeat 1 (not 2)"))

    charger.turn(4.0)
    turned = ("--set", "angle", "--angle-deg", "4", "--repeat", "1", *shape)
    assert complete(record, *turned)["n"] == 10
    data = Dataset.load(tmp_path / "F.npz")
    assert list(data.attempt) == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4]
    assert set(data.session[:8]).isdisjoint(data.session[8:])
    assert list(data.subset) == [SUBSET_POSITION] * 8 + [SUBSET_ANGLE] * 2
    assert set(data.rig) == {7}
    assert (data.threshold, data.meta["recorded"], data.meta["simulated"]) == (0.25, True, True)
    assert [(part["name"], part["recorded"], part["of"]) for part in data.meta["parts"]] == [
        ("position", 4, 4),
        ("angle 4°", 1, 1),
    ]
    assert {(round(1e3 * x), round(1e3 * y)) for x, y in zip(data.horizontal[:8], data.vertical[:8], strict=True)} == {
        (x, y) for x in (-5, 5) for y in (-5, 5)
    }
    assert np.all((data.current >= 0.4) & (data.current <= 0.5))
    assert np.isnan(data.tare).all()
    assert np.isnan(data.contact_pose[:, 2]).all()
    smallest = data.left[data.left > 0.0].min()
    assert smallest >= 0.25
    estimates = [default_model().predict(left, right) for left, right in zip(*data.robot_frames(), strict=True)]
    # Of one docking the estimate is 2 mm off (one standard deviation), of the difference of two pairs as much.
    horizontal = np.array([each.horizontal for each in estimates[:8]])
    apart = horizontal[data.horizontal[:8] > 0.0].mean() - horizontal[data.horizontal[:8] < 0.0].mean()
    assert apart == pytest.approx(0.010, abs=0.007)
    assert [each.vertical for each in estimates] == pytest.approx(list(data.vertical), abs=0.0045)
    assert [each.angle for each in estimates] == pytest.approx(list(data.angle), abs=math.radians(1.5))
    assert_rows_are_in_the_raw_messages(tmp_path / "F.recording" / "docking-000000.mcap", data)
    assert np.abs(data.poses() - np.column_stack([data.horizontal, data.vertical, data.angle])).max() < 0.001


def assert_rows_are_in_the_raw_messages(path: Path, data: Dataset) -> None:
    """Each row of a docking is the mean of FRAMES frames in a row, the second right after the first."""
    frames = np.array([each.left for each in _messages(path, "tactile_frame", TactileFrame)], dtype=np.float32)
    states = _messages(path, "servo_state", ServoState)
    assert len(states) > 50
    assert all(list(each.torque_enabled) == [True] * 3 for each in states)
    means = np.array([frames[begin : begin + FRAMES].mean(axis=0) for begin in range(len(frames) - FRAMES + 1)])
    means[means < data.threshold] = 0.0
    left = np.where(data.dead[:2, 0], np.nan, data.left[:2]).reshape(2, 100)
    found = [np.flatnonzero([np.allclose(mean, row, equal_nan=True) for mean in means]) for row in left]
    assert found[0] + FRAMES == found[1]
    strongest = np.nanmax(frames, axis=1)
    assert strongest[0] < 1.0 < strongest[found[0][0]]
    assert strongest[-1] < 1.0  # until the arm has released the target


def _messages(path: Path, name: str, kind: Any) -> list[Any]:
    file = McapFile(path)
    (topic,) = (topic for topic in file.types if topic.endswith(f"/{name}"))
    return [deserialize_message(each.data, kind) for each in file.messages(topic)]


@pytest.mark.rest
def test_a_kill_loses_no_reported_docking_and_the_same_call_continues(
    record: Recorder, charger: Charger, tmp_path: Path
) -> None:
    words = ("--set", "reference", "--repeat", "3", "--tare-every", "2")
    first = record(*words)
    first.wait_for_line("1 of 3", first.err)
    wait_until(charger.touches, "the second contact")
    assert first.end(signal.SIGKILL) == -signal.SIGKILL
    assert charger.torque()
    reported = sum(" of 3  " in line for line in first.err)
    folder = tmp_path / "F.recording"
    before = {path.name: path.read_bytes() for path in folder.glob("docking-*.mcap")}
    assert len(before) >= reported >= 1
    assert not (tmp_path / "F.npz").exists()
    composed = record("--compose")
    assert answer(composed, DONE)["n"] == len(before)

    result = complete(record, *words)
    assert (result["remaining"], result["n"]) == (0, 3)
    charger.assert_safe()
    assert {name: (folder / name).read_bytes() for name in before} == before
    with Journal(tmp_path / "F.npz") as journal:
        assert sorted(docking.number for docking in journal.dockings) == [0, 1, 2]
        assert [docking.attempt for docking in journal.dockings] == [0, 1, 2]
        assert len({docking.session for docking in journal.dockings}) >= 2
    assert sorted(path.suffix for path in folder.iterdir()) == [".json"] + [".mcap"] * 3


@pytest.mark.parametrize("number", [signal.SIGINT, rest(signal.SIGTERM)])
def test_a_signal_ends_it_with_the_arm_home_and_the_data_set_written(
    record: Recorder, charger: Charger, tmp_path: Path, number: signal.Signals
) -> None:
    process = record("--set", "reference", "--repeat", "9")
    process.wait_for_line("1 of 9", process.err)
    wait_until(charger.touches, "the second contact")
    result = answer(process, INTERRUPTED, number)
    charger.assert_safe()
    assert (result["success"], result["recorded"], result["remaining"]) == (False, 1, 8)
    assert len(Dataset.load(tmp_path / "F.npz")) == 1


@pytest.mark.rest
def test_a_docking_that_begins_during_a_recording_keeps_arm_and_torque(record: Recorder, charger: Charger) -> None:
    process = record("--set", "reference")
    process.wait_for_line("1 of 10", process.err)
    with ChargerClient(charger.namespace) as client:
        assert client.wait_until_it_answers(DEADLINE)
        docked = client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=120.0)
    assert "docking_node is at work" in answer(process, FAILED)["error"]
    # No node serves estimates here: docking got as far as requesting one, so its torque was not switched off.
    assert docked.error_name == "TACTILE_STALE"
    assert "predict_misalignment" in docked.error_message
    charger.assert_safe()


@pytest.mark.rest
def test_silent_pads_cause_retries_and_then_a_failure(record: Recorder, charger: Charger) -> None:
    process = record("--set", "reference", "--repeat", "2")
    process.wait_for_line("1 of 2", process.err)
    charger.faults.begin(Fault(kind="board_silent", last=2.0))
    assert answer(process, DONE)["recorded"] == 2
    assert any("TACTILE_STALE" in line and "trying again" in line for line in process.err)
    charger.assert_safe()

    process = record("--set", "angle", "--angle-deg", "0", "--repeat", "1")
    process.wait_for_line("keep clear", process.err)
    charger.faults.begin(Fault(kind="board_silent"))
    result = answer(process, FAILED)
    assert "failed 3 times, TACTILE_STALE" in result["error"]
    assert (result["recorded"], result["remaining"], result["dockings"]) == (0, 1, 2)
    charger.assert_safe()


def test_an_arm_powered_by_another_program_is_left_alone(record: Recorder, charger: Charger) -> None:
    import rclpy
    from rclpy.context import Context

    from deltacharger_kinematics import DeltaGeometry
    from deltacharger_records.datasets.arm_client import ArmClient

    context = Context()
    rclpy.init(context=context, args=[])
    try:
        with ArmClient(context, DeltaGeometry(), charger.namespace) as arm:
            arm.wait_until_ready(DEADLINE)
            arm.start()
            assert "another program moves the arm" in answer(record("--set", "reference"), FAILED)["error"]
            assert charger.torque()
        wait_until(lambda: not charger.torque(), "torque off")
    finally:
        rclpy.try_shutdown(context=context)


def test_places_out_of_reach_are_refused_before_anything_moves(record: Recorder, charger: Charger) -> None:
    contacts = charger.world.record.contacts
    result = answer(record("--set", "position", "--x-mm", "80"), WRONG_INPUT)
    assert "out of the arm's reach" in result["error"]
    assert charger.world.record.contacts == contacts
    charger.assert_safe()


def test_without_a_charger_it_exits_with_1_and_leaves_no_files(record: Recorder, tmp_path: Path) -> None:
    result = answer(record("--set", "reference", "--namespace", "nobody_here"), FAILED)
    assert "deltacharger up" in result["error"]
    assert not list(tmp_path.iterdir())
