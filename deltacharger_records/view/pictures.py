# SPDX-License-Identifier: Apache-2.0
"""Pads as pictures with a fixed colour scale, so that two moments can be compared."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.uint8]

FULL = 9.0
"""Force on a taxel at the end of the scale, N: the range of the published sensor."""
NOISE = 0.25
"""Smaller forces (N) are shown as 0, as for the estimator; else the noise of free air would be transmitted."""
DEAD = (148, 154, 160)
"""Colour of a dead taxel."""
_SHADES = 90  # steps of 0.1 N
_ANCHORS = (  # closer at small forces: a docked pad carries about 2 N on its strongest taxel
    (0.00, (18, 20, 26)),
    (0.05, (46, 24, 92)),
    (0.13, (142, 36, 130)),
    (0.24, (229, 80, 82)),
    (0.50, (252, 165, 74)),
    (1.00, (252, 248, 196)),
)


def _scale() -> Picture:
    places, colours = zip(*_ANCHORS, strict=True)
    shares = np.linspace(0.0, 1.0, _SHADES + 1)
    channels = [np.interp(shares, places, [colour[each] for colour in colours]) for each in range(3)]
    return np.round(np.stack(channels, axis=1)).astype(np.uint8)


_SCALE = _scale()


def pad_picture(forces: ArrayLike, rows: int, columns: int) -> Picture:
    """Return one pad (rows, columns, 3) as seen along +z at the target: +x to the left, +y up.

    Args:
        forces: (rows · columns,) N, row-major, row 0 at +y, column 0 at +x; NaN = dead taxel.
        rows: of taxels.
        columns: of taxels.

    Raises:
        ValueError: the number of forces differs from rows · columns.
    """
    values = np.asarray(forces, dtype=np.float64).reshape(rows, columns)
    dead = np.isnan(values)
    shown = np.where(values >= NOISE, np.minimum(values, FULL), 0.0)
    shade = np.rint(shown * (_SHADES / FULL)).astype(np.intp)
    picture = _SCALE[shade]
    picture[dead] = DEAD
    return picture
