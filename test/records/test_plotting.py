# SPDX-License-Identifier: Apache-2.0
"""The colours of pictures."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_records import plotting

COLOURS = {name: getattr(plotting, name) for name in ("FAINT", "BLUE", "ORANGE", "GREEN", "PURPLE", "RED")}
SIGHTS = {
    "full": np.eye(3),
    "without red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "without green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "without blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Linear RGB as each kind of eye sees it (Machado, Oliveira and Fernandes 2009, severity 1)."""
_TO_XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])  # sRGB, D65
_WHITE = _TO_XYZ.sum(axis=1)


def _linear(colour: str) -> NDArray[np.float64]:
    values = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255.0
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _lab(linear: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return L*a*b* (CIE 1976)."""
    ratio = _TO_XYZ @ np.clip(linear, 0.0, 1.0) / _WHITE
    x, y, z = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


@pytest.mark.parametrize("sight", SIGHTS)
def test_every_eye_distinguishes_the_colours(sight: str) -> None:
    seen = {name: _lab(np.array(SIGHTS[sight]) @ _linear(colour)) for name, colour in COLOURS.items()}
    apart = {pair: np.linalg.norm(seen[pair[0]] - seen[pair[1]]) for pair in itertools.combinations(seen, 2)}
    assert min(apart.values()) >= 25.0, apart  # 2.3 is just noticeable


def test_every_colour_is_visible_on_paper() -> None:
    for name, colour in COLOURS.items():
        luminance = (_TO_XYZ @ _linear(colour))[1]
        assert 1.05 / (luminance + 0.05) >= 2.5, name  # contrast on white (WCAG)
