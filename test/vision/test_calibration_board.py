# SPDX-License-Identifier: Apache-2.0
"""Boards: names, accuracy of their corners in rendered images, and the print."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from deltacharger_vision.errors import BoardError
from deltacharger_vision.hand_eye.board import Board, dictionary
from deltacharger_vision.images import project
from deltacharger_vision.rendering.board_drawing import board_svg, with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene, shifted
from deltacharger_vision.terminal import turn

from ..marks import rest
from .views import DISTORTIONS, EVEN, IDEAL, view

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

UPRIGHT = shifted((0.0, 0.0, 0.2)) @ np.diag([1.0, -1.0, -1.0, 1.0])
EXACT, USUAL = SimulatedCamera(parameters=IDEAL), SimulatedCamera()
DARK, BRIGHT = (SimulatedCamera(parameters=CameraParameters(exposure=each)) for each in (0.3, 2.5))
BACKGROUND = RenderedScene(target=False, parameters=EVEN)


def drawn_pose(seed: int) -> np.ndarray:
    """Return camera_T_board of a board that faces the camera within 40°, fully inside the image."""
    random = np.random.default_rng(seed)
    pose = shifted((random.uniform(-0.05, 0.05), random.uniform(-0.02, 0.02), random.uniform(0.14, 0.20)))
    tilt = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(-math.pi, math.pi))
    pose[:3, :3] = turn(tilt * (1, 1, 0)) @ turn(tilt * (0, 0, 1)) @ np.diag([1.0, -1.0, -1.0])
    return pose


def image(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL) -> np.ndarray:
    scene = with_board(BACKGROUND, board, pose)
    return camera.render(scene, view(0.5), np.random.default_rng(0), color_only=True).color


def rms(board: Board, count: int, camera: SimulatedCamera) -> float:
    """Return the error, px, of one coordinate over `count` views."""
    off = []
    for pose in map(drawn_pose, range(count)):
        found = board.detect(image(board, pose, camera))
        assert found is not None
        off.append(found.pixels - project(found.corners @ pose[:3, :3].T + pose[:3, 3], camera.intrinsics))
    return float(np.sqrt(np.mean(np.square(off))))


@pytest.mark.parametrize(("board", "count"), [(Board(), 3), rest(Board(), 8), rest(Board("25h9", 3, 0.03), 8)])
def test_corners_are_found_to_a_small_part_of_a_pixel(board: Board, count: int) -> None:
    assert rms(board, count, EXACT) < 0.05
    assert rms(board, count, USUAL) < 0.05


def test_neither_a_lens_nor_exposure_displaces_corners_except_an_over_exposed_white() -> None:
    board = Board()
    for distortion in DISTORTIONS[1:]:
        lens = dataclasses.replace(OAK_D, distortion=distortion)
        assert rms(board, 1, SimulatedCamera(lens, IDEAL)) < 0.12
    assert rms(board, 2, DARK) < 0.10
    assert rms(board, 3, BRIGHT) > 0.15
    usual, bright = (board.detect(image(board, drawn_pose(0), camera)) for camera in (USUAL, BRIGHT))
    assert usual.white < 240 < 250 < bright.white


def test_a_cut_off_averted_other_or_doubled_board_is_not_detected() -> None:
    board = Board(tag=7)
    seen = image(board, UPRIGHT)
    gray, color = (board.detect(each) for each in (np.ascontiguousarray(seen[:, :, 1]), seen))
    np.testing.assert_allclose(color.pixels, gray.pixels, atol=0.1)
    assert board.detect(image(board, shifted((0.135, 0.0, 0.0)) @ UPRIGHT)) is None
    assert board.detect(image(board, UPRIGHT @ np.diag([-1.0, 1.0, -1.0, 1.0]))) is None
    assert Board(tag=0).detect(seen) is None
    assert Board("25h9", 0).detect(seen) is None
    assert board.detect(np.concatenate([seen, seen])) is None


def test_tags_are_found_by_the_interface_that_opencv_had_before_4_7(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, new = image(Board(), UPRIGHT), cv2.aruco
    found = Board().detect(seen)
    if hasattr(new, "ArucoDetector"):  # an older OpenCV has found it by its own
        old = SimpleNamespace(
            detectMarkers=lambda gray, known, parameters: new.ArucoDetector(known, parameters).detectMarkers(gray),
            DetectorParameters_create=new.DetectorParameters,
        )
        monkeypatch.setattr(cv2, "aruco", old)
        np.testing.assert_array_equal(Board().detect(seen).pixels, found.pixels)
    monkeypatch.delattr(cv2, "aruco")
    with pytest.raises(ModuleNotFoundError, match=r"OpenCV \d.*4\.7.*opencv-contrib"):
        dictionary.__wrapped__("36h11")


def test_names_are_read_and_invalid_ones_refused_with_a_reason() -> None:
    board = Board("25h9", 3, 0.03)
    assert Board.named(board.name.upper(), board.size) == board
    for text, size, noun in (
        ("apriltag:36h11", 0.04, "write apriltag"),
        ("charuco:4x4_50:5x4", 0.04, "write apriltag"),
        ("apriltag:36h11:587", 0.04, "586"),
        ("apriltag:36h9:0", 0.04, "36h11"),
        ("apriltag:36h11:0", 40.0, "mm"),
        ("apriltag:36h11:0", math.nan, "mm"),
    ):
        with pytest.raises(BoardError, match=noun):
            Board.named(text, size)


def test_the_print_is_the_board_in_true_size() -> None:
    import xml.etree.ElementTree as Xml

    scale, board = 12, Board()  # px/mm
    drawing = Xml.fromstring(board_svg(board))
    size = [float(drawing.attrib[key].removesuffix("mm")) for key in ("height", "width")]
    paper = np.full([round(scale * length) for length in size], 255, dtype=np.uint8)
    for area in drawing.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, width, height = (float(area.attrib[key]) for key in ("x", "y", "width", "height"))
        left, top, right, bottom = (round(scale * edge) for edge in (x, y, x + width, y + height))
        paper[top:bottom, left:right] = 0 if area.attrib["fill"] == "black" else 255
    found = board.detect(paper)
    assert found is not None
    # Pixels count from the middle of the first one, y down.
    middle = (np.array(size[::-1]) - (0.0, 6.0)) / 2
    millimetres = (found.pixels + 0.5) / scale - middle
    np.testing.assert_allclose(millimetres, 1e3 * found.corners[:, :2] * (1, -1), atol=0.1)
    assert board.name in "".join(drawing.itertext())
