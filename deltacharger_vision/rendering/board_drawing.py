# SPDX-License-Identifier: Apache-2.0
"""A calibration board for the simulated camera, and its print at true size."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.rendering.scene import Box, Color, RenderedScene, check_pose, shifted
from deltacharger_vision.terminal import transform

Area = tuple[int, int, int, int]
"""Left, top, right and bottom of a rectangle of cells; right and bottom are exclusive."""

THICKNESS = 0.002
"""Thickness of the board's plate, m (assumed)."""
_BIT = 1e-4  # m, of white on black: something thinner could be painted over
_WHITE, _BLACK = (0.75, 0.75, 0.75), (0.03, 0.03, 0.03)  # reflectance of matte print (assumed)


def bracket() -> Array:
    """Return (4, 4) end_effector_T_board of the mount proposed in docs/camera-calibration.md.

    The plate is screwed to the back of the platform, upright, parallel to the contact plane, facing back to the camera:
    the board's x is −x of end_effector, y is y, z is −z. It is above the upper edge and to the left, clear of the limb
    from the upper right.
    """
    return transform(np.diag([-1.0, 1.0, -1.0]), (0.020, 0.030, -0.022))


def with_board(scene: RenderedScene, board: Board, pose: Array, in_camera: bool = False) -> RenderedScene:
    """Return the scene with a board in it.

    Args:
        scene: without the board.
        board: to add.
        pose: (4, 4) from the board's frame to the terminal's frame, or to the optical frame with `in_camera`.
        in_camera: whether `pose` refers to the optical frame.

    Raises:
        RenderingError: the pose is not a rigid transform.
    """
    plate, *cells = board_boxes(board, pose, in_camera)
    # The plate must be painted first, even if a cell is further away than its centre.
    return dataclasses.replace(scene, background=(*scene.background, plate), foreground=(*scene.foreground, *cells))


def board_boxes(board: Board, pose: Array, in_camera: bool = False) -> list[Box]:
    """Return the white plate, then the black areas with faces at z = 0, and the white within them.

    Arguments and errors as in `with_board`. Each area is one box: if an edge consisted of several boxes, its pixels
    would be half covered several times, which would shift the edge.
    """
    check_pose("board", pose)
    return [dataclasses.replace(box, pose=pose @ box.pose, in_camera=in_camera) for box in _boxes(board)]


@cache
def _boxes(board: Board) -> tuple[Box, ...]:
    """Return the boxes in the board's frame."""
    (width, height), margin = board.pattern, board.margin
    black = board.cells()
    cell = width / black.shape[1]

    def box(area: Area, face: float, thickness: float, color: Color) -> Box:
        left, top, right, bottom = area
        middle = (cell * (left + right) / 2 - width / 2, height / 2 - cell * (top + bottom) / 2, face - thickness / 2)
        return Box(shifted(middle), (cell * (right - left), cell * (bottom - top), thickness), color)

    plate = shifted((0.0, 0.0, -THICKNESS / 2))
    boxes = [Box(plate, (width + 2 * margin, height + 2 * margin, THICKNESS), _WHITE)]
    for area in _areas(black):
        boxes.append(box(area, 0.0, 0.0, _BLACK))  # ink has no visible side
        left, top, right, bottom = area
        for a, b, c, d in _rectangles(~black[top:bottom, left:right]):
            boxes.append(box((left + a, top + b, left + c, top + d), _BIT, _BIT, _WHITE))
    return tuple(boxes)


def _areas(black: Mask) -> list[Area]:
    """Return bounding rectangles of black areas that share sides, without those inside others."""
    import cv2

    _, _, stats, _ = cv2.connectedComponentsWithStats(black.astype(np.uint8), connectivity=4)
    areas = [(left, top, left + width, top + height) for left, top, width, height, _ in stats[1:].tolist()]
    return [area for area in areas if not any(other != area and _holds(other, area) for other in areas)]


def _holds(outer: Area, inner: Area) -> bool:
    return outer[0] <= inner[0] and outer[1] <= inner[1] and outer[2] >= inner[2] and outer[3] >= inner[3]


def _rectangles(marked: Mask) -> list[Area]:
    """Return rectangles that cover exactly the marked cells (rows, columns).

    They overlap if possible: at a seam, half-covered pixels would show the black.
    """
    if not marked.any():
        return []
    rows, columns = (_changes(marked, axis) for axis in (0, 1))
    coarse = marked[np.ix_(rows[:-1], columns[:-1])]
    found: dict[Area, None] = {}
    for row, column in np.argwhere(coarse):
        for first in (0, 1):
            (top, bottom), (left, right) = _grown(coarse, (int(row), int(column)), first)
            found[int(columns[left]), int(rows[top]), int(columns[right]), int(rows[bottom])] = None
    return list(found)


def _changes(marked: Mask, axis: int) -> NDArray[np.int64]:
    """Return the indices where rows (axis 0) or columns (1) differ from the previous one, and both ends."""
    differs = (np.diff(marked, axis=axis) != 0).any(axis=1 - axis)
    return np.concatenate([[0], 1 + np.flatnonzero(differs), [marked.shape[axis]]])


def _grown(marked: Mask, cell: tuple[int, int], first: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (start, end) along rows and columns of a marked rectangle around a cell, grown along `first` first."""
    spans = [(cell[0], cell[0] + 1), (cell[1], cell[1] + 1)]
    for axis in (first, 1 - first):
        window = [slice(*span) for span in spans]
        window[axis] = slice(None)
        line = np.asarray(marked[tuple(window)].all(axis=1 - axis))
        start, end = spans[axis]
        while start > 0 and line[start - 1]:
            start -= 1
        while end < len(line) and line[end]:
            end += 1
        spans[axis] = (start, end)
    return spans[0], spans[1]


_STRIP = 6.0  # mm below the board for its name
_LETTER = 2.5  # mm
_LIGHT = 0.5  # reflectance between black and white


def board_svg(board: Board) -> str:
    """Return an SVG drawing of a board: white margin, cutting outline, and name and size below."""
    plate, *areas = board_boxes(board, np.eye(4))
    width, height = 1e3 * plate.size[0], 1e3 * plate.size[1]
    parts = [
        f'<rect x="0" y="0" width="{width:.4f}" height="{height:.4f}" fill="white" stroke="#bbb" stroke-width="0.1"/>'
    ]
    for area in areas:
        across, down = 1e3 * area.size[0], 1e3 * area.size[1]
        x, y = width / 2 + 1e3 * area.pose[0, 3] - across / 2, height / 2 - 1e3 * area.pose[1, 3] - down / 2
        color = "white" if area.color[0] > _LIGHT else "black"
        parts.append(f'<rect x="{x:.4f}" y="{y:.4f}" width="{across:.4f}" height="{down:.4f}" fill="{color}"/>')
    across, down = (1e3 * length for length in board.pattern)
    caption = f"{board.name}, black pattern {across:g} x {down:g} mm"
    parts.append(
        f'<text x="1" y="{height + _STRIP - 2:.2f}" font-size="{_LETTER:g}" font-family="sans-serif">{caption}</text>'
    )
    total = height + _STRIP
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.4f}mm" height="{total:.4f}mm" '
            f'viewBox="0 0 {width:.4f} {total:.4f}" shape-rendering="crispEdges">',
            *parts,
            "</svg>\n",
        ]
    )
