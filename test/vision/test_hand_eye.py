# SPDX-License-Identifier: Apache-2.0
"""Laws of hand-eye calibration: exact data, the exact mount; noise stays in the covariance; the board and its print."""

import dataclasses
import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from deltacharger_vision import images, terminal
from deltacharger_vision.errors import BoardError
from deltacharger_vision.hand_eye import fit
from deltacharger_vision.hand_eye.board import Board, dictionary
from deltacharger_vision.hand_eye.calibrate import Calibration, calibrate, doubts, held_out_rms
from deltacharger_vision.rendering.board_drawing import board_svg, with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import RenderedScene, shifted

from ..marks import night, rest
from .hand_eye_rig import DOCK, Rig, squared
from .views import EVEN, IDEAL, view

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

LENS = images.Intrinsics(640, 400, 441.0, 439.0, 317.0, 203.0, (-0.12, 0.03, 0.001, -0.0005, 0.0))


def names(views: Sequence[fit.View]) -> list[str]:
    return [f"view_{number}.png" for number in range(len(views))]


def moved(view: fit.View, by: Sequence[float]) -> fit.View:
    """Return a view with a wrong position (m)."""
    return fit.View(view.position + by, view.sighting, view.slope)


def judged(rig: Rig, views: Sequence[fit.View]) -> tuple[Calibration, list[str]]:
    found = calibrate(views, rig.intrinsics, rig.beliefs)
    return found, doubts(found, rig.board.size, names(views))


def test_exact_data_give_the_exact_mount() -> None:
    rig = Rig(1, joints=0.0, offset=0.0, intrinsics=LENS)
    found = calibrate(rig.views(12, pixel=0.0, arm=0.0), LENS, rig.beliefs)
    assert np.abs(rig.error(found.mount)).max() < 1e-7
    np.testing.assert_allclose(found.board, rig.place[:3, :3], atol=1e-7)
    assert found.size == pytest.approx(1.0, abs=1e-6)
    assert np.abs(found.held_out_errors).max() < 1e-7
    assert found.reprojection.max() < 1e-5
    assert found.decided


