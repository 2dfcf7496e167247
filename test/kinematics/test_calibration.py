# SPDX-License-Identifier: Apache-2.0
"""The calibration: accuracy, errors, refusals, and files of measurements, plans and recordings."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration import data
from deltacharger_kinematics.calibration.calibrate import (
    COUNT,
    Uncertainty,
    calibrate,
    find_outliers,
    numbers,
    rms,
    with_numbers,
)

from ..marks import night, rest

NOMINAL = DeltaGeometry()
STATED = Uncertainty()
MILLIMETRE = 1e-3
POSES = data.plan(NOMINAL)
POINTS = np.array([pose.position for pose in POSES])
KEPT = np.array([pose.held_out for pose in POSES])
HEADER = "x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2"


def drawn_arm(seed: int) -> DeltaGeometry:
    return with_numbers(NOMINAL, numbers(NOMINAL) + np.random.default_rng(seed).normal(size=COUNT) * STATED.tolerances)


def measured(
    arm: DeltaGeometry, points: np.ndarray = POINTS, noise: float = 0.05 * MILLIMETRE, seed: int = 1
) -> data.Measurements:
    random = np.random.default_rng(seed)
    angles = Delta(NOMINAL).inverse(points).angles
    there = Delta(arm).forward(angles).position
    kept = KEPT if points is POINTS else None
    return data.Measurements(
        there + random.normal(size=there.shape) * noise, angles, kept, tuple(range(2, len(points) + 2))
    )


BOX = np.random.default_rng(9).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (200, 3))
BOX_ANGLES = Delta(NOMINAL).inverse(BOX).angles
GOOD = measured(drawn_arm(1))


def workspace_error(arm: DeltaGeometry, model: DeltaGeometry) -> float:
    return rms(Delta(arm).forward(BOX_ANGLES).position - Delta(model).forward(BOX_ANGLES).position)


@pytest.mark.parametrize("count", [rest(3), night(8)])
def test_a_calibration_improves_accuracy(count: int) -> None:
    arms = [drawn_arm(seed) for seed in range(count)]
    errors = {"none": [], "all": [], "held out": []}  # type: dict[str, list[float]]
    for seed, arm in enumerate(arms):
        rows = measured(arm, seed=seed)
        found = calibrate(rows, NOMINAL, STATED)
        errors["none"].append(workspace_error(arm, NOMINAL))
        errors["all"].append(workspace_error(arm, found.fit.geometry))
        errors["held out"].append(found.held_out_rms[1])
        assert found.improves
        assert not found.outliers.any()
    mean = {name: math.sqrt(np.mean(np.square(values))) / MILLIMETRE for name, values in errors.items()}
    assert 2.0 < mean["none"] < 5.5
    assert mean["all"] < 0.05
    assert 0.08 < mean["held out"] < 0.14  # the measurement's own 0.05·√3 mm and the fit's error


@pytest.mark.night
def test_the_stated_uncertainty_matches_the_real_errors() -> None:
    """The scatter of fitted minus true values matches the stated standard deviations."""
    deviations = []
    for seed in range(12):
        arm = drawn_arm(100 + seed)
        found = calibrate(measured(arm, seed=seed), NOMINAL, STATED)
        deviations.append((numbers(found.fit.geometry) - numbers(arm)) / found.standard_deviations)
    assert 0.85 < np.sqrt(np.mean(np.square(deviations))) < 1.15


def test_exactly_the_outliers_are_named() -> None:
    arm = drawn_arm(8)
    rows = measured(arm)
    rows.positions[4, 0] += 1.0 * MILLIMETRE
    rows.positions[20] += 5.0 * MILLIMETRE
    assert np.flatnonzero(find_outliers(rows, NOMINAL, STATED)).tolist() == [4, 20]


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (measured(NOMINAL, POINTS * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.05]), "one plane.*along z"),
        (replace(measured(NOMINAL, np.repeat(POINTS[[0, 2, 8, 26]], 8, axis=0)), held_out=None), "do not determine"),
        (measured(NOMINAL, BOX[:6]), "more poses"),
        (replace(GOOD, positions=1e3 * GOOD.positions), "millimetres"),
        (replace(GOOD, positions=GOOD.positions[:, [1, 0, 2]]), "predicted"),
    ],
)
def test_unsuitable_measurements_are_refused(rows: data.Measurements, problem: str) -> None:
    with pytest.raises(data.CalibrationError, match=problem):
        calibrate(rows, NOMINAL, STATED)


def test_angles_that_the_arm_cannot_have_are_refused_with_their_lines() -> None:
    rows = measured(NOMINAL)
    rows.angles[[3, 7]] = [3.0, 0.0, -3.0]
    with pytest.raises(
        data.CalibrationError, match="lines 5, 9: an arm angle is far outside the joint limits"
    ) as refused:
        calibrate(rows, NOMINAL, STATED)
    assert refused.value.lines == (5, 9)


ROW = "1,2,3,2048,2100,2000"


def read(tmp_path: Path, text: str | bytes) -> data.Measurements:
    path = tmp_path / "data.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return data.read_measurements(path)


@pytest.mark.parametrize(
    "text",
    [
        f"\ufeff{HEADER}\r\n{ROW}\r\n\r\n",
        f"# made on Monday\n\n {HEADER.replace(',', ' , ')}\n{ROW}\n,,,,,\n# end\n",
        '"# comment, quoted"\n"x_mm","y_mm",z_mm,ticks_0,ticks_1,ticks_2\n"1",2,3,2048,2100,2000\n',
        f"{HEADER.replace(',', ';')}\n1,0;2,0;3,0;2048;2100;2000\n",
        "x_m,y_m,z_m,ticks_0,ticks_1,ticks_2\n0.001,2e-3,+.003,2048.0,2100,2000\n",
    ],
)
def test_files_as_editors_and_spreadsheets_write_them(tmp_path: Path, text: str) -> None:
    rows = read(tmp_path, text)
    assert np.allclose(rows.positions, [[0.001, 0.002, 0.003]], atol=1e-15)
    assert np.allclose(rows.angles, [[0.0, 52 * data.TICK, -48 * data.TICK]], atol=1e-15)


def test_zero_ticks_and_direction_are_as_the_file_states(tmp_path: Path) -> None:
    stated = (
        f"# zero_ticks 2000 2048 2048\n# direction: 1 1 -1\n# direction of the probe: from above\n{HEADER}\n{ROW}\n"
    )
    encoder = data.Encoder((2000, 2048, 2048), (1, 1, -1))
    assert read(tmp_path, stated).encoder == encoder
    assert read(tmp_path, stated).angles[0].tolist() == [48 * data.TICK, 52 * data.TICK, 48 * data.TICK]
    with pytest.raises(data.CalibrationError, match=r"line 1: .* three whole numbers"):
        read(tmp_path, f"# zero_ticks 2048 2048\n{HEADER}\n{ROW}\n")
    with pytest.raises(data.CalibrationError, match="direction"):
        data.Encoder(direction=(1, 0, 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        (f"{HEADER}\n1,2,x,2048,2100,2000\n", "line 2: z_mm"),
        (f"{HEADER}\n1,5,2,5,3,5,2048,2100,2000\n", "9 cells for 6 columns; are there decimal commas"),
        ("x_mm,y_mm,ticks_0,ticks_1,ticks_2\n", "column 'z_mm' is missing"),
        (f"{HEADER},ticks0\n", "unknown column 'ticks0'; did you mean 'ticks_0'"),
        (f"{HEADER},held_out\n{ROW},yes\n", "line 2: held_out is 'yes'"),
        (f"{HEADER}\n1,2,3,6048,2100,2000\n", "line 2: ticks_0 is 6048: more than half a turn"),
    ],
)
def test_doubtful_cells_are_refused_with_their_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(data.CalibrationError, match=message):
        read(tmp_path, text)


def test_a_recording_is_a_measurement_file_and_can_resume(tmp_path: Path) -> None:
    path, encoder, rows = tmp_path / "measured.csv", data.Encoder(direction=(1, -1, 1)), measured(drawn_arm(5))

    def record(recording: data.PoseRecording, poses: range) -> None:
        for index in poses:
            first, second, third = map(float, encoder.ticks(rows.angles[index]))
            x, y, z = map(float, rows.positions[index])
            recording.append(POSES[index], (first, second, third), (x, y, z))

    record(data.PoseRecording(path, encoder), range(10))
    path.write_bytes(path.read_bytes().rstrip(b"\n"))  # as saved by an editor
    resumed = data.PoseRecording(path, encoder)
    assert resumed.done == set(range(1, 11))
    record(resumed, range(10, 36))
    again = data.read_measurements(path)
    assert np.allclose(again.positions, rows.positions, atol=1e-7)
    assert np.allclose(again.angles, rows.angles, atol=0.006 * data.TICK)
    assert again.held_out is not None
    assert (again.held_out == KEPT).all()
    with pytest.raises(data.CalibrationError, match="other zero ticks"):
        data.PoseRecording(path, data.Encoder())
    other = tmp_path / "other.csv"
    other.write_text(f"{HEADER}\n{ROW}\n")
    with pytest.raises(data.CalibrationError, match="no recording"):
        data.PoseRecording(other, encoder)
