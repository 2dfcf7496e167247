"""Laws of the calibration: what it recovers, how it errs, and what it refuses to work with."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration import Calibration, calibrate, describe, find_outliers, fit
from deltacharger_kinematics.calibration_data import TICK, Encoder, Measurements, read_measurements
from deltacharger_kinematics.calibration_plan import plan, read_plan, write_plan
from deltacharger_kinematics.calibration_problem import COUNT, NAMES, Problem, Uncertainty, numbers, rms, with_numbers
from deltacharger_kinematics.calibration_recording import Recording
from deltacharger_kinematics.calibration_table import CalibrationError
from deltacharger_kinematics.geometry import LimbAdjustment
from deltacharger_kinematics.geometry_file import load_geometry, save_geometry

NOMINAL = DeltaGeometry()
STATED = Uncertainty()
MILLIMETRE = 1e-3
POSES = plan(NOMINAL)
POINTS = np.array([pose.position for pose in POSES])
KEPT = np.array([pose.held_out for pose in POSES])
BOX = np.random.default_rng(9).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (200, 3))
BOX_ANGLES = Delta(NOMINAL).inverse(BOX).angles
HEADER = "x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2"


def drawn_arm(seed: int) -> DeltaGeometry:
    return with_numbers(NOMINAL, numbers(NOMINAL) + np.random.default_rng(seed).normal(size=COUNT) * STATED.tolerances)


def measured(
    arm: DeltaGeometry, points: np.ndarray = POINTS, noise: float = 0.05 * MILLIMETRE, seed: int = 1, play: float = 0.0
) -> Measurements:
    random = np.random.default_rng(seed)
    angles = Delta(NOMINAL).inverse(points).angles
    there = Delta(arm).forward(angles + play * random.choice([-1.0, 1.0], angles.shape)).position
    kept = KEPT if points is POINTS else None
    return Measurements(there + random.normal(size=there.shape) * noise, angles, kept, tuple(range(2, len(points) + 2)))


def workspace_error(arm: DeltaGeometry, model: DeltaGeometry) -> float:
    return rms(Delta(arm).forward(BOX_ANGLES).position - Delta(model).forward(BOX_ANGLES).position)


def write(path: Path, rows: Measurements, encoder: Encoder | None = None, header: str = HEADER) -> Path:
    ticks = (encoder or Encoder()).ticks(rows.angles)
    lines = [",".join(f"{v:.6f}" for v in (*p / MILLIMETRE, *t)) for p, t in zip(rows.positions, ticks, strict=True)]
    path.write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("seed", range(3))
def test_exact_measurements_give_the_arm_back(seed: int) -> None:
    arm = drawn_arm(seed)
    exact = Uncertainty(measurement=1e-9)  # so small that the tolerances have no say
    found = fit(measured(arm, noise=0.0), NOMINAL, exact)
    assert np.abs(numbers(found.geometry) - numbers(arm)).max() < 1e-9
    assert rms(found.residuals) < 1e-13
    assert workspace_error(arm, found.geometry) < 1e-12


def test_the_derivatives_are_those_of_the_geometry() -> None:
    """Of the closure r·(dp − dc) = L dL that Delta.forward satisfies, worked out by hand."""
    arm, angles = drawn_arm(3), Delta(NOMINAL).inverse(BOX).angles
    p = Delta(arm).forward(angles).position
    rods, rates = np.zeros((len(p), 3, 3)), np.zeros((len(p), 3, COUNT))
    for index in range(3):
        limb = arm.limb(index)
        out, side = np.array([limb.cosine, limb.sine, 0.0]), np.array([-limb.sine, limb.cosine, 0.0])
        up = np.array([0.0, 0.0, 1.0])
        true = (angles[:, index] + limb.angle_offset)[:, None]
        along = np.cos(true) * out + np.sin(true) * up
        centre = limb.difference * out + limb.tangential_offset * side - limb.motor_height * up + limb.arm * along
        rods[:, index] = p - centre
        by = {
            "radius_offset": out,
            "tangential_offset": side,
            "height_offset": up,
            "arm": along,
            "angle_offset": limb.arm * (np.cos(true) * up - np.sin(true) * out),
        }
        for column, name in enumerate(NAMES):
            rates[:, index, 6 * index + column] = (
                limb.rod if name == "rod" else (rods[:, index] * by[name]).sum(axis=-1)
            )
    expected = np.linalg.solve(rods, rates) * STATED.tolerances
    rows = Measurements(p, angles, None, tuple(range(len(p))))
    x = (numbers(arm) - numbers(NOMINAL)) / STATED.tolerances
    assert np.allclose(Problem(rows, NOMINAL, STATED).sensitivity(x), expected, atol=1e-12)


def test_what_a_calibration_wins() -> None:
    """Trial figures of the design note: 2.37 mm uncalibrated, 0.71 with angle offsets only, 0.048 with 18 numbers."""
    arms = [drawn_arm(seed) for seed in range(8)]
    angles_only = replace(STATED, length=1e-9)
    errors = {"none": [], "angles": [], "all": [], "play": [], "held out": []}  # type: dict[str, list[float]]
    for seed, arm in enumerate(arms):
        rows = measured(arm, seed=seed)
        found = calibrate(rows, NOMINAL, STATED)
        errors["none"].append(workspace_error(arm, NOMINAL))
        errors["angles"].append(workspace_error(arm, fit(rows, NOMINAL, angles_only).geometry))
        errors["all"].append(workspace_error(arm, found.fit.geometry))
        errors["held out"].append(found.held_out_rms[1])
        with_play = measured(arm, seed=seed, play=math.radians(0.165))
        errors["play"].append(workspace_error(arm, fit(with_play, NOMINAL, STATED).geometry))
        assert found.improves
        assert not found.outliers.any()
    mean = {name: math.sqrt(np.mean(np.square(values))) / MILLIMETRE for name, values in errors.items()}
    assert 2.0 < mean["none"] < 5.5
    assert 0.3 < mean["angles"] < 1.2
    assert mean["all"] < 0.05
    assert 0.08 < mean["held out"] < 0.14  # the measurement's own 0.05·√3 mm and the fit's error
    assert mean["play"] < 0.25


def test_the_stated_uncertainty_is_the_real_one() -> None:
    """Fitted minus true scatters by one of the standard deviations that the fit states, and the workspace error too."""
    deviations, expected, real = [], [], []
    for seed in range(12):
        arm = drawn_arm(100 + seed)
        found = calibrate(measured(arm, seed=seed), NOMINAL, STATED)
        deviations.append((numbers(found.fit.geometry) - numbers(arm)) / found.standard_deviations)
        expected.append(found.expected[0])
        real.append(workspace_error(arm, found.fit.geometry))
    assert 0.85 < np.sqrt(np.mean(np.square(deviations))) < 1.15
    assert 0.8 < rms(np.array([real])) / rms(np.array([expected])) < 1.25


def test_rows_that_scatter_more_than_stated_count_less() -> None:
    arm = drawn_arm(4)
    found = fit(measured(arm, noise=0.25 * MILLIMETRE), NOMINAL, STATED)
    same = fit(measured(arm, noise=0.25 * MILLIMETRE), NOMINAL, replace(STATED, measurement=0.25 * MILLIMETRE))
    assert 4.0 < found.scatter < 6.0
    assert 0.8 < same.scatter < 1.2
    assert np.allclose(found.singular_values, same.singular_values, rtol=0.2)


def test_tolerances_hold_what_nine_poses_cannot_tell() -> None:
    for seed in range(5):
        arm = drawn_arm(seed)
        nine = np.random.default_rng(seed).uniform(NOMINAL.workspace_min, NOMINAL.workspace_max, (9, 3))
        found = fit(measured(arm, nine, seed=seed), NOMINAL, STATED)
        assert (np.abs(numbers(found.geometry) - numbers(NOMINAL)) < 5.0 * STATED.tolerances).all()
        assert workspace_error(arm, found.geometry) < 0.3 * MILLIMETRE
        assert found.singular_values[-1] < 1.0


def test_whole_ticks_are_weighted_by_their_resolution(tmp_path: Path) -> None:
    arm = drawn_arm(6)
    rows = measured(arm, noise=0.005 * MILLIMETRE)
    rounded = replace(rows, angles=np.round(rows.angles / TICK) * TICK)
    aware = fit(replace(rounded, angle_stddev=TICK / math.sqrt(12.0)), NOMINAL, replace(STATED, measurement=5e-6))
    assert aware.scatter < 1.3
    assert fit(rounded, NOMINAL, replace(STATED, measurement=5e-6)).scatter > 5.0
    assert read_measurements(write(tmp_path / "ticks.csv", rows)).angle_stddev == pytest.approx(TICK / math.sqrt(12.0))


def test_a_geometry_that_was_calibrated_before_is_a_start_like_any_other() -> None:
    arm = drawn_arm(7)
    start = with_numbers(arm, numbers(arm) + 0.3 * STATED.tolerances)
    found = calibrate(measured(arm), start, STATED)
    assert found.improves
    assert workspace_error(arm, found.fit.geometry) < 0.06 * MILLIMETRE


def test_outliers_are_named_and_only_they() -> None:
    arm = drawn_arm(8)
    rows = measured(arm)
    rows.positions[4, 0] += 1.0 * MILLIMETRE
    rows.positions[20] += 5.0 * MILLIMETRE
    assert np.flatnonzero(find_outliers(rows, NOMINAL, STATED)).tolist() == [4, 20]


def test_the_held_out_rows_are_drawn_by_the_seed_or_taken_from_the_file() -> None:
    rows = measured(drawn_arm(1))
    assert calibrate(rows).held_out.tolist() == KEPT.tolist()
    free = replace(rows, held_out=None)
    drawn = [calibrate(free, held_out=0.25, seed=seed).held_out for seed in (0, 0, 1)]
    assert [mask.sum() for mask in drawn] == [9, 9, 9]
    assert (drawn[0] == drawn[1]).all()
    assert (drawn[0] != drawn[2]).any()


def test_an_arm_that_is_as_drawn_is_not_made_worse_in_silence() -> None:
    results = [calibrate(measured(NOMINAL, seed=seed), NOMINAL, STATED) for seed in range(6)]
    assert all(result.held_out_rms[1] < 0.2 * MILLIMETRE for result in results)
    assert not all(result.improves for result in results)


def test_the_weakest_direction_in_words() -> None:
    direction = np.zeros(COUNT)
    direction[[4, 10]] = 0.6
    direction[2] = -0.5
    assert describe(direction) == "rod of limbs 0, 1 larger with height_offset of limb 0 smaller"
    assert describe(-direction) == describe(direction)


def test_the_file_of_a_fit_is_a_geometry_with_the_held_out_accuracy(tmp_path: Path) -> None:
    found = calibrate(measured(drawn_arm(2)), NOMINAL, STATED)
    path = tmp_path / "arm.yaml"
    save_geometry(found.fit.geometry, path, "made by a test")
    loaded = load_geometry(path)
    assert loaded == found.fit.geometry
    unseen = measured(drawn_arm(2), BOX, seed=5)
    error = unseen.positions - Delta(loaded).forward(unseen.angles).position
    assert rms(error) < 1.3 * found.held_out_rms[1]


@pytest.mark.parametrize(
    ("points", "where"),
    [
        (POINTS * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.05], "in one plane: they cover only 0.2 mm along z"),
        (POINTS * [1.0, 0.0, 1.0], "in one plane: they cover only 0.2 mm along y"),
        (POINTS * [0.0, 0.0, 1.0], "on one line: they cover only"),
        (POINTS * [1.0, 1.0, 0.0] + POINTS[:, :1] * [0.0, 0.0, 1.0] + [0.0, 0.0, 0.055], "along (-0.7, 0.0, 0.7)"),
        (np.full((36, 3), 0.03), "at one point"),
        (POINTS * 0.05 + [0.0, 0.0, 0.05], "at one point"),
    ],
)
def test_poses_that_do_not_span_the_workspace_are_refused(points: np.ndarray, where: str) -> None:
    with pytest.raises(CalibrationError, match="the poses lie ") as refused:
        calibrate(measured(NOMINAL, points), NOMINAL, STATED)
    assert where in str(refused.value)


def test_four_poses_measured_again_and_again_are_refused_with_what_they_leave_open() -> None:
    corners = POINTS[[0, 2, 8, 26]]
    with pytest.raises(CalibrationError, match=r"say nothing about .* of limb"):
        calibrate(replace(measured(NOMINAL, np.repeat(corners, 8, axis=0)), held_out=None), NOMINAL, STATED)


@pytest.mark.parametrize("count", [1, 6])
def test_too_few_rows_are_refused(count: int) -> None:
    with pytest.raises(CalibrationError, match="measure more poses"):
        calibrate(measured(NOMINAL, BOX[:count]), NOMINAL, STATED)
    with pytest.raises(CalibrationError, match="measure 6 or more"):
        fit(measured(NOMINAL, BOX[:5]), NOMINAL, STATED)


@pytest.mark.parametrize(("factor", "hint"), [(1e3, "millimetres in columns that say metres"), (1e-3, "say mm")])
def test_positions_in_the_wrong_unit_are_refused(factor: float, hint: str) -> None:
    rows = measured(drawn_arm(1))
    with pytest.raises(CalibrationError, match=hint):
        calibrate(replace(rows, positions=rows.positions * factor), NOMINAL, STATED)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda rows: replace(rows, positions=rows.positions[:, [1, 0, 2]]),
        lambda rows: replace(rows, positions=rows.positions + np.array([0.0, 0.0, 0.095])),
        lambda rows: replace(rows, angles=rows.angles[:, [2, 1, 0]]),
        lambda rows: replace(rows, angles=rows.angles + math.radians(15.0)),
    ],
    ids=["axes swapped", "origin in the motor plane", "limbs swapped", "horn one tooth off"],
)
def test_measurements_of_another_frame_or_mounting_are_refused(spoil: Callable[[Measurements], Measurements]) -> None:
    with pytest.raises(CalibrationError, match="mm from the predicted ones"):
        calibrate(spoil(measured(drawn_arm(1))), NOMINAL, STATED)


def test_angles_that_the_arm_cannot_have_are_refused_with_their_lines() -> None:
    rows = measured(NOMINAL)
    rows.angles[[3, 7]] = [3.0, 0.0, -3.0]
    with pytest.raises(CalibrationError, match="lines 5, 9: an arm angle is far outside the joint limits") as refused:
        calibrate(rows, NOMINAL, STATED)
    assert refused.value.lines == (5, 9)
    short = replace(NOMINAL, rod=0.100, joint_max=math.radians(120.0))
    rows.angles[[3, 7]] = [-1.1, 1.9, 1.9]
    lost = np.isnan(Delta(short).forward(rows.angles).position).any(axis=1)
    with pytest.raises(CalibrationError, match="its rods would not meet") as refused:
        calibrate(rows, short, STATED)
    assert refused.value.lines == tuple(np.flatnonzero(lost) + 2)


@pytest.mark.parametrize("name", ["measurement", "length", "angle"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_uncertainties_are_positive(name: str, value: float) -> None:
    with pytest.raises(CalibrationError, match=name):
        replace(STATED, **{name: value})


# What stands in a file.

GOOD = "1,2,3,2048,2100,2000"


def read(tmp_path: Path, text: str | bytes, encoder: Encoder | None = None) -> Measurements:
    path = tmp_path / "data.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_measurements(path, encoder)


@pytest.mark.parametrize(
    "text",
    [
        f"{HEADER}\n{GOOD}\n",
        f"\ufeff{HEADER}\r\n{GOOD}\r\n\r\n",
        f"{HEADER}\r{GOOD}",
        f"# made on Monday\n\n {HEADER.replace(',', ' , ')}\n{GOOD}\n,,,,,\n# end\n",
        '"# comment, quoted"\n"x_mm","y_mm",z_mm,ticks_0,ticks_1,ticks_2\n"1",2,3,2048,2100,2000\n',
        f"{HEADER.replace(',', ';')}\n1,0;2,0;3,0;2048;2100;2000\n",
        f"{HEADER.replace(',', ';')};;\n1.0;2.0;3.0;2048;2100;2000;;\n",
        f"{HEADER.replace(',', chr(9))}\n{GOOD.replace(',', chr(9))}\n",
        "x_m,y_m,z_m,ticks_0,ticks_1,ticks_2\n0.001,2e-3,+.003,2048.0,2100,2000\n",
        f"pose,target_x_mm,{HEADER},goal_ticks_0\n1,,{GOOD},\n",
    ],
)
def test_files_as_editors_and_spreadsheets_write_them(tmp_path: Path, text: str) -> None:
    rows = read(tmp_path, text)
    assert np.allclose(rows.positions, [[0.001, 0.002, 0.003]], atol=1e-15)
    assert np.allclose(rows.angles, [[0.0, 52 * TICK, -48 * TICK]], atol=1e-15)


def test_angles_instead_of_ticks(tmp_path: Path) -> None:
    for unit, factor in (("deg", 1.0), ("rad", math.pi / 180.0)):
        header = f"x_mm,y_mm,z_mm,angle_0_{unit},angle_1_{unit},angle_2_{unit},held_out"
        rows = read(tmp_path, f"{header}\n1,2,3,{10 * factor},{-20 * factor},{30 * factor},1\n")
        assert np.allclose(rows.angles, np.radians([[10.0, -20.0, 30.0]]))
        assert rows.held_out is not None
        assert rows.held_out.tolist() == [True]
        assert rows.angle_stddev == 0.0


def test_zero_ticks_and_direction_come_from_the_file_or_the_caller_but_not_both_ways(tmp_path: Path) -> None:
    stated = (
        f"# zero_ticks 2000 2048 2048\n# direction: 1 1 -1\n# direction of the probe: from above\n{HEADER}\n{GOOD}\n"
    )
    encoder = Encoder((2000, 2048, 2048), (1, 1, -1))
    assert read(tmp_path, stated).encoder == encoder
    assert read(tmp_path, stated).angles[0].tolist() == [48 * TICK, 52 * TICK, 48 * TICK]
    assert read(tmp_path, stated, encoder).encoder == encoder
    assert read(tmp_path, f"{HEADER}\n{GOOD}\n", encoder).encoder == encoder
    with pytest.raises(CalibrationError, match="the file states"):
        read(tmp_path, stated, Encoder())
    with pytest.raises(CalibrationError, match="not ticks_0"):
        read(tmp_path, "x_mm,y_mm,z_mm,angle_0_deg,angle_1_deg,angle_2_deg\n1,2,3,10,20,30\n", Encoder())
    with pytest.raises(CalibrationError, match=r"line 1: .* three whole numbers"):
        read(tmp_path, f"# zero_ticks 2048 2048\n{HEADER}\n{GOOD}\n")
    with pytest.raises(CalibrationError, match="direction"):
        Encoder(direction=(1, 0, 1))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty"),
        ("# only a comment\n", "the file is empty"),
        (f"{HEADER}\n", "a header and no rows"),
        (f"{HEADER}\n1,2,x,2048,2100,2000\n", "line 2: z_mm is 'x'"),
        (f"# c\n{HEADER}\n{GOOD}\n1,,3,2048,2100,2000\n", "line 4: y_mm is empty"),
        (f"{HEADER}\n1,2,nan,2048,2100,2000\n", "line 2: z_mm is 'nan'"),
        (f"{HEADER}\n1,2,1e999,2048,2100,2000\n", "line 2: z_mm is '1e999'"),
        (f"{HEADER}\n1,2,1_0,2048,2100,2000\n", "line 2: z_mm is '1_0'"),
        (f"{HEADER}\n1,2,３,2048,2100,2000\n", "line 2: z_mm"),
        (f"{HEADER}\n1,5,2,5,3,5,2048,2100,2000\n", "9 cells for 6 columns; are there decimal commas"),
        (f"{HEADER}\n1,2,3,2048,2100\n", "line 2: 5 cells for 6 columns"),
        (f'{HEADER}\n"1,5",2,3,2048,2100,2000\n', "line 2: x_mm is '1,5'"),
        (f'{HEADER}\n1,2,"3\n,2048,2100,2000\n', "line 2: .* must end on its own line"),
        (f"{HEADER.replace(',', ';')}\n1.000,5;2;3;2048;2100;2000\n", "line 2: x_mm is '1.000,5'"),
        ("x_mm,y_mm,ticks_0,ticks_1,ticks_2\n", "column 'z_mm' is missing"),
        ("ticks_0,ticks_1,ticks_2\n", "columns of the measured positions are missing"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "columns of the arm angles are missing"),
        (f"{HEADER},x_m\n", "measured positions are given twice"),
        (f"{HEADER},angle_0_deg\n{GOOD},1\n", "the arm angles are given twice"),
        (f"{HEADER},x_mm\n", "column 'x_mm' appears 2 times"),
        (f"{HEADER},ticks0\n", "unknown column 'ticks0'; did you mean 'ticks_0'"),
        (f"{HEADER},operator\n", "unknown column 'operator'"),
        (f"{HEADER},held_out\n{GOOD},yes\n", "line 2: held_out is 'yes'"),
        (f"{HEADER}\n1,2,3,6048,2100,2000\n", "line 2: ticks_0 is 6048: more than half a turn"),
        ("x_mm,y_mm,z_mm,angle_0_rad,angle_1_rad,angle_2_rad\n1,2,3,0.5,-41.5,0.1\n", "angle_1_rad is -41.5: radians"),
        ("x_mm,y_mm,z_mm,angle_0_deg,angle_1_deg,angle_2_deg\n1,2,3,2048,2,3\n", "is it ticks"),
        ("x_mm,y_mm,z_mm,angle_0_deg,angle_1_deg,angle_2_deg\n1,2,3,0.5,-0.7,1.1\n", "is it radians"),
        (b"\xff\xfex\x00", "UTF-16"),
        (f"{HEADER}\n1,2,\xb3,2048,2100,2000\n".encode("latin-1"), "line 2 is not UTF-8"),
        (b"x_mm\x00", "zero bytes"),
        (f"{HEADER}\n" + f"{GOOD}\n" * 10_001, "10001 rows are more than"),
        (b"#" * 10_000_001, "larger than 10 MB"),
    ],
)
def test_what_is_doubtful_in_a_file_is_refused_with_its_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        read(tmp_path, text)


def test_a_file_gives_what_the_measurements_give(tmp_path: Path) -> None:
    encoder = Encoder((2100, 1990, 2048), (1, -1, 1))
    rows = measured(drawn_arm(5))
    again = read_measurements(write(tmp_path / "data.csv", rows, encoder), encoder)
    assert np.allclose(again.positions, rows.positions, atol=1e-9)
    assert np.allclose(again.angles, rows.angles, atol=1e-9)
    assert again.lines == rows.lines


# Plans and recordings.


def test_a_plan_spans_the_workspace_and_is_read_back_as_written(tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    write_plan(path, POSES, NOMINAL, Encoder())
    again = read_plan(path)
    assert [(pose.number, pose.held_out) for pose in again] == [(pose.number, pose.held_out) for pose in POSES]
    assert np.allclose([pose.position for pose in again], POINTS, atol=1e-6)
    assert (len(POSES), KEPT.sum()) == (36, 9)
    assert (Delta(NOMINAL).inverse(POINTS).status == 0).all()
    assert len(np.unique(POINTS, axis=0)) == 36
    assert plan(NOMINAL, seed=1) != POSES
    with pytest.raises(CalibrationError, match=r"line 6: x_mm is empty"):
        read_measurements(path)


def test_a_plan_beyond_the_reach_is_refused(tmp_path: Path) -> None:
    wide = replace(NOMINAL, workspace_max=(0.4, 0.06, 0.11))
    with pytest.raises(CalibrationError, match=r"pose 2: .*JOINT_LIMIT"):
        write_plan(tmp_path / "plan.csv", plan(wide), wide, Encoder())
    assert not (tmp_path / "plan.csv").exists()


@pytest.mark.parametrize("text", ["pose,held_out\n1,0\n", "target_x_mm\n3\n", ""])
def test_what_is_no_plan_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(CalibrationError):
        read_plan(tmp_path / "plan.csv")


def test_a_recording_is_a_file_of_measurements_and_goes_on_where_it_stopped(tmp_path: Path) -> None:
    path, encoder, rows = tmp_path / "measured.csv", Encoder(direction=(1, -1, 1)), measured(drawn_arm(5))

    def record(recording: Recording, poses: range) -> None:
        for index in poses:
            first, second, third = map(float, encoder.ticks(rows.angles[index]))
            x, y, z = map(float, rows.positions[index])
            recording.append(POSES[index], (first, second, third), (x, y, z))

    record(Recording(path, encoder), range(10))
    path.write_bytes(path.read_bytes().rstrip(b"\n"))  # as an editor leaves it
    resumed = Recording(path, encoder)
    assert resumed.done == set(range(1, 11))
    record(resumed, range(10, 36))
    again = read_measurements(path)
    assert np.allclose(again.positions, rows.positions, atol=1e-7)
    assert np.allclose(again.angles, rows.angles, atol=0.006 * TICK)
    assert again.held_out is not None
    assert (again.held_out == KEPT).all()
    with pytest.raises(CalibrationError, match="other zero ticks"):
        Recording(path, Encoder())
    other = write(tmp_path / "other.csv", rows)
    with pytest.raises(CalibrationError, match="no recording"):
        Recording(other, encoder)


def test_a_fit_leaves_everything_but_the_limbs_alone() -> None:
    start = replace(NOMINAL, z_offset=0.0951, limbs=(LimbAdjustment(arm=0.1002), LimbAdjustment(), LimbAdjustment()))
    found: Calibration = calibrate(measured(start), start, STATED)
    assert replace(found.fit.geometry, limbs=start.limbs) == start
