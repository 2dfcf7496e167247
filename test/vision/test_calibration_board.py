# SPDX-License-Identifier: Apache-2.0
"""Boards: names, accuracy of their corners in rendered images, and the print."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from deltacharger_vision.errors import BoardError, RenderingError
from deltacharger_vision.hand_eye.board import (
    AprilTag,
    Board,
    Charuco,
    dictionary,
    find_markers,
    markers_in,
    parse_board,
)
from deltacharger_vision.images import project
from deltacharger_vision.rendering.board_drawing import board_boxes, board_svg, with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene, SceneParameters, shifted
from deltacharger_vision.terminal import turn

from ..marks import rest
from .views import DISTORTIONS, view

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

BOARDS = [
    AprilTag(),
    Charuco(),
    AprilTag("25h9", 3, 0.03),
    Charuco("5x5_100", 4, 3, 0.015, 0.011),
    Charuco("6x6_250", 4, 4, 0.018, 0.014),
]
AHEAD, UPRIGHT = (shifted((0.0, 0.0, z)) @ np.diag([1.0, -1.0, -1.0, 1.0]) for z in (0.15, 0.2))
IDEAL, USUAL = SimulatedCamera(parameters=CameraParameters.ideal()), SimulatedCamera()
BACKGROUND = RenderedScene(target=False, parameters=SceneParameters.even())


def drawn_pose(seed: int) -> np.ndarray:
    """Return camera_T_board of a board that faces the camera within 40°, fully inside the image."""
    random = np.random.default_rng(seed)
    pose = shifted((random.uniform(-0.05, 0.05), random.uniform(-0.02, 0.02), random.uniform(0.14, 0.20)))
    tilt = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(-math.pi, math.pi))
    pose[:3, :3] = turn(tilt * (1, 1, 0)) @ turn(tilt * (0, 0, 1)) @ np.diag([1.0, -1.0, -1.0])
    return pose


def render(scene: RenderedScene, camera: SimulatedCamera = IDEAL, seed: int = 0) -> np.ndarray:
    return camera.render(scene, view(0.5), np.random.default_rng(seed), color_only=True).color


def image(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL) -> np.ndarray:
    return render(with_board(BACKGROUND, board, pose, in_camera=True), camera)


def errors(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL) -> np.ndarray:
    """Return the errors (K, 2) px of the detected corners."""
    found = board.detect(image(board, pose, camera))
    assert found is not None
    points = found.corners @ pose[:3, :3].T + pose[:3, 3]
    return found.pixels - project(points, camera.intrinsics)


def rms(board: Board, count: int, camera: SimulatedCamera) -> float:
    """Return the error, px, of one coordinate over `count` views."""
    off = np.concatenate([errors(board, drawn_pose(seed), camera) for seed in range(count)])
    return float(np.sqrt(np.mean(off**2)))


LENSES = [dataclasses.replace(OAK_D, distortion=each) for each in DISTORTIONS[1:]]
DARK, BRIGHT = (SimulatedCamera(parameters=CameraParameters(exposure=each)) for each in (0.3, 2.5))


@pytest.mark.parametrize(
    ("board", "count"), [(BOARDS[0], 3), (BOARDS[1], 1), *(rest(board, 8) for board in BOARDS)], ids=str
)
def test_corners_are_found_to_a_small_part_of_a_pixel(board: Board, count: int) -> None:
    assert rms(board, count, IDEAL) < 0.05
    assert rms(board, count, USUAL) < 0.05


@pytest.mark.parametrize("board", [BOARDS[0], rest(BOARDS[1])], ids=str)
def test_neither_a_lens_nor_exposure_displaces_corners_except_of_an_over_exposed_tag(board: Board) -> None:
    for lens in LENSES:
        assert rms(board, 1, SimulatedCamera(lens, CameraParameters.ideal())) < 0.12
    assert rms(board, 2, DARK) < 0.10
    shrinks = isinstance(board, AprilTag)
    assert (rms(board, 3, BRIGHT) > 0.15) == shrinks
    assert (rms(board, 3, BRIGHT) < 0.06) != shrinks
    usual, bright = (board.detect(image(board, drawn_pose(0), camera)) for camera in (USUAL, BRIGHT))
    assert usual.white < 240 < 250 < bright.white


@pytest.mark.parametrize("board", BOARDS[:2], ids=str)
def test_a_cut_off_or_averted_board_is_not_detected_or_in_part(board: Board) -> None:
    aside = shifted((0.135, 0.0, 0.0)) @ UPRIGHT
    part = board.detect(image(board, aside))
    assert (part is None) == isinstance(board, AprilTag)
    if part is not None:
        assert 4 <= len(part.corners) < len(board.corners())
        assert np.abs(errors(board, aside)).max() < 0.3
    assert board.detect(image(board, UPRIGHT @ np.diag([-1.0, 1.0, -1.0, 1.0]))) is None
    assert board.detect(np.zeros((400, 640), dtype=np.uint8)) is None


def test_other_and_duplicate_boards_are_rejected_and_named() -> None:
    seen = image(AprilTag(tag=7), UPRIGHT)
    for board in (AprilTag(tag=0), AprilTag("25h9", 0), Charuco()):
        assert board.detect(seen) is None
    assert "apriltag 36h11 7" in markers_in(seen)
    assert markers_in(np.zeros((400, 640), dtype=np.uint8)) == ()
    left, right = (shifted((x, 0.0, 0.0)) @ UPRIGHT for x in (-0.06, 0.06))
    scene = with_board(with_board(BACKGROUND, AprilTag(), left, True), AprilTag(), right, True)
    assert AprilTag().detect(render(scene, USUAL)) is None
    gray, color = (AprilTag(tag=7).detect(each) for each in (np.ascontiguousarray(seen[:, :, 1]), seen))
    np.testing.assert_allclose(color.pixels, gray.pixels, atol=0.1)
    for wrong in (seen.astype(float), seen[:, :, :2], seen[None]):
        with pytest.raises(BoardError, match="image"):
            AprilTag().detect(wrong)


@pytest.mark.parametrize("board", BOARDS[:2], ids=str)
def test_markers_are_found_by_the_interface_that_opencv_had_before_4_7(
    board: Board, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen, (name, *_) = image(board, AHEAD)[:, :, 1], dataclasses.astuple(board)
    quads, numbers = find_markers(name, seen)
    assert len(numbers) == (1 if isinstance(board, AprilTag) else 10)
    new = cv2.aruco
    if hasattr(new, "ArucoDetector"):  # an older OpenCV has found them by its own

        def detect_markers(gray: np.ndarray, known: object, parameters: object) -> object:
            return new.ArucoDetector(known, parameters).detectMarkers(gray)

        old = SimpleNamespace(detectMarkers=detect_markers, DetectorParameters_create=new.DetectorParameters)
        monkeypatch.setattr(cv2, "aruco", old)
        np.testing.assert_array_equal(find_markers(name, seen)[0], quads)


def test_an_opencv_without_markers_is_refused_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "aruco")
    with pytest.raises(ModuleNotFoundError, match=r"OpenCV \d.*4\.7.*opencv-contrib"):
        dictionary.__wrapped__("36h11")


@pytest.mark.skipif(not hasattr(cv2.aruco, "CharucoDetector"), reason="OpenCV drew another pattern before 4.7")
@pytest.mark.parametrize("board", [each for each in BOARDS if isinstance(each, Charuco)], ids=str)
def test_a_charuco_board_is_the_one_that_opencv_draws(board: Charuco) -> None:
    side = 60  # px
    squares = (board.columns, board.rows)
    theirs = cv2.aruco.CharucoBoard(squares, board.square, board.marker, dictionary(board.dictionary))
    drawn = theirs.generateImage((side * board.columns, side * board.rows), marginSize=0)
    found = board.detect(np.pad(drawn, side // 2, constant_values=255))
    assert found is not None
    assert len(found.corners) == len(board.corners())
    expected = side * (found.corners[:, :2] / board.square * (1, -1) + np.array(squares) / 2) + side // 2 - 0.5
    np.testing.assert_allclose(found.pixels, expected, atol=0.1)


def test_names_can_be_parsed() -> None:
    for board in BOARDS:
        marker = board.marker if isinstance(board, Charuco) else None
        assert parse_board(board.name.upper() if marker is None else board.name, board.length, marker) == board
    three_quarters = parse_board("charuco:4x4_50:5x4", 0.012)
    assert isinstance(three_quarters, Charuco)
    assert three_quarters.marker == pytest.approx(0.009)


@pytest.mark.parametrize(
    ("text", "size", "marker", "noun"),
    [
        *((text, 0.04, None, "board") for text in ("", "apriltag:36h11", "apriltag:36h11:x", "checkerboard:5x4")),
        ("apriltag:36h11:587", 0.04, None, "586"),
        ("apriltag:36h11:-1", 0.04, None, "-1"),
        ("apriltag:36h9:0", 0.04, None, "36h11"),
        *(("apriltag:36h11:0", size, None, "mm") for size in (40.0, math.nan)),
        ("apriltag:36h11:0", 0.04, 0.03, "one size"),
        ("charuco:4x4_50:5", 0.012, None, "board"),
        ("charuco:4x4_50:2x4", 0.012, None, "3…30"),
        ("charuco:4x4_50:12x12", 0.012, None, "too few"),
        ("charuco:9x9_50:5x4", 0.012, None, "none of"),
        ("charuco:4x4_50:5x4", 0.012, 0.012, "0.95"),
    ],
)
def test_invalid_board_names_are_refused_with_a_reason(text: str, size: float, marker: float | None, noun: str) -> None:
    with pytest.raises(BoardError, match=noun):
        parse_board(text, size, marker)


def test_a_board_moves_with_the_terminal_and_is_hidden_by_things_in_front() -> None:
    board, in_front = AprilTag(), shifted((0.02, 0.0, -0.05)) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    fixed = with_board(BACKGROUND, board, view(0.5) @ in_front, in_camera=True)
    image = render(fixed)
    np.testing.assert_array_equal(image, render(with_board(BACKGROUND, board, in_front)))
    assert board.detect(image) is not None
    hidden = with_board(fixed, AprilTag(tag=5), AHEAD, in_camera=True)
    assert board.detect(render(hidden)) is None
    with pytest.raises(RenderingError):
        board_boxes(board, np.diag([2.0, 1.0, 1.0, 1.0]))


@pytest.mark.parametrize("board", [AprilTag(), Charuco()], ids=lambda board: board.name)
def test_the_print_is_the_board_in_true_size(board: Board) -> None:
    import xml.etree.ElementTree as Xml

    scale = 12  # px/mm
    drawing = Xml.fromstring(board_svg(board))
    size = [float(drawing.attrib[key].removesuffix("mm")) for key in ("height", "width")]
    paper = np.full([round(scale * length) for length in size], 255, dtype=np.uint8)
    for area in drawing.iter("{http://www.w3.org/2000/svg}rect"):
        x, y, width, height = (float(area.attrib[key]) for key in ("x", "y", "width", "height"))
        left, top, right, bottom = (round(scale * edge) for edge in (x, y, x + width, y + height))
        paper[top:bottom, left:right] = 0 if area.attrib["fill"] == "black" else 255
    found = board.detect(paper)
    assert found is not None
    assert len(found.corners) == len(board.corners())
    # Pixels count from the middle of the first one, y down.
    middle = (np.array(size[::-1]) - (0.0, 6.0)) / 2
    millimetres = (found.pixels + 0.5) / scale - middle
    np.testing.assert_allclose(millimetres, 1e3 * found.corners[:, :2] * (1, -1), atol=0.1)
    assert board.name in "".join(drawing.itertext())
