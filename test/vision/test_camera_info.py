# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deltacharger_vision.cameras.camera_info import from_camera_info, load_camera_info
from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.images import Intrinsics

CALIBRATION = """\
image_width: 640
image_height: 400
camera_name: oak
camera_matrix:
  rows: 3
  cols: 3
  data: [441.0, 0, 320.1, 0, 442.0, 199.2, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.1, 0.02, 0.001, -0.002, 0.003]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
ECHOED = """\
header:
  stamp: {sec: 1, nanosec: 2}
  frame_id: camera_color_optical_frame
height: 400
width: 640
distortion_model: plumb_bob
d:
- -0.1
- 0.02
- 0.001
- -0.002
- 0.003
k: [441.0, 0.0, 320.1, 0.0, 442.0, 199.2, 0.0, 0.0, 1.0]
r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}
---
height: 1
"""
EXPECTED = Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2, (-0.1, 0.02, 0.001, -0.002, 0.003))
K = [441.0, 0.0, 320.1, 0.0, 442.0, 199.2, 0.0, 0.0, 1.0]


def load(folder: Path, text: str) -> Intrinsics:
    path = folder / "camera.yaml"
    path.write_text(text)
    return load_camera_info(path)


@pytest.mark.parametrize("text", [CALIBRATION, ECHOED], ids=["calibration", "echoed"])
def test_both_formats_give_the_same_intrinsics(tmp_path: Path, text: str) -> None:
    assert load(tmp_path, text) == EXPECTED


def test_a_camera_without_distortion_has_none() -> None:
    plain = Intrinsics(640, 400, 441.0, 442.0, 320.1, 199.2)
    for d, model in (([], ""), ([], "none"), ([0.0] * 5, "none"), ([0.0] * 5, "plumb_bob"), ([0.0] * 14, "plumb_bob")):
        assert from_camera_info(640, 400, K, d, model) == plain


def test_missing_and_extra_coefficients_are_zero() -> None:
    four = from_camera_info(640, 400, K, [-0.1, 0.02, 0.001, -0.002], "plumb_bob")
    assert four.distortion == (-0.1, 0.02, 0.001, -0.002, 0.0)
    eight = [1.0, 2.0, 0.0, 0.0, 3.0, 4.0, 5.0, 6.0]
    fourteen = from_camera_info(640, 400, K, [*eight, *[0.0] * 6], "rational_polynomial")
    assert fourteen.distortion == tuple(eight)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("441.0, 0, 320.1, 0, 442.0, 199.2, 0, 0, 1", "0, 0, 0, 0, 0, 0, 0, 0, 0", "calibrate the camera first"),
        ("441.0, 0, 320.1", "441.0, 320.1", "has 8 numbers"),
        ("441.0, 0, 320.1", "441.0, 2.5, 320.1", "row by row"),
        ("441.0, 0, 320.1", ".nan, 0, 320.1", "fx"),
        ("441.0, 0, 320.1", "-441.0, 0, 320.1", "fx"),
        ("441.0, 0, 320.1", "wide, 0, 320.1", "not a number"),
        ("plumb_bob", "equidistant", "equidistant"),
        ("plumb_bob", "none", "without a model"),
        ("0.003]", "0.003, 0.5]", "rational_polynomial|plumb_bob"),
        ("-0.1,", ".inf,", "distortion"),
        ("image_width: 640", "image_width: 0", "width"),
        ("image_width: 640", "image_width: many", "width"),
        ("image_width: 640\n", "", "image_width"),
        ("distortion_model: plumb_bob\n", "", "distortion_model"),
        ("camera_name: oak", "binning_x: 2", "binning_x"),
        ("camera_name: oak", "roi: {x_offset: 3}", "roi"),
        ("camera_matrix:", "camera_matrix: [", "YAML"),
    ],
)
def test_errors_of_a_bad_file_state_what_to_do(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in CALIBRATION
    with pytest.raises(CameraInfoError, match=words) as caught:
        load(tmp_path, CALIBRATION.replace(old, new))
    assert str(tmp_path) in caught.value.source


@pytest.mark.parametrize("text", ["", "- 1", "4", "camera_matrix: 4\nimage_width: 640\nimage_height: 400\n"])
def test_other_files_are_not_calibrations(tmp_path: Path, text: str) -> None:
    with pytest.raises(CameraInfoError):
        load(tmp_path, text)


@pytest.mark.parametrize("k", [None, 4, [True] * 9, K[:8]])
def test_a_message_with_another_matrix_is_refused(k: Any) -> None:
    with pytest.raises(CameraInfoError, match="camera matrix"):
        from_camera_info(640, 400, k, [], "none")
