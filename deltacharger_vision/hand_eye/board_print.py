# SPDX-License-Identifier: Apache-2.0
"""Drawing of a calibration board in true size, for printing."""

from __future__ import annotations

import numpy as np

from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.rendering.board_drawing import board_boxes

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
