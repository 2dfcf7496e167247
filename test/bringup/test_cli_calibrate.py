"""`deltacharger calibrate kinematics`: what it prints, writes, refuses, and how it measures with a running charger."""

from __future__ import annotations

import hashlib
import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli import main
from deltacharger_bringup.cli_measure import position_of
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration_data import TICK, Encoder, read_measurements
from deltacharger_kinematics.calibration_plan import Pose, plan, write_plan
from deltacharger_kinematics.calibration_problem import COUNT, Uncertainty, numbers, rms, with_numbers
from deltacharger_kinematics.calibration_recording import Recording
from deltacharger_kinematics.geometry_file import geometry_from_mapping, load_geometry

from .conftest import DEADLINE, Process, new_namespace, wait_until

NOMINAL = DeltaGeometry()
ARM = with_numbers(
    NOMINAL, numbers(NOMINAL) + np.random.default_rng(1).uniform(-1.0, 1.0, COUNT) * Uncertainty().tolerances
)
CALIBRATE = ("calibrate", "kinematics")


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    try:
        code = main([*CALIBRATE, *map(str, words)])
    except SystemExit as end:
        code = int(end.code or 0)
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def record(path: Path, arm: DeltaGeometry = ARM, wrong: int | None = None) -> Path:
    """Write what an operator of `arm` would measure; row `wrong` off by 3 mm."""
    random = np.random.default_rng(4)
    recording = Recording(path, Encoder())
    for index, pose in enumerate(plan(NOMINAL)):
        ticks = np.round(Encoder().ticks(Delta(NOMINAL).inverse(pose.position).angles))
        x, y, z = Delta(arm).forward(Encoder().angles(ticks)).position + random.normal(scale=5e-5, size=3)
        first, second, third = map(float, ticks)
        recording.append(pose, (first, second, third), (float(x) + 0.003 * (index == wrong), float(y), float(z)))
    return path


def test_a_fit_says_how_well_and_writes_a_geometry(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml"
    code, text, err = run(capsys, data, "--out", out)
    assert code == 0, err
    assert f"wrote {out}" in err
    lines = text.splitlines()
    assert [line.split()[0] for line in lines if line.startswith(("radius", "tang", "height", "arm", "rod", "angle"))]
    for word in ("limb 0", "held out", "expected", "scatter", "line ", "singular", "weakest"):
        assert word in text
    assert max(map(len, lines)) <= 120
    geometry = load_geometry(out)
    box = np.random.default_rng(0).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (100, 3))
    angles = Delta(NOMINAL).inverse(box).angles
    assert rms(Delta(ARM).forward(angles).position - Delta(geometry).forward(angles).position) < 1e-4
    header = out.read_text(encoding="utf-8")
    assert hashlib.sha256(data.read_bytes()).hexdigest() in header
    for word in ("measured.csv", "36 rows", "held out: 9", "zero_ticks 2048 2048 2048", "date: 20"):
        assert word in header


