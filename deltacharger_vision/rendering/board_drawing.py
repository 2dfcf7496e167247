# SPDX-License-Identifier: Apache-2.0
"""A calibration board for the simulated camera, and its print at true size."""

import dataclasses
from functools import cache

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.rendering.scene import Box, RenderedScene, shifted
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


def with_board(scene: RenderedScene, board: Board, pose: Array) -> RenderedScene:
    """Return the scene with a board at (4, 4) `pose`, from the board's frame to the optical frame."""
    plate, *cells = (dataclasses.replace(box, pose=pose @ box.pose, in_camera=True) for box in board_boxes(board))
    # The plate must be painted first, even if a cell is further away than its centre.
    return dataclasses.replace(scene, background=(*scene.background, plate), foreground=(*scene.foreground, *cells))


@cache
def board_boxes(board: Board) -> tuple[Box, ...]:
    """Return the white plate, the black square with its face at z = 0, and the white within it, in the board's frame.

    The black is one box: if an edge consisted of several boxes, its pixels would be half covered several times, which
    would shift the edge.
    """
    side, black = board.size, board.cells()
    cell, whole = side / len(black), side + 2 * board.margin
    boxes = [
        Box(shifted((0.0, 0.0, -THICKNESS / 2)), (whole, whole, THICKNESS), _WHITE),
        Box(shifted((0.0, 0.0, 0.0)), (side, side, 0.0), _BLACK),  # ink has no visible side
    ]
    for left, top, right, bottom in _rectangles(~black):
        middle = (cell * (left + right) / 2 - side / 2, side / 2 - cell * (top + bottom) / 2, _BIT - _BIT / 2)
        boxes.append(Box(shifted(middle), (cell * (right - left), cell * (bottom - top), _BIT), _WHITE))
    return tuple(boxes)


def _rectangles(marked: Mask) -> list[Area]:
    """Return rectangles that cover exactly the marked cells (rows, columns).

    They overlap if possible: at a seam, half-covered pixels would show the black.
    """
    found: dict[Area, None] = {}
    for row, column in np.argwhere(marked).tolist():
        for first in (0, 1):
            (top, bottom), (left, right) = _grown(marked, (row, column), first)
            found[left, top, right, bottom] = None
    return list(found)


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
    plate, *areas = board_boxes(board)
    width, height = 1e3 * plate.size[0], 1e3 * plate.size[1]
    parts = [
        f'<rect x="0" y="0" width="{width:.4f}" height="{height:.4f}" fill="white" stroke="#bbb" stroke-width="0.1"/>'
    ]
    for area in areas:
        across, down = 1e3 * area.size[0], 1e3 * area.size[1]
        x, y = width / 2 + 1e3 * area.pose[0, 3] - across / 2, height / 2 - 1e3 * area.pose[1, 3] - down / 2
        color = "white" if area.color[0] > _LIGHT else "black"
        parts.append(f'<rect x="{x:.4f}" y="{y:.4f}" width="{across:.4f}" height="{down:.4f}" fill="{color}"/>')
    caption = f"{board.name}, black square {1e3 * board.size:g} mm"
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
