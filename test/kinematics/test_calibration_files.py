# SPDX-License-Identifier: Apache-2.0
"""Reading, writing and refusing files of measurements, plans and recordings."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from deltacharger_kinematics import Delta
from deltacharger_kinematics.calibration.data import TICK, Encoder, Measurements, read_measurements
from deltacharger_kinematics.calibration.plan import plan, read_plan, write_plan
from deltacharger_kinematics.calibration.recording import PoseRecording
from deltacharger_kinematics.calibration.table import CalibrationError

from .measured_arms import HEADER, KEPT, NOMINAL, POINTS, POSES, drawn_arm, measured, write

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


def test_zero_ticks_and_direction_of_file_and_caller_must_agree(tmp_path: Path) -> None:
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
        (f"{HEADER}\n", "a header and no rows"),
        (f"{HEADER}\n1,2,x,2048,2100,2000\n", "line 2: z_mm"),
        (f"# c\n{HEADER}\n{GOOD}\n1,,3,2048,2100,2000\n", "line 4: y_mm is empty"),
        (f"{HEADER}\n1,2,nan,2048,2100,2000\n", "line 2: z_mm is 'nan'"),
        (f"{HEADER}\n1,2,３,2048,2100,2000\n", "line 2: z_mm"),
        (f"{HEADER}\n1,5,2,5,3,5,2048,2100,2000\n", "9 cells for 6 columns; are there decimal commas"),
        (f"{HEADER}\n1,2,3,2048,2100\n", "line 2: 5 cells for 6 columns"),
        (f'{HEADER}\n1,2,"3\n,2048,2100,2000\n', "line 2: .* must end on its own line"),
        (f"{HEADER.replace(',', ';')}\n1.000,5;2;3;2048;2100;2000\n", "line 2: x_mm is '1.000,5'"),
        ("x_mm,y_mm,ticks_0,ticks_1,ticks_2\n", "column 'z_mm' is missing"),
        ("x_mm,y_mm,z_mm\n1,2,3\n", "columns of the arm angles are missing"),
        (f"{HEADER},angle_0_deg\n{GOOD},1\n", "the arm angles are given twice"),
        (f"{HEADER},x_mm\n", "column 'x_mm' appears 2 times"),
        (f"{HEADER},ticks0\n", "unknown column 'ticks0'; did you mean 'ticks_0'"),
        (f"{HEADER},held_out\n{GOOD},yes\n", "line 2: held_out is 'yes'"),
        (f"{HEADER}\n1,2,3,6048,2100,2000\n", "line 2: ticks_0 is 6048: more than half a turn"),
        ("x_mm,y_mm,z_mm,angle_0_rad,angle_1_rad,angle_2_rad\n1,2,3,0.5,-41.5,0.1\n", "angle_1_rad is -41.5: radians"),
        ("x_mm,y_mm,z_mm,angle_0_deg,angle_1_deg,angle_2_deg\n1,2,3,0.5,-0.7,1.1\n", "is it radians"),
        (b"\xff\xfex\x00", "UTF-16"),
        (f"{HEADER}\n1,2,\xb3,2048,2100,2000\n".encode("latin-1"), "line 2 is not UTF-8"),
        (f"{HEADER}\n" + f"{GOOD}\n" * 10_001, "more than 10000 rows"),
        (b"#" * 4_200_000, "more than the 4 MB"),
    ],
)
def test_doubtful_cells_are_refused_with_their_line(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        read(tmp_path, text)


def test_measurements_survive_writing_and_reading(tmp_path: Path) -> None:
    encoder = Encoder((2100, 1990, 2048), (1, -1, 1))
    rows = measured(drawn_arm(5))
    again = read_measurements(write(tmp_path / "data.csv", rows, encoder), encoder)
    assert np.allclose(again.positions, rows.positions, atol=1e-9)
    assert np.allclose(again.angles, rows.angles, atol=1e-9)
    assert again.lines == rows.lines


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
def test_an_invalid_plan_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.csv").write_text(text)
    with pytest.raises(CalibrationError):
        read_plan(tmp_path / "plan.csv")


def test_a_recording_is_a_measurement_file_and_can_resume(tmp_path: Path) -> None:
    path, encoder, rows = tmp_path / "measured.csv", Encoder(direction=(1, -1, 1)), measured(drawn_arm(5))

    def record(recording: PoseRecording, poses: range) -> None:
        for index in poses:
            first, second, third = map(float, encoder.ticks(rows.angles[index]))
            x, y, z = map(float, rows.positions[index])
            recording.append(POSES[index], (first, second, third), (x, y, z))

    record(PoseRecording(path, encoder), range(10))
    path.write_bytes(path.read_bytes().rstrip(b"\n"))  # as saved by an editor
    resumed = PoseRecording(path, encoder)
    assert resumed.done == set(range(1, 11))
    record(resumed, range(10, 36))
    again = read_measurements(path)
    assert np.allclose(again.positions, rows.positions, atol=1e-7)
    assert np.allclose(again.angles, rows.angles, atol=0.006 * TICK)
    assert again.held_out is not None
    assert (again.held_out == KEPT).all()
    with pytest.raises(CalibrationError, match="other zero ticks"):
        PoseRecording(path, Encoder())
    other = write(tmp_path / "other.csv", rows)
    with pytest.raises(CalibrationError, match="no recording"):
        PoseRecording(other, encoder)
