# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from deltacharger_vision.errors import RenderingError
from deltacharger_vision.mount import look_at
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.parameters import CameraParameters
from deltacharger_vision.rendering.scene import Box, RenderedScene, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts, cover, draw_decoy, draw_scene
from deltacharger_vision.terminal import Terminal

from .views import view

IDEAL = SimulatedCamera(parameters=CameraParameters.ideal())


def image(scene: RenderedScene, pose: np.ndarray) -> np.ndarray:
    return IDEAL.render(scene, pose, np.random.default_rng(0), color_only=True).color


def test_a_seed_determines_the_scene() -> None:
    first, again, other = (draw_scene(np.random.default_rng(seed), clutter=5, decoys=3) for seed in (1, 1, 2))
    np.testing.assert_array_equal(image(first, view(0.5)), image(again, view(0.5)))
    assert (image(first, view(0.5)) != image(other, view(0.5))).mean() > 0.5


def test_surroundings_never_hide_the_terminal() -> None:
    for seed in range(30):
        scene = draw_scene(np.random.default_rng(seed), clutter=10, decoys=5)
        even = dataclasses.replace(scene.parameters, streaks=0.0, mirrored=0.0, unevenness=0.0)
        scene = dataclasses.replace(scene, parameters=even)
        alone = dataclasses.replace(scene, background=())
        # Within the plate, seen from straight ahead.
        window = np.s_[100:300, 160:480]
        np.testing.assert_array_equal(image(scene, view(0.2))[window], image(alone, view(0.2))[window])


def test_clutter_and_decoys_are_visible() -> None:
    seen = []
    for seed in range(12):
        bare = draw_scene(np.random.default_rng(seed), target=False)
        full = draw_scene(np.random.default_rng(seed), clutter=4, decoys=4, target=False)
        seen.append((image(full, view(0.6)) != image(bare, view(0.6))).any(axis=2).mean())
    assert np.mean(seen) > 0.05


def test_no_decoy_has_the_terminals_dimensions() -> None:
    terminal, kinds = Terminal(), set()
    for seed in range(200):
        boxes = draw_decoy(np.random.default_rng(seed), terminal, np.eye(4))
        metal = [box for box in boxes if box.metal]
        kinds.add((len(boxes), len(metal)))
        for box, other in itertools.pairwise(metal):
            spacing = np.linalg.norm(box.pose[:3, 3] - other.pose[:3, 3])
            assert abs(np.log(spacing / terminal.spacing)) > 0.15
    assert kinds == {(1, 0), (1, 1), (2, 2), (3, 2), (6, 6)}


def test_a_decoy_has_its_given_pose() -> None:
    for seed in range(20):
        moved = draw_decoy(np.random.default_rng(seed), Terminal(), shifted((0.1, 0.2, 0.3)))
        still = draw_decoy(np.random.default_rng(seed), Terminal(), np.eye(4))
        for box, other in zip(moved, still, strict=True):
            np.testing.assert_allclose(box.pose[:3, 3] - other.pose[:3, 3], (0.1, 0.2, 0.3), atol=1e-12)


def test_the_default_mount_centres_the_dock() -> None:
    pose = look_at((0.0, 0.12, -0.12), (0.0, 0.0, 0.08))
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)
    inverse = np.linalg.inv(pose)
    seen = inverse @ [0.0, 0.0, 0.08, 1.0]
    np.testing.assert_allclose(seen[:2], 0.0, atol=1e-12)
    assert seen[2] == pytest.approx(0.2332, abs=1e-4)
    # Up in charger_base is up in the image (−y), and left stays left (−x).
    assert (inverse @ [0.0, 0.02, 0.08, 1.0])[1] < 0
    assert (inverse @ [0.02, 0.0, 0.08, 1.0])[0] < 0


def test_the_chargers_parts_hide_the_terminal_if_in_between() -> None:
    mount = look_at((0.0, 0.12, -0.12), (0.0, 0.0, 0.08))
    pose = np.linalg.inv(mount) @ shifted((0.0, 0.0, 0.08))
    bright = []
    for z in (-0.2, 0.075):
        parts = charger_parts(mount, (0.0, 0.0, z))
        assert all(box.in_camera for box in parts)
        bright.append((image(RenderedScene(foreground=tuple(parts)), pose) > 180).sum())
    assert bright[1] < 0.3 * bright[0]


def test_impossible_values_are_refused() -> None:
    with pytest.raises(RenderingError):
        cover(Terminal(), 1.2)
    with pytest.raises(RenderingError):
        cover(Terminal(), float("nan"))
    with pytest.raises(RenderingError):
        draw_scene(np.random.default_rng(0), clutter=-1)
    with pytest.raises(RenderingError):
        RenderedScene(light=(0.0, 0.0, 0.0))
    with pytest.raises(RenderingError):
        Box(2 * np.eye(4), (0.1, 0.1, 0.1), (0.5, 0.5, 0.5))
    with pytest.raises(RenderingError):
        Box(np.eye(4), (0.1, -0.1, 0.1), (0.5, 0.5, 0.5))
    with pytest.raises(RenderingError):
        Box(np.eye(4), (0.1, 0.1, float("nan")), (0.5, 0.5, 0.5))
    with pytest.raises(RenderingError):
        Box(np.eye(4), (0.1, 0.1, 0.1), (0.5, 0.5, 1.5))
