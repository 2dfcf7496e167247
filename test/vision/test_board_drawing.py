# SPDX-License-Identifier: Apache-2.0
"""The drawn board matches the print: same bits, same size, correct edges."""

from __future__ import annotations

import numpy as np
import pytest

from deltacharger_vision.errors import RenderingError
from deltacharger_vision.hand_eye.board import AprilTag, Board, Charuco
from deltacharger_vision.hand_eye.board_print import board_svg
from deltacharger_vision.projection import project
from deltacharger_vision.rendering.board_drawing import board_boxes, bracket, with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import RenderedScene, shifted

from .views import linear, view

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

CAMERA = SimulatedCamera(parameters=CameraParameters.ideal())
BACKGROUND = RenderedScene(target=False, parameters=SceneParameters.even())


def facing(away: float) -> np.ndarray:
    """Return camera_T_board straight ahead, upright."""
    pose = shifted((0.0, 0.0, away))
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0])
    return pose


def render(scene: RenderedScene) -> np.ndarray:
    return CAMERA.render(scene, view(0.5), np.random.default_rng(0), color_only=True).color


@pytest.mark.parametrize("board", [AprilTag(), AprilTag("16h5", 2), Charuco()], ids=lambda board: board.name)
def test_each_cell_has_the_printed_colour(board: Board) -> None:
    pose, black = facing(0.15), board.cells()
    light = linear(render(with_board(BACKGROUND, board, pose, in_camera=True)))
    # A ChArUco board has many fine cells: only some are tested, and a few lie on an edge.
    rows, columns = (np.arange(count)[:: max(1, count // 31)] for count in black.shape)
    width, height = board.pattern
    x = width * ((columns + 0.5) / black.shape[1] - 0.5)
    y = height * (0.5 - (rows + 0.5) / black.shape[0])
    points = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 0.0), axis=-1) @ pose[:3, :3].T + pose[:3, 3]
    across, down = np.moveaxis(np.rint(project(points, OAK_D)).astype(int), -1, 0)
    seen = light[down, across] < 0.5 * light.max()
    assert np.mean(seen == black[np.ix_(rows, columns)]) > 0.95


def test_the_tag_has_its_stated_size() -> None:
    pose = facing(0.2)
    light = linear(render(with_board(BACKGROUND, AprilTag(), pose, in_camera=True)))
    white, dark = light[OAK_D.height // 2 - 49, OAK_D.width // 2], light[OAK_D.height // 2 - 40, OAK_D.width // 2]
    # A line through the border's uppermost row: how much of it is black.
    row = round(float(project(np.array([0.0, -0.018, 0.2]), OAK_D)[1]))
    line = light[row, 200:440]
    covered = np.sum((white - line) / (white - dark) * (np.abs(np.arange(200, 440) - OAK_D.cx) < 50))
    assert covered == pytest.approx(441.0 * 0.040 / 0.2, abs=0.15)


def test_edges_of_a_tilted_board_are_exact() -> None:
    pose = shifted((0.0, 0.0, 0.2))
    c, s = np.cos(0.6), np.sin(0.6)
    pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ np.array([(1, 0, 0), (0, c, -s), (0, s, c)])
    light = linear(render(with_board(BACKGROUND, AprilTag(), pose, in_camera=True)))
    for y in (0.02, -0.02):
        edge = float(project(pose[:3, :3] @ (0.0, y, 0.0) + pose[:3, 3], OAK_D)[1])
        column = light[:, OAK_D.width // 2]
        near = column[int(edge) - 4 : int(edge) + 6]
        outer, inner = (near[0], near[-1]) if y > 0 else (near[-1], near[0])
        black = float(np.sum((outer - near) / (outer - inner)))
        expected = int(edge) + 5.5 - edge if y > 0 else edge - (int(edge) - 4.5)
        assert black == pytest.approx(expected, abs=0.05)


def test_a_board_in_the_terminals_frame_moves_with_it() -> None:
    board, terminal_T_board = AprilTag(), shifted((0.02, 0.0, -0.05)) @ np.diag([-1.0, 1.0, -1.0, 1.0])
    placed = with_board(BACKGROUND, board, terminal_T_board)
    fixed = with_board(BACKGROUND, board, view(0.3) @ terminal_T_board, in_camera=True)
    images = [
        CAMERA.render(scene, view(0.3), np.random.default_rng(0), color_only=True).color for scene in (placed, fixed)
    ]
    np.testing.assert_array_equal(*images)
    assert board.detect(images[0]) is not None


def test_things_in_front_of_the_board_hide_it() -> None:
    board, pose = AprilTag(), facing(0.2)
    scene = with_board(BACKGROUND, board, pose, in_camera=True)
    assert board.detect(render(scene)) is not None
    hidden = with_board(scene, AprilTag(tag=5), facing(0.15), in_camera=True)
    assert board.detect(render(hidden)) is None


def test_the_bracket_turns_the_print_backward_and_upright() -> None:
    np.testing.assert_array_equal(bracket()[:3, :3] @ (0.0, 0.0, 1.0), (0.0, 0.0, -1.0))
    np.testing.assert_array_equal(bracket()[:3, :3] @ (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
    assert np.linalg.det(bracket()[:3, :3]) == pytest.approx(1.0)


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


def test_an_invalid_pose_is_refused() -> None:
    with pytest.raises(RenderingError):
        board_boxes(AprilTag(), np.diag([2.0, 1.0, 1.0, 1.0]))
