# SPDX-License-Identifier: Apache-2.0
"""Parts of the view that need no viewer: shapes, colours, texts, and the message without Rerun."""

import sys
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.records.view.shapes import FULL, pad_picture

from ..bringup.command import Capture, refuses

EMPTY, TOP = (tuple(shade) for shade in pad_picture([0.0, FULL], 1, 2)[0])


def test_a_pad_is_shown_as_seen_from_the_charger() -> None:
    forces = np.zeros((10, 10))
    forces[0, 9] = FULL  # at +y and −x of end_effector: above and right, looking at the target
    picture = pad_picture(forces.ravel(), 10, 10)
    assert picture.shape == (10, 10, 3)
    assert tuple(picture[0, 9]) == TOP
    assert {tuple(pixel) for pixel in picture.reshape(-1, 3)} == {EMPTY, TOP}


@pytest.mark.parametrize("module", [None, type(sys)("rerun")], ids=["missing", "of another project"])
def test_without_rerun_the_remedy_is_given(capsys: Capture, monkeypatch: pytest.MonkeyPatch, module: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", module)
    refuses(capsys, "view", "deltacharger[view]")
