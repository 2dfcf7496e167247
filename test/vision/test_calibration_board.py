# SPDX-License-Identifier: Apache-2.0
"""Boards by name, and accuracy of their corners in rendered images."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_vision.errors import BoardError
from deltacharger_vision.hand_eye.board import AprilTag, Board, Charuco, markers_in, parse_board
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.poses import turn
from deltacharger_vision.projection import project
from deltacharger_vision.rendering.board_drawing import with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import RenderedScene, shifted

from .views import DISTORTIONS, view

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

BOARDS = [
    AprilTag(),
    AprilTag("25h9", 3, 0.03),
    Charuco(),
    Charuco("5x5_100", 4, 3, 0.015, 0.011),
    Charuco("6x6_250", 4, 4, 0.018, 0.014),
]
IDEAL, USUAL = SimulatedCamera(parameters=CameraParameters.ideal()), SimulatedCamera()
BACKGROUND = RenderedScene(target=False, parameters=SceneParameters.even())


def drawn_pose(seed: int) -> np.ndarray:
    """Return camera_T_board of a board that faces the camera within 40°, fully inside the image."""
    random = np.random.default_rng(seed)
    pose = shifted((random.uniform(-0.05, 0.05), random.uniform(-0.02, 0.02), random.uniform(0.14, 0.20)))
    tilt = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(-math.pi, math.pi))
    pose[:3, :3] = turn(tilt * (1, 1, 0)) @ turn(tilt * (0, 0, 1)) @ np.diag([1.0, -1.0, -1.0])
    return pose


def image(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL, seed: int = 0) -> np.ndarray:
    scene = with_board(BACKGROUND, board, pose, in_camera=True)
    return camera.render(scene, view(0.5), np.random.default_rng(seed), color_only=True).color


def errors(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL) -> np.ndarray:
    """Return the errors (K, 2) px of the detected corners."""
    found = board.detect(image(board, pose, camera))
    assert found is not None
    points = found.corners @ pose[:3, :3].T + pose[:3, 3]
    return found.pixels - project(points, camera.intrinsics)


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.name)
def test_corners_are_found_to_a_small_part_of_a_pixel(board: Board) -> None:
    ideal = np.concatenate([errors(board, drawn_pose(seed), IDEAL) for seed in range(8)])
    usual = np.concatenate([errors(board, drawn_pose(seed)) for seed in range(8)])
    assert np.sqrt(np.mean(ideal**2)) < 0.05
    assert np.sqrt(np.mean(usual**2)) < 0.05
    assert np.abs(usual.mean(axis=0)).max() < 0.02


@pytest.mark.parametrize("distortion", DISTORTIONS[1:], ids=["plumb_bob", "rational"])
def test_lens_distortion_does_not_displace_corners(distortion: tuple[float, ...]) -> None:
    camera = SimulatedCamera(Intrinsics(640, 400, 441.0, 441.0, 319.5, 199.5, distortion), CameraParameters.ideal())
    for board in BOARDS[:3:2]:
        found = np.concatenate([errors(board, drawn_pose(seed), camera) for seed in range(4)])
        assert np.sqrt(np.mean(found**2)) < 0.12


def test_a_dark_image_does_not_displace_corners() -> None:
    camera = SimulatedCamera(parameters=CameraParameters(exposure=0.3))
    for board in (AprilTag(), Charuco()):
        found = np.concatenate([errors(board, drawn_pose(seed), camera) for seed in range(6)])
        assert np.sqrt(np.mean(found**2)) < 0.10


def test_over_exposure_is_detected_and_shrinks_a_tag_but_not_a_chessboard() -> None:
    camera = SimulatedCamera(parameters=CameraParameters(exposure=2.5))
    tag, chess = (
        np.concatenate([errors(board, drawn_pose(seed), camera) for seed in range(6)])
        for board in (AprilTag(), Charuco())
    )
    assert np.sqrt(np.mean(tag**2)) > 0.15
    assert np.sqrt(np.mean(chess**2)) < 0.06
    whites = []
    for each in (USUAL, camera):
        found = AprilTag().detect(image(AprilTag(), drawn_pose(0), each))
        assert found is not None
        whites.append(found.white)
    assert whites[0] < 240 < 250 < whites[1]


def test_corner_numbers_match_the_print() -> None:
    for board in (AprilTag(), Charuco()):
        pose = shifted((0.0, 0.0, 0.2))
        pose[:3, :3] = np.diag([1.0, -1.0, -1.0])  # upright, straight ahead
        found = board.detect(image(board, pose))
        assert found is not None
        np.testing.assert_array_equal(found.corners, board.corners())
        first, last = found.pixels[0], found.pixels[-1]
        assert first[0] < OAK_D.cx
        assert first[1] < OAK_D.cy < last[1]


def test_a_cut_off_or_averted_board_is_not_detected() -> None:
    upright = shifted((0.0, 0.0, 0.2))
    upright[:3, :3] = np.diag([1.0, -1.0, -1.0])
    away = upright @ np.diag([-1.0, 1.0, -1.0, 1.0])
    for board in (AprilTag(), Charuco()):
        assert board.detect(image(board, shifted((0.135, 0.0, 0.0)) @ upright)) is None or board.name.startswith("char")
        assert board.detect(image(board, away)) is None
        assert board.detect(np.zeros((400, 640), dtype=np.uint8)) is None


def test_a_charuco_board_is_detected_in_part() -> None:
    upright = shifted((0.135, 0.0, 0.2))
    upright[:3, :3] = np.diag([1.0, -1.0, -1.0])
    board = Charuco()
    found = board.detect(image(board, upright))
    assert found is not None
    assert 4 <= len(found.corners) < len(board.corners())
    assert np.abs(errors(board, upright)).max() < 0.3


def test_other_boards_are_rejected_and_named() -> None:
    pose = drawn_pose(1)
    seen = image(AprilTag(tag=7), pose)
    assert AprilTag(tag=0).detect(seen) is None
    assert AprilTag("25h9", 0).detect(seen) is None
    assert Charuco().detect(seen) is None
    assert "apriltag 36h11 7" in markers_in(seen)
    assert any(name.startswith("marker 4x4") for name in markers_in(image(Charuco(), pose)))
    assert markers_in(np.zeros((400, 640), dtype=np.uint8)) == ()


def test_a_duplicate_tag_is_rejected() -> None:
    left, right = (drawn_pose(2) for _ in range(2))
    left[:3, 3], right[:3, 3] = (-0.06, 0.0, 0.2), (0.06, 0.0, 0.2)
    board = AprilTag()
    scene = with_board(with_board(BACKGROUND, board, left, True), board, right, True)
    seen = USUAL.render(scene, view(0.5), np.random.default_rng(0), color_only=True).color
    assert board.detect(seen) is None
    assert board.detect(image(board, left)) is not None


def test_gray_and_colour_give_the_same_corners() -> None:
    seen = image(AprilTag(), drawn_pose(3))
    color, gray = AprilTag().detect(seen), AprilTag().detect(np.ascontiguousarray(seen[:, :, 1]))
    assert color is not None
    assert gray is not None
    np.testing.assert_allclose(color.pixels, gray.pixels, atol=0.1)
    for wrong in (seen.astype(float), seen[:, :, :2], seen[None]):
        with pytest.raises(BoardError, match="image"):
            AprilTag().detect(wrong)


def test_names_can_be_parsed() -> None:
    for board in BOARDS:
        marker = board.marker if isinstance(board, Charuco) else None
        assert parse_board(board.name, board.length, marker) == board
    assert parse_board("APRILTAG:36h11:5", 0.04) == AprilTag(tag=5)
    assert parse_board("charuco:4x4_50:5x4", 0.012, 0.009) == Charuco()
    three_quarters = parse_board("charuco:4x4_50:5x4", 0.012)
    assert isinstance(three_quarters, Charuco)
    assert three_quarters.marker == pytest.approx(0.009)


@pytest.mark.parametrize(
    ("text", "size", "marker", "what"),
    [
        ("", 0.04, None, "is not a board"),
        ("apriltag", 0.04, None, "is not a board"),
        ("apriltag:36h11", 0.04, None, "is not a board"),
        ("apriltag:36h11:x", 0.04, None, "is not a board"),
        ("apriltag:36h11:587", 0.04, None, "tags 0…586"),
        ("apriltag:36h11:-1", 0.04, None, "-1 is not in"),
        ("apriltag:36h9:0", 0.04, None, "36h11"),
        ("apriltag:36h11:0", 40.0, None, "outside 2…1000 mm"),
        ("apriltag:36h11:0", math.nan, None, "outside"),
        ("apriltag:36h11:0", 0.04, 0.03, "one size"),
        ("charuco:4x4_50:5", 0.012, None, "is not a board"),
        ("charuco:4x4_50:2x4", 0.012, None, "give 3…30"),
        ("charuco:4x4_50:12x12", 0.012, None, "too few"),
        ("charuco:9x9_50:5x4", 0.012, None, "none of"),
        ("charuco:4x4_50:5x4", 0.012, 0.012, "0.3…0.95"),
        ("checkerboard:5x4", 0.012, None, "is not a board"),
    ],
)
def test_invalid_board_names_are_refused_with_a_reason(text: str, size: float, marker: float | None, what: str) -> None:
    with pytest.raises(BoardError, match=what):
        parse_board(text, size, marker)
