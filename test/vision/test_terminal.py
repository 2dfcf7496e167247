# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_vision.errors import TerminalError, VisionError
from deltacharger_vision.terminal import LOWER, UPPER, Terminal


def test_corners_span_the_bars() -> None:
    terminal = Terminal(bar_length=0.08, bar_height=0.012, gap=0.009)
    corners = terminal.corners()
    assert corners.shape == (2, 4, 3)
    np.testing.assert_allclose(corners.mean(axis=(0, 1)), 0.0, atol=1e-15)
    np.testing.assert_allclose(np.ptp(corners, axis=1), [(0.08, 0.012, 0.0)] * 2)
    assert corners[UPPER, :, 1].min() - corners[LOWER, :, 1].max() == pytest.approx(0.009)


def test_corners_go_around_z() -> None:
    for bar in Terminal().corners():
        sides = np.roll(bar, -1, axis=0) - bar
        turns = np.cross(sides, np.roll(sides, -1, axis=0))
        assert (turns[:, 2] > 0).all()


def test_load_keeps_defaults_of_missing_lengths(tmp_path: Path) -> None:
    path = tmp_path / "terminal.yaml"
    path.write_text("bar_length: 0.09\ngap: 0.01\n")
    assert Terminal.load(path) == Terminal(bar_length=0.09, gap=0.01)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bar_lenght: 0.07", "did you mean 'bar_length'"),
        ("bar_length: 70", "metres"),
        ("gap: wide", "not a number"),
        ("", "mapping"),
    ],
)
def test_errors_of_a_bad_file_state_what_to_do(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "terminal.yaml"
    path.write_text(text)
    with pytest.raises(TerminalError, match=words) as caught:
        Terminal.load(path)
    assert caught.value.source == str(path)
    assert isinstance(caught.value, VisionError)


def test_lengths_have_bounds() -> None:
    with pytest.raises(ParameterError) as caught:
        Terminal(gap=-0.001)
    assert caught.value.key == "gap"
