# SPDX-License-Identifier: Apache-2.0
"""Defects of the simulated camera: noise, saturation, blur, and depth of stereo matching."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.rendering.camera import SimulatedCamera
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import RenderedScene

from .views import linear, view

IDEAL = CameraParameters.ideal()
EVEN = SceneParameters.even()
WALL = RenderedScene(parameters=EVEN, target=False)
DEFAULT = CameraParameters()
PER_INVERSE = DEFAULT.stereo_focal * DEFAULT.baseline


def rendered(scene: RenderedScene, pose: np.ndarray, seed: int = 0, **changed: Any) -> RgbdImage:
    parameters = dataclasses.replace(IDEAL, **changed)
    return SimulatedCamera(parameters=parameters).render(scene, pose, np.random.default_rng(seed))


def wall_at(distance: float) -> np.ndarray:
    return view(distance - EVEN.wall_distance)


def metal(pose: np.ndarray) -> np.ndarray:
    """Return the mask (H, W) of the touched faces, well inside."""
    bright = linear(rendered(RenderedScene(parameters=EVEN), pose).color) > 0.4
    for axis in (0, 1):
        bright = bright & np.roll(bright, 1, axis) & np.roll(bright, -1, axis)
    return bright


def test_a_seed_determines_the_image() -> None:
    camera = SimulatedCamera()
    first, again, other = (camera.render(RenderedScene(), view(0.4), np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth, again.depth)
    assert (first.color != other.color).mean() > 0.3


def test_colour_alone_gives_the_same_colour() -> None:
    camera = SimulatedCamera()
    whole = camera.render(RenderedScene(), view(0.4), np.random.default_rng(1))
    alone = camera.render(RenderedScene(), view(0.4), np.random.default_rng(1), color_only=True)
    np.testing.assert_array_equal(whole.color, alone.color)
    assert np.isnan(alone.depth).all()
    assert np.isfinite(whole.depth).mean() > 0.5


@pytest.mark.parametrize("distance", [0.3, 0.8])
def test_depth_noise_grows_with_the_square_of_the_distance(distance: float) -> None:
    depth = rendered(WALL, wall_at(distance), disparity_noise=0.15, disparity_step=0.125).depth
    assert depth.std() == pytest.approx(DEFAULT.depth_noise(distance), rel=0.15)
    assert depth.mean() == pytest.approx(distance, abs=0.1 * DEFAULT.depth_noise(distance))


def test_depth_noise_correlates_over_its_width_only() -> None:
    disparity = PER_INVERSE / rendered(WALL, wall_at(0.8), disparity_noise=0.2, noise_width=5).depth
    error = disparity - disparity.mean()
    for axis in (0, 1):
        for shift, expected in ((1, 0.8), (3, 0.4), (6, 0.0)):
            alike = np.mean(error * np.roll(error, shift, axis)) / error.var()
            assert alike == pytest.approx(expected, abs=0.05)


@pytest.mark.parametrize("step", [1 / 8, 1 / 32])
def test_disparity_has_steps(step: float) -> None:
    depth = rendered(WALL, view(0.2, yaw=0.4), disparity_step=step).depth
    steps = PER_INVERSE / depth / step
    assert len(np.unique(np.rint(steps))) > 20
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-2)


def test_depth_has_whole_millimetres() -> None:
    depth = 1e3 * rendered(WALL, view(0.2, yaw=0.4), whole_millimetres=True).depth
    np.testing.assert_allclose(depth, np.rint(depth), atol=1e-3)


def test_nothing_below_the_stereo_range_has_depth() -> None:
    assert pytest.approx(0.174, abs=1e-3) == DEFAULT.nearest
    near, far = view(DEFAULT.nearest - 0.008), view(DEFAULT.nearest + 0.002)
    assert np.isnan(rendered(RenderedScene(parameters=EVEN), near).depth[metal(near)]).all()
    assert np.isfinite(rendered(RenderedScene(parameters=EVEN), far).depth[metal(far)]).all()
    assert np.isnan(rendered(RenderedScene(parameters=EVEN), near, disparity_noise=5.0).depth[metal(near)]).all()
    noisy = SimulatedCamera().render(RenderedScene(), view(0.18, pitch=0.6), np.random.default_rng(3)).depth
    assert 0.173 <= np.nanmin(noisy) < 0.18


def test_nothing_beyond_the_farthest_has_depth() -> None:
    assert np.isnan(rendered(WALL, wall_at(3.0), farthest=2.9).depth).all()
    assert np.isfinite(rendered(WALL, wall_at(3.0), farthest=3.1).depth).all()


def test_only_metal_has_holes_with_the_given_share() -> None:
    pose, shares = view(0.2), []
    solid = rendered(RenderedScene(parameters=EVEN), pose).depth < 0.2055
    for seed in range(10):
        lost = np.isnan(rendered(RenderedScene(parameters=EVEN), pose, seed, hole_metal=0.4, hole_glare=0.4).depth)
        assert not (lost & ~solid).any()
        shares.append(lost[metal(pose)].mean())
    assert np.mean(shares) == pytest.approx(0.4, abs=0.05)


def test_glare_is_bright_and_costs_depth() -> None:
    pose = view(0.3)
    lit = dataclasses.replace(EVEN, highlight=1.5)
    # Ahead of the bars the light is reflected to the camera; far aside it is not.
    for light, bright in (((0.0, 0.0, -1.0), True), ((3.0, 0.0, -1.0), False)):
        image = rendered(RenderedScene(parameters=lit, light=light), pose, hole_metal=0.0, hole_glare=0.9)
        inside = metal(pose)
        assert ((image.color[inside] == 255).mean() > 0.3) == bright
        assert (np.isnan(image.depth[inside]).mean() > 0.2) == bright


def test_brushed_metal_varies_separately_along_and_across_its_brushing() -> None:
    inside = metal(view(0.2))
    upper = np.s_[np.flatnonzero(inside.any(axis=1))[2:18], 260:380]
    for changed, steady, varying in (({"streaks": 0.1}, 1, 0), ({"mirrored": 0.1}, 0, 1)):
        scene = RenderedScene(parameters=dataclasses.replace(EVEN, **changed))
        light = linear(rendered(scene, view(0.2)).color)[upper]
        assert light.std(axis=varying).mean() / light.mean() > 0.02
        assert light.std(axis=steady).mean() / light.mean() < 0.01


def test_each_side_of_the_plate_hides_the_wall_from_one_camera() -> None:
    pose = view(0.35)
    lost = np.isnan(rendered(RenderedScene(parameters=EVEN), pose, occlusion=True).depth[140])
    plate, wall = 0.35 + 0.006, 0.35 + EVEN.wall_distance
    half = 0.5 * PER_INVERSE * (1 / plate - 1 / wall)
    outside = 0.5 * PER_INVERSE / wall
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]]))))[::2]
    assert runs == pytest.approx([outside, half, half, outside], abs=2.0)


def test_near_depth_spreads_over_far_depth() -> None:
    pose = view(0.35)
    plain, grown = (rendered(RenderedScene(parameters=EVEN), pose, fattening=reach).depth < 0.4 for reach in (0, 2))
    assert (grown.any(axis=0).sum(), grown.any(axis=1).sum()) == (
        plain.any(axis=0).sum() + 4,
        plain.any(axis=1).sum() + 4,
    )


def test_a_slope_does_not_spread() -> None:
    pose = view(0.3, yaw=0.7)
    depth = [rendered(WALL, pose, fattening=reach).depth for reach in (0, 2)]
    np.testing.assert_array_equal(*depth)


@pytest.mark.parametrize("exposure", [0.5, 1.0, 2.5])
def test_light_is_kept_until_it_saturates(exposure: float) -> None:
    once = linear(rendered(RenderedScene(parameters=EVEN), view(0.3)).color)
    given = linear(rendered(RenderedScene(parameters=EVEN), view(0.3), exposure=exposure).color)
    np.testing.assert_allclose(given, np.minimum(exposure * once, 1.0), atol=0.02)


def test_metal_saturates_when_over_exposed() -> None:
    inside = metal(view(0.3))
    assert (rendered(RenderedScene(), view(0.3), exposure=2.5).color[inside] == 255).mean() > 0.5
    assert (rendered(RenderedScene(), view(0.3), exposure=1.0).color[inside] == 255).mean() < 0.1


def test_colour_noise_is_shot_noise_and_read_noise() -> None:
    found = []
    for exposure in (0.2, 1.0, 2.0):
        clean = linear(rendered(WALL, view(0.5), exposure=exposure).color).mean()
        light = linear(rendered(WALL, view(0.5), exposure=exposure, shot_noise=0.04, read_noise=0.01).color)
        assert light.mean() == pytest.approx(clean, rel=0.02)
        found.append(light.std() / np.hypot(0.01, 0.04 * np.sqrt(clean)))
    np.testing.assert_allclose(found, 1.0, atol=0.05)


@pytest.mark.parametrize(("x", "y"), [(9.0, 0.0), (0.0, 9.0), (-9.0, 0.0)])
def test_motion_blurs_edges_only_along_itself(x: float, y: float) -> None:
    light = linear(rendered(RenderedScene(parameters=EVEN), view(0.3), motion_x=x, motion_y=y).color)
    still = linear(rendered(RenderedScene(parameters=EVEN), view(0.3)).color)
    assert light.mean() == pytest.approx(still.mean(), rel=0.01)
    across, down = (
        np.abs(np.diff(light, axis=axis)).max() / np.abs(np.diff(still, axis=axis)).max() for axis in (1, 0)
    )
    spread, kept = (across, down) if x else (down, across)
    assert spread < 0.3
    assert kept > 0.8


def test_defocus_is_a_gaussian() -> None:
    # Across the plate's edge the light becomes its integral: a fifth to four fifths within 2 · 0.8416 σ.
    light = linear(rendered(RenderedScene(parameters=EVEN), view(0.3), defocus=4.0).color)[150, :320]
    low, high = light.min(), light.max()
    within = (light > low + 0.2 * (high - low)) & (light < low + 0.8 * (high - low))
    assert within.sum() == pytest.approx(2 * 0.8416 * 4.0, abs=1.0)


@pytest.mark.parametrize(
    "wrong",
    [
        {"exposure": 0.0},
        {"exposure": float("nan")},
        {"baseline": -0.075},
        {"noise_width": 2.5},
        {"noise_width": 0},
        {"hole_metal": 1.1},
        {"disparity_step": 2.0},
    ],
    ids=str,
)
def test_parameters_have_bounds(wrong: dict[str, Any]) -> None:
    with pytest.raises(ParameterError) as caught:
        CameraParameters(**wrong)
    assert caught.value.key in wrong


def test_scene_parameters_have_bounds() -> None:
    with pytest.raises(ParameterError, match="plate_width"):
        SceneParameters(plate_width=20.0)