def test_the_offset_is_unobservable_and_enters_position_and_covariance() -> None:
    rig = Rig(2, joints=0.0, offset=0.0)
    views = rig.views(12, pixel=0.0, arm=0.0)
    right = calibrate(views, OAK_D, rig.beliefs)
    x, y, z = rig.offset
    wrong = calibrate(views, OAK_D, dataclasses.replace(rig.beliefs, offset=(x + 0.003, y, z), offset_stddev=0.002))
    np.testing.assert_allclose(wrong.mount.pose[:3, 3] - right.mount.pose[:3, 3], (0.003, 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(wrong.reprojection, right.reprojection, atol=1e-9)
    difference = wrong.mount.covariance - right.mount.covariance
    np.testing.assert_allclose(difference, np.diag([4e-6] * 3 + [0.0] * 3), atol=1e-12)


def test_the_derivatives_match_the_residuals() -> None:
    corners = fit.Corners.of(Rig(3).views(6), OAK_D)
    first = fit.start(corners)
    state = fit.HandEyeState(first.camera, first.shift, first.board, np.array([0.001, -0.002, 0.001]), 1.1)
    step = np.random.default_rng(0).normal(scale=0.05, size=fit.FREE_WITH_SCALE)
    slopes, by_position = fit.jacobian(corners, state, step)
    for column, small in enumerate(1e-6 * np.eye(fit.FREE_WITH_SCALE)):
        high, low = (fit.residuals(corners, state.moved(step + sign * small)) for sign in (1, -1))
        np.testing.assert_allclose(slopes[:, :, column], (high - low) / 2e-6, rtol=1e-5, atol=1e-3)
    shifted = dataclasses.replace(corners, positions=corners.positions + np.array([1e-7, 0.0, 0.0]))
    change = (fit.residuals(shifted, state.moved(step)) - fit.residuals(corners, state.moved(step))) / 1e-7
    np.testing.assert_allclose(by_position[:, :, 0], change, rtol=1e-4, atol=1e-2)


@pytest.mark.parametrize(("count", "pixel", "arm"), [night(5, 0.05, 1e-4), rest(12, 0.05, 4e-4)])
def test_errors_match_the_covariance(count: int, pixel: float, arm: float) -> None:
    pose, point, dock = [], [], []
    for seed in range(50):
        rig = Rig(100 + seed)
        found = calibrate(rig.views(count, pixel, arm), OAK_D, rig.beliefs)
        pose.append(squared(rig.error(found.mount), found.mount.covariance))
        point.append(squared(rig.dock_error(found.mount), found.point_covariance(DOCK)))
        dock.append(np.linalg.norm(rig.dock_error(found.mount)))
    # Of 50 draws of χ² the mean scatters by √(2 · 6 / 50) = 0.49 and √(2 · 3 / 50) = 0.35.
    assert 4.4 < np.mean(pose) < 7.8
    assert 2.0 < np.mean(point) < 4.2
    assert np.median(dock) < 0.0015


def test_held_out_views_judge_a_fit_that_did_not_see_them_and_a_wrong_one_is_left_out() -> None:
    rig = Rig(5)
    views = rig.views(20)
    found = calibrate(views, OAK_D, rig.beliefs)
    assert found.held_out == (4, 9, 14, 19)
    assert 5e-5 < held_out_rms(found) < 5e-4
    # Only the view with the wrong position shows an error.
    views[9] = moved(views[9], (0.004, 0.0, 0.0))
    again = calibrate(views, OAK_D, rig.beliefs)
    errors = np.linalg.norm(again.held_out_errors, axis=1)
    assert errors[1] == pytest.approx(0.004, abs=5e-4)
    assert max(errors[0], errors[2], errors[3]) < 5e-4
    assert np.flatnonzero(~again.fit.kept) == [9]
    assert np.linalg.norm(rig.dock_error(again.mount) - rig.dock_error(found.mount)) < 2e-4


def test_a_wrong_size_is_reported_with_the_likely_one() -> None:
    rig = Rig(8, true_size=0.97)
    _, reasons = judged(rig, rig.views(15))
    assert len(reasons) == 1
    assert "measure the print" in reasons[0]
    assert float(reasons[0].split("size is ")[1].split()[0]) == pytest.approx(40.0 * 0.97, rel=0.005)


def test_joint_errors_beyond_the_stated_ones_are_reported() -> None:
    rig = Rig(503, joints=math.radians(1.0))
    views = rig.views(15)
    stated = dataclasses.replace(rig.beliefs, joint_stddev=math.radians(0.1))
    for beliefs, reported in ((stated, True), (rig.beliefs, False)):
        texts = doubts(calibrate(views, OAK_D, beliefs), rig.board.size, names(views))
        assert any("angles are off" in text or "geometry is wrong" in text for text in texts) == reported, texts


def test_the_tilt_that_fits_all_images_is_chosen() -> None:
    for seed in range(4):
        rig = Rig(400 + seed, Board(size=0.010))  # small: most single images fit the opposite tilt better
        first = fit.start(fit.Corners.of(rig.views(15, pixel=0.8), OAK_D))
        true = rig.mount[:3, :3].T @ rig.place[:3, :3]
        assert np.sum((first.camera.T @ first.board) * true) > 1.0 + 2.0 * math.cos(math.radians(5.0))


def test_too_few_views_and_places_and_moves_along_a_line_are_refused() -> None:
    rig = Rig(13)
    views = rig.views(6)
    line = [fit.View(np.array([view.position[0], 0.01, 0.02]), view.sighting, view.slope) for view in rig.views(12)]
    for given, noun in ((views[:4], "4 views"), ([*views[:3], *views[:3]], "3 places"), (line, "line, x")):
        with pytest.raises(fit.HandEyeError, match=noun):
            calibrate(given, OAK_D, rig.beliefs)


def test_invalid_values_are_refused() -> None:
    for place in (math.nan, 60.0):
        with pytest.raises(fit.HandEyeError, match=r"finite|metres"):
            moved(Rig(15).views(1)[0], (0.0, 0.0, place))
    with pytest.raises(fit.HandEyeError, match="offset"):
        fit.Beliefs((0.0, 20.0, 0.0))


UPRIGHT = shifted((0.0, 0.0, 0.2)) @ np.diag([1.0, -1.0, -1.0, 1.0])
EXACT, USUAL = SimulatedCamera(parameters=IDEAL), SimulatedCamera()
BACKGROUND = RenderedScene(target=False, parameters=EVEN)


def drawn_pose(seed: int) -> np.ndarray:
    """Return camera_T_board of a board that faces the camera within 40°, fully inside the image."""
    random = np.random.default_rng(seed)
    pose = shifted((random.uniform(-0.05, 0.05), random.uniform(-0.02, 0.02), random.uniform(0.14, 0.20)))
    tilt = np.append(random.uniform(-0.5, 0.5, 2), random.uniform(-math.pi, math.pi))
    pose[:3, :3] = terminal.turn(tilt * (1, 1, 0)) @ terminal.turn(tilt * (0, 0, 1)) @ np.diag([1.0, -1.0, -1.0])
    return pose


def rendered(board: Board, pose: np.ndarray, camera: SimulatedCamera = USUAL) -> np.ndarray:
    scene = with_board(BACKGROUND, board, pose)
    return camera.render(scene, view(0.5), np.random.default_rng(0), color_only=True).color


def rms(board: Board, count: int, camera: SimulatedCamera) -> float:
    """Return the error, px, of one coordinate over `count` views."""
    off = []
    for pose in map(drawn_pose, range(count)):
        found = board.detect(rendered(board, pose, camera))
        assert found is not None
        off.append(found.pixels - images.project(found.corners @ pose[:3, :3].T + pose[:3, 3], camera.intrinsics))
    return float(np.sqrt(np.mean(np.square(off))))


@pytest.mark.parametrize(("board", "count"), [(Board(), 3), rest(Board("25h9", 3, 0.03), 8)])
def test_corners_are_found_to_a_small_part_of_a_pixel(board: Board, count: int) -> None:
    assert rms(board, count, EXACT) < 0.05
    assert rms(board, count, USUAL) < 0.05


def test_a_cut_off_averted_other_or_doubled_board_is_not_detected() -> None:
    board = Board(tag=7)
    seen = rendered(board, UPRIGHT)
    assert board.detect(seen) is not None
    assert board.detect(rendered(board, shifted((0.135, 0.0, 0.0)) @ UPRIGHT)) is None
    assert board.detect(rendered(board, UPRIGHT @ np.diag([-1.0, 1.0, -1.0, 1.0]))) is None
    assert Board(tag=0).detect(seen) is None
    assert board.detect(np.concatenate([seen, seen])) is None


def test_tags_are_found_by_the_interface_that_opencv_had_before_4_7(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, new = rendered(Board(), UPRIGHT), cv2.aruco
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
        ("charuco:4x4_50:5x4", 0.04, "write apriltag"),
        ("apriltag:36h11:587", 0.04, "586"),
        ("apriltag:36h11:0", 40.0, "mm"),
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
