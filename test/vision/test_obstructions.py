# SPDX-License-Identifier: Apache-2.0
"""Obstructions of a terminal in both renderers."""

from __future__ import annotations

import numpy as np
import pytest

from deltacharger_vision.errors import RenderingError
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.obstructions import KINDS, draw_obstruction, hidden_share
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import RenderedScene
from deltacharger_vision.rendering.scene_drawing import cover
from deltacharger_vision.terminal import Terminal

from .views import view

IDEAL = SimulatedCamera(parameters=CameraParameters.ideal())


def scene(kind: str, seed: int) -> RenderedScene:
    boxes = draw_obstruction(np.random.default_rng(seed), kind, Terminal(), 0.1)
    return RenderedScene(parameters=SceneParameters.even(), foreground=boxes)


def image(scene: RenderedScene) -> np.ndarray:
    return IDEAL.render(scene, view(0.4), np.random.default_rng(0), color_only=True).color


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_determines_an_obstruction_visible_at_the_bars(kind: str) -> None:
    bare = image(RenderedScene(parameters=SceneParameters.even()))
    for seed in range(6):
        np.testing.assert_array_equal(image(scene(kind, seed)), image(scene(kind, seed)))
        # Within 5 cm of the middle of the bars, seen from straight ahead.
        window = np.s_[145:255, 265:375]
        assert (image(scene(kind, seed))[window] != bare[window]).any()


@pytest.mark.parametrize("kind", KINDS)
def test_both_renderers_draw_the_same_thing(kind: str) -> None:
    mujoco_camera = pytest.importorskip("deltacharger_vision.rendering.mujoco_camera")
    pytest.importorskip("mujoco")
    with mujoco_camera.MujocoCamera(parameters=CameraParameters.ideal()) as camera:
        ours = camera.render(scene(kind, 3), view(0.4), np.random.default_rng(0)).depth
    theirs = IDEAL.render(scene(kind, 3), view(0.4), np.random.default_rng(0)).depth
    near = np.isfinite(ours) & np.isfinite(theirs) & (theirs < 0.45)
    assert near.sum() > 5000
    # Except pixels whose centre lies on an edge.
    assert np.mean(np.abs(ours - theirs)[near] < 1e-4) > 0.97


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 1.0])
def test_the_hidden_share_matches_a_cover(share: float) -> None:
    found = hidden_share([cover(Terminal(), share)], Terminal(), view(10.0))
    assert found == pytest.approx(0.5 * share, abs=0.02)


def test_things_behind_hide_nothing() -> None:
    box = cover(Terminal(), 1.0)
    box.pose[2, 3] = 0.01
    assert hidden_share([box], Terminal(), view(0.4)) == 0.0


def test_unknown_kinds_and_no_room_are_refused() -> None:
    for kind, room in (("fog", 0.1), ("cable", 0.0), ("cable", float("nan"))):
        with pytest.raises(RenderingError, match="give"):
            draw_obstruction(np.random.default_rng(0), kind, Terminal(), room)