def test_one_object_in_si_units(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    code, text, err = run(capsys, record(tmp_path / "measured.csv"), "--json")
    assert (code, err) == (0, "")
    found = json.loads(text)
    assert found["success"] is True
    assert found["written"] is None
    assert (found["rows"], len(found["held_out"]["lines"]), len(found["singular_values"])) == (36, 9, 18)
    assert found["rms"]["after"] < 2e-4 < 1e-3 < found["rms"]["before"]
    assert found["held_out"]["after"] < 3e-4 < 1e-3 < found["held_out"]["before"]
    errors = [
        (row["fitted"] - true) / row["stddev"] for row, true in zip(found["parameters"], numbers(ARM), strict=True)
    ]
    assert max(map(abs, errors)) < 4.0
    assert len({(row["limb"], row["name"]) for row in found["parameters"]}) == COUNT
    assert geometry_from_mapping(found["geometry"]).limbs != NOMINAL.limbs


def test_nothing_is_overwritten_or_written_in_doubt_without_force(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml"
    out.write_text("mine", encoding="utf-8")
    code, _, err = run(capsys, data, "--out", out)
    assert (code, out.read_text(encoding="utf-8")) == (2, "mine")
    assert "--force" in err
    assert run(capsys, data, "--out", out, "--force")[0] == 0
    assert load_geometry(out).limbs != NOMINAL.limbs
    assert run(capsys, data, "--out", tmp_path / "no" / "folder.yaml")[0] == 2


def test_an_outlier_is_named_and_keeps_the_geometry_from_being_written(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data, out = record(tmp_path / "measured.csv", wrong=10), tmp_path / "arm.yaml"
    code, text, err = run(capsys, data, "--out", out, "--json")
    assert code == 1
    assert not out.exists()
    assert json.loads(text)["outliers"] == [14]  # two comments and the header stand above
    assert "line 14: the other rows contradict" in err
    assert "was not written" in err
    assert run(capsys, data, "--out", out, "--force")[0] == 0
    assert "doubtful: line 14" in out.read_text(encoding="utf-8")


def test_a_fit_that_does_not_help_where_it_was_not_fitted_is_1(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    data, calibrated, out = record(tmp_path / "measured.csv"), tmp_path / "arm.yaml", tmp_path / "again.yaml"
    assert run(capsys, data, "--out", calibrated)[0] == 0
    code, _, err = run(capsys, data, "--nominal", calibrated, "--out", out)  # what is fitted already
    assert code == 1
    assert "does not help" in err
    assert not out.exists()


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("no-such-file.csv",),
        ("DATA", "--nominal", "no-such-file.yaml"),
        ("DATA", "--measurement-mm", "0"),
        ("DATA", "--tolerance-mm", "nan"),
        ("DATA", "--tolerance-deg", "-1"),
        ("DATA", "--held-out", "0"),
        ("DATA", "--held-out", "1"),
        ("DATA", "--seed", "1.5"),
        ("DATA", "--zero-ticks", "1", "2"),
        ("DATA", "--zero-ticks", "2050", "2048", "2048"),
        ("DATA", "--direction", "1", "0", "1"),
        ("DATA", "--direction", "1", "1", "-1"),
        ("DATA", "--plan", "new.csv"),
        ("--measure", "new.csv"),
        ("DATA", "--measure", "new.csv", "--plan", "plan.csv"),
        ("--plan", "no-such-file.csv", "--measure", "new.csv"),
        ("--plan", "new.csv", "--direction", "1", "2", "1"),
        ("--plan", "no/such/folder.csv"),
        ("--plan", "DATA"),
    ],
)
def test_wrong_usage_is_2_with_a_reason(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    monkeypatch.chdir(tmp_path)
    data = str(record(tmp_path / "measured.csv"))
    code, out, err = run(capsys, *(data if word == "DATA" else word for word in words), "--json")
    assert code == 2, err
    assert json.loads(out)["success"] is False
    assert not (tmp_path / "new.csv").exists()


def test_a_bad_row_is_told_with_file_and_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = record(tmp_path / "measured.csv")
    lines = data.read_text(encoding="utf-8").splitlines()
    lines[6] = lines[6].replace(",", ",x", 1)
    data.write_text("\n".join(lines), encoding="utf-8")
    code, out, err = run(capsys, data, "--json")
    assert code == 2
    told = json.loads(out)
    assert (told["file"], told["lines"]) == (str(data), [7])
    assert f"{data}: line 7: held_out" in err


def test_zero_ticks_shift_the_angles(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    data = record(tmp_path / "measured.csv")
    bare = "".join(line for line in data.read_text(encoding="utf-8").splitlines(True) if not line.startswith("#"))
    data.write_text(bare, encoding="utf-8")
    offsets = [
        [row["fitted"] for row in json.loads(run(capsys, data, "--json", *words)[1])["parameters"][5::6]]
        for words in ((), ("--zero-ticks", 2058, 2048, 2048))
    ]
    assert np.allclose(np.subtract(offsets[1], offsets[0]), [10 * TICK, 0.0, 0.0], atol=1e-4)


def test_a_plan_is_written_once(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    code, out, _ = run(capsys, "--plan", path, "--json", "--zero-ticks", 2000, 2048, 2048)
    assert code == 0
    assert json.loads(out) == {"success": True, "written": str(path), "poses": 36, "held_out": 9}
    assert "# zero_ticks 2000 2048 2048\n" in path.read_text(encoding="utf-8")
    assert run(capsys, "--plan", path)[0] == 2
    assert run(capsys, "--plan", path, "--force")[0] == 0


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("1 2 3", (1, 2, 3)),
        ("1,5 -2,5 3", (1.5, -2.5, 3)),
        ("1.5,-2.5,3", (1.5, -2.5, 3)),
        ("1; 2; 3", (1, 2, 3)),
        ("1 2", None),
        ("1,2,3,4", None),
        ("1 2 x", None),
        ("1 2 nan", None),
        ("", None),
    ],
)
def test_positions_as_people_type_them(text: str, position: tuple[float, ...] | None) -> None:
    assert position_of(text) == (None if position is None else pytest.approx([1e-3 * value for value in position]))


# Measuring with a charger that runs, made of mocks.


class Operator(Process):
    """`--measure` with a person at its terminal."""

    def __init__(self, *words: str) -> None:
        reading, self._writing = os.pipe()
        before = os.dup(0)
        os.dup2(reading, 0)
        try:
            super().__init__(*words)
        finally:
            os.dup2(before, 0)
            os.close(before)
            os.close(reading)
        self._answered = 0

    def wait_for_question(self) -> None:
        wait_until(lambda: self._questions() > self._answered or self.process.poll() is not None, "a question")
        assert self._questions() > self._answered, self.err

    def _questions(self) -> int:
        return sum(line.endswith(":") for line in list(self.err))

    def answer(self, text: str | Callable[[], str]) -> None:
        self.wait_for_question()
        self._answered += 1
        os.write(self._writing, f"{text if isinstance(text, str) else text()}\n".encode())

    def hang_up(self) -> None:
        os.close(self._writing)


class Charger:
    """A charger of mocks in its own process, and what its servos say."""

    def __init__(self, process: Process, namespace: str, node: Any) -> None:
        from deltacharger.msg import ServoState

        from deltacharger_bringup import qos

        self.process, self.namespace = process, namespace
        self.state: Any = None
        node.create_subscription(ServoState, f"/{namespace}/servo_state", self._on_state, qos.LATEST)

    def _on_state(self, message: Any) -> None:
        self.state = message

    def torque(self) -> bool:
        return self.state is not None and any(self.state.torque_enabled)

    def position(self) -> np.ndarray:
        return np.asarray(Delta(NOMINAL).forward(np.array(self.state.position)).position)


@pytest.fixture(scope="module")
def charger(quick_file: Path) -> Iterator[Charger]:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node

    from deltacharger_bringup.node_support import Spinner

    namespace, context = new_namespace(), Context()
    rclpy.init(context=context, args=[])
    process = Process(
        sys.executable, "-m", "deltacharger_bringup.cli", "up", "--scene", str(quick_file), "--namespace", namespace
    )
    spinner = Spinner(Node("listener", context=context, use_global_arguments=False))
    try:
        charger = Charger(process, namespace, spinner.node)
        process.wait_for_line("ready", process.err)
        wait_until(lambda: charger.state is not None, "servo_state")
        yield charger
    finally:
        spinner.close()
        rclpy.try_shutdown(context=context)
        assert process.end(signal.SIGTERM) == 0


@pytest.fixture
def short_plan(tmp_path: Path) -> Path:
    """Four poses, clear of the mock's target."""
    poses = [Pose(n, n == 4, (0.01 * n, -0.005 * n, 0.010 + 0.005 * n)) for n in range(1, 5)]
    write_plan(tmp_path / "plan.csv", poses, NOMINAL, Encoder())
    return tmp_path / "plan.csv"


@pytest.fixture
def operator(charger: Charger, short_plan: Path) -> Iterator[Callable[..., Operator]]:
    running: list[Operator] = []

    def begin(*words: str) -> Operator:
        paths = ("--plan", str(short_plan), "--measure", str(short_plan.with_name("measured.csv")))
        command = (sys.executable, "-m", "deltacharger_bringup.cli", *CALIBRATE, *paths)
        running.append(Operator(*command, "--namespace", charger.namespace, *words))
        return running[-1]

    yield begin
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait(DEADLINE)
    wait_until(lambda: not charger.torque(), "torque off")


def place(charger: Charger) -> Callable[[], str]:
    """Return what reads off where the arm is, as a person types it."""
    return lambda: " ".join(f"{1000 * value:.3f}" for value in charger.position())


def test_measured_poses_are_recorded_one_by_one_and_resumed(
    operator: Callable[..., Operator], charger: Charger, short_plan: Path
) -> None:
    path = short_plan.with_name("measured.csv")
    person = operator("--json")
    person.answer("what?")
    person.answer("1 2")
    person.wait_for_question()
    first = charger.position()
    assert charger.torque()
    person.answer("900 0 0")  # a slip, and asked for again
    person.answer(place(charger))
    person.answer("s")
    person.answer(place(charger))
    person.answer("q")
    assert person.end() == 0, person.err
    assert json.loads(person.out[0]) == {
        "success": True,
        "written": str(path),
        "measured": 2,
        "skipped": 1,
        "remaining": 2,
    }
    rows = read_measurements(path)
    assert np.allclose(rows.positions[0], first, atol=1e-4)
    assert np.allclose(rows.positions, Delta(NOMINAL).forward(rows.angles).position, atol=1e-4)
    assert np.allclose(rows.positions[0], (0.01, -0.005, 0.015), atol=3e-3)
    wait_until(lambda: not charger.torque(), "torque off")
    assert math.dist(charger.position(), (0.0, 0.0, 0.0)) < 0.01

    again = operator()
    again.answer(place(charger))
    again.wait_for_line("pose 4", again.err)
    again.answer(place(charger))
    assert again.end() == 0, again.err
    assert any("2 of 4 poses already" in line for line in again.err)
    rows = read_measurements(path)
    assert len(rows) == 4
    assert rows.held_out is not None
    assert rows.held_out.sum() == 1


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, "end of input"])
def test_whatever_ends_it_the_torque_goes_off_and_what_was_measured_is_kept(
    operator: Callable[..., Operator], charger: Charger, short_plan: Path, how: signal.Signals | str
) -> None:
    person = operator("--json")
    person.wait_for_question()
    assert charger.torque()
    person.answer(place(charger))
    person.wait_for_question()
    if isinstance(how, signal.Signals):
        assert person.end(how) == 130, person.err
    else:
        person.hang_up()
        assert person.end() == 1, person.err
    assert json.loads(person.out[0])["success"] is False
    wait_until(lambda: not charger.torque(), "torque off")
    assert len(read_measurements(short_plan.with_name("measured.csv"))) == 1


def test_a_docking_that_begins_meanwhile_keeps_the_arm(
    operator: Callable[..., Operator], charger: Charger, deltacharger: tuple[str, ...], quick_file: Path
) -> None:
    person = operator()
    person.wait_for_question()
    goal = ("--scene", str(quick_file), "--namespace", charger.namespace, "--no-picture", "--no-charge", "--json")
    dock = Process(*deltacharger, "dock", *goal)
    assert person.end() == 1
    assert any("docking_node is at work" in line for line in person.err)
    assert dock.end() == 0, dock.err  # nobody took its torque away
    second = operator()
    assert second.end() == 1  # docked
    assert charger.torque()
    undock = Process(*deltacharger, "undock", "--scene", str(quick_file), "--namespace", charger.namespace)
    assert undock.end() == 0, undock.err


def test_without_a_charger_it_is_1(operator: Callable[..., Operator], charger: Charger) -> None:
    person = operator("--namespace", "nobody_here")
    assert person.end() == 1
    assert any("deltacharger up" in line for line in person.err)
    assert not charger.torque()
