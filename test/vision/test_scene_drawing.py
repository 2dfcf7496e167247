# SPDX-License-Identifier: Apache-2.0
"""Drawn scenes: surroundings, decoys, the charger's parts and obstructions in both renderers."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest

from deltacharger_vision.errors import RenderingError
from deltacharger_vision.mount import look_at
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.obstructions import KINDS, draw_obstruction, hidden_share
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import Box, RenderedScene, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts, cover, draw_decoy, draw_scene
from deltacharger_vision.terminal import Terminal

from .views import view

PLACE = (0.1, 0.2, 0.3)
IDEAL = SimulatedCamera(parameters=CameraParameters.ideal())


def image(scene: RenderedScene, pose: np.ndarray) -> np.ndarray:
    return IDEAL.render(scene, pose, np.random.default_rng(0), color_only=True).color


def test_a_seed_determines_the_scene() -> None:
    first, again, other = (draw_scene(np.random.default_rng(seed), clutter=5, decoys=3) for seed in (1, 1, 2))
    np.testing.assert_array_equal(image(first, view(0.5)), image(again, view(0.5)))
    assert (image(first, view(0.5)) != image(other, view(0.5))).mean() > 0.5


def test_surroundings_never_hide_the_terminal() -> None:
    for seed in range(4):
        scene = draw_scene(np.random.default_rng(seed), clutter=10, decoys=5)
        even = dataclasses.replace(scene.parameters, streaks=0.0, mirrored=0.0, unevenness=0.0)
        scene = dataclasses.replace(scene, parameters=even)
        alone = dataclasses.replace(scene, background=())
        # Within the plate, seen from straight ahead.
        window = np.s_[100:300, 160:480]
        np.testing.assert_array_equal(image(scene, view(0.2))[window], image(alone, view(0.2))[window])


def test_clutter_and_decoys_are_visible() -> None:
    seen = []
    for seed in range(4):
        bare = draw_scene(np.random.default_rng(seed), target=False)
        full = draw_scene(np.random.default_rng(seed), clutter=4, decoys=4, target=False)
        seen.append((image(full, view(0.6)) != image(bare, view(0.6))).any(axis=2).mean())
    assert np.mean(seen) > 0.05


def test_a_decoy_has_its_given_pose_and_never_the_terminals_dimensions() -> None:
    terminal, kinds = Terminal(), set()
    for seed in range(60):
        boxes, moved = (draw_decoy(np.random.default_rng(seed), terminal, shifted(by)) for by in ((0.0,) * 3, PLACE))
        for box, other in zip(moved, boxes, strict=True):
            np.testing.assert_allclose(box.pose[:3, 3] - other.pose[:3, 3], PLACE, atol=1e-12)
        metal = [box for box in boxes if box.metal]
        kinds.add((len(boxes), len(metal)))
        for box, other in itertools.pairwise(metal):
            spacing = np.linalg.norm(box.pose[:3, 3] - other.pose[:3, 3])
            assert abs(np.log(spacing / terminal.spacing)) > 0.15
    assert kinds == {(1, 0), (1, 1), (2, 2), (3, 2), (6, 6)}


def test_the_chargers_parts_hide_the_terminal_if_in_between() -> None:
    mount = look_at((0.0, 0.12, -0.12), (0.0, 0.0, 0.08))
    pose = np.linalg.inv(mount) @ shifted((0.0, 0.0, 0.08))
    bright = []
    for z in (-0.2, 0.075):
        parts = charger_parts(mount, (0.0, 0.0, z))
        assert all(box.in_camera for box in parts)
        bright.append((image(RenderedScene(foreground=tuple(parts)), pose) > 180).sum())
    assert bright[1] < 0.3 * bright[0]


@pytest.mark.parametrize(
    "make",
    [
        lambda: cover(Terminal(), 1.2),
        lambda: cover(Terminal(), float("nan")),
        lambda: draw_scene(np.random.default_rng(0), clutter=-1),
        lambda: RenderedScene(light=(0.0, 0.0, 0.0)),
        lambda: Box(2 * np.eye(4), (0.1, 0.1, 0.1), (0.5, 0.5, 0.5)),
        lambda: Box(np.eye(4), (0.1, -0.1, float("nan")), (0.5, 0.5, 0.5)),
        lambda: Box(np.eye(4), (0.1, 0.1, 0.1), (0.5, 0.5, 1.5)),
    ],
)
def test_impossible_values_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(RenderingError):
        make()


def obstructed(kind: str, seed: int) -> RenderedScene:
    boxes = draw_obstruction(np.random.default_rng(seed), kind, Terminal(), 0.1)
    return RenderedScene(parameters=SceneParameters.even(), foreground=boxes)


def seen(scene: RenderedScene) -> np.ndarray:
    return IDEAL.render(scene, view(0.4), np.random.default_rng(0), color_only=True).color


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_determines_an_obstruction_visible_at_the_bars(kind: str) -> None:
    bare = seen(RenderedScene(parameters=SceneParameters.even()))
    for seed in range(2):
        np.testing.assert_array_equal(seen(obstructed(kind, seed)), seen(obstructed(kind, seed)))
        # Within 5 cm of the middle of the bars, seen from straight ahead.
        window = np.s_[145:255, 265:375]
        assert (seen(obstructed(kind, seed))[window] != bare[window]).any()


@pytest.mark.rest
@pytest.mark.parametrize("kind", KINDS)
def test_both_renderers_draw_the_same_thing(kind: str) -> None:
    mujoco_camera = pytest.importorskip("deltacharger_vision.rendering.mujoco_camera")
    pytest.importorskip("mujoco")
    with mujoco_camera.MujocoCamera(parameters=CameraParameters.ideal()) as camera:
        ours = camera.render(obstructed(kind, 3), view(0.4), np.random.default_rng(0)).depth
    theirs = IDEAL.render(obstructed(kind, 3), view(0.4), np.random.default_rng(0)).depth
    near = np.isfinite(ours) & np.isfinite(theirs) & (theirs < 0.45)
    assert near.sum() > 5000
    # Except pixels whose centre lies on an edge.
    assert np.mean(np.abs(ours - theirs)[near] < 1e-4) > 0.97


@pytest.mark.parametrize(("share", "behind"), [(0.25, False), (1.0, False), (1.0, True)])
def test_the_hidden_share_matches_a_cover_in_front(share: float, behind: bool) -> None:
    box = cover(Terminal(), share)
    box.pose[2, 3] = 0.01 if behind else box.pose[2, 3]
    found = hidden_share([box], Terminal(), view(10.0))
    assert found == pytest.approx(0.0 if behind else 0.5 * share, abs=0.02)


def test_unknown_kinds_and_no_room_are_refused() -> None:
    for kind, room in (("fog", 0.1), ("cable", 0.0), ("cable", float("nan"))):
        with pytest.raises(RenderingError, match="give"):
            draw_obstruction(np.random.default_rng(0), kind, Terminal(), room)
