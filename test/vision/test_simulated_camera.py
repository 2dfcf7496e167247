# SPDX-License-Identifier: Apache-2.0
"""The simulated camera: geometry, noise, repeatability, depth of stereo matching."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene

from .views import DISTORTIONS, EVEN, FACES, IDEAL, VIEWS, edge_errors, linear, view

DEFAULT = CameraParameters()
NEAREST = DEFAULT.stereo_focal * DEFAULT.baseline / DEFAULT.disparities
PER_INVERSE = DEFAULT.stereo_focal * DEFAULT.baseline
WALL, FLAT = RenderedScene(parameters=EVEN, target=False), RenderedScene(parameters=EVEN)


def taken(scene: RenderedScene, pose: np.ndarray, seed: int = 0, lens: Intrinsics = OAK_D, **changed: Any) -> RgbdImage:
    """Return an image without errors, except those of changed camera parameters."""
    camera = SimulatedCamera(lens, dataclasses.replace(IDEAL, **changed))
    return camera.render(scene, pose, np.random.default_rng(seed))


@pytest.mark.parametrize(("pose", "distortion"), [*zip(VIEWS, (*DISTORTIONS, *DISTORTIONS), strict=False)])
def test_the_bars_edges_are_where_their_corners_project(pose: np.ndarray, distortion: tuple[float, ...]) -> None:
    lens = dataclasses.replace(OAK_D, distortion=distortion)
    errors = edge_errors(taken(FACES, pose, lens=lens), pose)
    assert len(errors) == 24
    assert np.abs(errors).max() < 0.5
    assert np.abs(errors).mean() < 0.15


def wall_at(distance: float) -> np.ndarray:
    return view(distance - EVEN.wall_distance)


def metal(pose: np.ndarray) -> np.ndarray:
    """Return the mask (H, W) of the touched faces, well inside."""
    bright = linear(taken(FLAT, pose).color) > 0.4
    for axis in (0, 1):
        bright = bright & np.roll(bright, 1, axis) & np.roll(bright, -1, axis)
    return bright


def test_a_seed_determines_the_image_also_colour_alone() -> None:
    camera = SimulatedCamera()
    first, again, other = (camera.render(RenderedScene(), view(0.4), np.random.default_rng(seed)) for seed in (1, 1, 2))
    alone = camera.render(RenderedScene(), view(0.4), np.random.default_rng(1), color_only=True)
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth, again.depth)
    np.testing.assert_array_equal(first.color, alone.color)
    assert (first.color != other.color).mean() > 0.3
    assert np.isnan(alone.depth).all()
    assert np.isfinite(first.depth).mean() > 0.5


def test_depth_noise_grows_with_the_square_of_the_distance() -> None:
    for distance in (0.3, 0.8):
        depth = taken(WALL, wall_at(distance), disparity_noise=0.15, disparity_step=0.125).depth
        noise = distance**2 * DEFAULT.disparity_noise / PER_INVERSE
        assert depth.std() == pytest.approx(noise, rel=0.15)
        assert depth.mean() == pytest.approx(distance, abs=0.1 * noise)


def test_nothing_outside_the_stereo_range_has_depth() -> None:
    assert pytest.approx(0.174, abs=1e-3) == NEAREST
    near, far = view(NEAREST - 0.008), view(NEAREST + 0.002)
    for noise in (0.0, 5.0):
        assert np.isnan(taken(FLAT, near, disparity_noise=noise).depth[metal(near)]).all()
    assert np.isfinite(taken(FLAT, far).depth[metal(far)]).all()
    noisy = SimulatedCamera().render(RenderedScene(), view(0.18, pitch=0.6), np.random.default_rng(3)).depth
    assert 0.173 <= np.nanmin(noisy) < 0.18
    for farthest, seen in ((2.9, False), (3.1, True)):
        assert (np.isfinite(taken(WALL, wall_at(3.0), farthest=farthest).depth) == seen).all()
