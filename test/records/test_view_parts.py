# SPDX-License-Identifier: Apache-2.0
"""Parts of the view that need no viewer: shapes, colours, texts, and the message without Rerun."""

from __future__ import annotations

import json
import math
import sys
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_records.view import mechanism
from deltacharger_records.view import shapes as view_scene
from deltacharger_records.view.pictures import DEAD, FULL, NOISE, pad_picture
from deltacharger_vision.terminal import Terminal

EMPTY, TOP = (tuple(shade) for shade in pad_picture([0.0, FULL], 1, 2)[0])


def test_a_pad_is_shown_as_seen_from_the_charger() -> None:
    forces = np.zeros((10, 10))
    forces[0, 9] = FULL  # at +y and −x of end_effector: above and right, looking at the target
    picture = pad_picture(forces.ravel(), 10, 10)
    assert picture.shape == (10, 10, 3)
    assert tuple(picture[0, 9]) == TOP
    assert {tuple(pixel) for pixel in picture.reshape(-1, 3)} == {EMPTY, TOP}


def test_the_scale_is_fixed_rises_and_ends_at_the_sensors_range() -> None:
    forces = np.linspace(0.3, FULL, 88)
    shades = pad_picture([0.0, *forces], 1, 89)[0].astype(int)
    assert (np.diff(shades.sum(axis=1)) > 0).all()
    assert tuple(pad_picture([2.0 * FULL], 1, 1)[0, 0]) == TOP
    assert tuple(pad_picture([-0.3], 1, 1)[0, 0]) == EMPTY
    assert tuple(pad_picture([0.9 * NOISE], 1, 1)[0, 0]) == EMPTY


def test_dead_taxels_are_grey_and_forces_never_are() -> None:
    assert tuple(pad_picture([math.nan], 1, 1)[0, 0]) == DEAD
    assert DEAD not in {tuple(shade) for shade in pad_picture(np.linspace(0.0, FULL, 200), 1, 200)[0]}


def test_wrong_numbers_of_forces_are_refused() -> None:
    with pytest.raises(ValueError, match="reshape"):
        pad_picture([0.0] * 99, 10, 10)


def test_arms_meet_rods_and_rods_meet_the_platform() -> None:
    geometry, point = DeltaGeometry(), (0.02, -0.03, 0.07)
    angles = [float(angle) for angle in Delta(geometry).inverse(point).angles]
    arms, rods = view_scene.moving(geometry, angles, point)
    assert (arms.shape, rods.shape) == ((3, 2, 3), (6, 2, 3))
    np.testing.assert_allclose(rods[:, 0].reshape(3, 2, 3).mean(axis=1), arms[:, 1], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rods[0::2] - rods[1::2], axis=-1), mechanism.ROD_SPACING, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rods[:, 1] - rods[:, 0], axis=-1), geometry.rod, atol=1e-9)
    feet = rods[:, 1].reshape(3, 2, 3).mean(axis=1) - point
    np.testing.assert_allclose(np.linalg.norm(feet, axis=1), geometry.platform_radius, atol=1e-12)


def test_electrodes_of_both_sides_touch_at_the_contact_plane() -> None:
    bar = (Terminal().bar_length, Terminal().bar_height, Terminal().bar_thickness)
    for boxes, side in ((view_scene.platform(DeltaGeometry()), -1.0), (view_scene.target(view_scene.SEEN), 1.0)):
        bars = [centre for centre, size in zip(boxes.centres, boxes.sizes, strict=True) if size == bar]
        assert sorted(centre[1] for centre in bars) == pytest.approx([-0.0087, 0.0087])
        assert [centre[2] for centre in bars] == pytest.approx([side * bar[2] / 2] * 2)


@pytest.mark.parametrize("as_json", [False, True])
def test_without_rerun_the_remedy_is_given(as_json: bool, capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    code = main(["view", *(["--json"] if as_json else [])])
    captured = capsys.readouterr()
    assert code == 2
    assert "pip install 'rerun-sdk" in captured.err
    assert (json.loads(captured.out)["success"] is False) if as_json else captured.out == ""


def test_another_package_named_rerun_is_recognised(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "rerun", type(sys)("rerun"))
    assert main(["view"]) == 2
    assert "deltacharger[view]" in capsys.readouterr().err
