# SPDX-License-Identifier: Apache-2.0
"""Geometry of the simulated camera, without noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from deltacharger_vision.errors import RenderingError
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.projection import undistort
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.parameters import CameraParameters, SceneParameters
from deltacharger_vision.rendering.scene import Box, RenderedScene, shifted
from deltacharger_vision.rendering.scene_drawing import cover
from deltacharger_vision.terminal import LOWER, UPPER, Terminal

from .views import DISTORTIONS, EVEN, FACES, VIEWS, edge_errors, linear, shown, view

IDEAL = CameraParameters.ideal()


def rendered(scene: RenderedScene, pose: np.ndarray, camera: SimulatedCamera | None = None, seed: int = 0) -> RgbdImage:
    return (camera or SimulatedCamera(parameters=IDEAL)).render(scene, pose, np.random.default_rng(seed))


@pytest.mark.parametrize("distortion", DISTORTIONS)
@pytest.mark.parametrize("pose", VIEWS)
def test_the_bars_edges_are_where_their_corners_project(distortion: tuple[float, ...], pose: np.ndarray) -> None:
    camera = SimulatedCamera(dataclasses.replace(OAK_D, distortion=distortion), IDEAL)
    errors = edge_errors(rendered(FACES, pose, camera), pose)
    assert len(errors) == 24
    assert np.abs(errors).max() < 0.5
    assert np.abs(errors).mean() < 0.15


@pytest.mark.parametrize("pose", VIEWS[1:])
@pytest.mark.parametrize("distortion", DISTORTIONS[:2])
def test_depth_of_the_plate_is_where_the_ray_meets_it(distortion: tuple[float, ...], pose: np.ndarray) -> None:
    intrinsics = dataclasses.replace(OAK_D, distortion=distortion)
    depth = rendered(RenderedScene(), pose, SimulatedCamera(intrinsics, IDEAL)).depth
    # Points of the plate, beside the bars; each is read from its pixel.
    x, y = np.meshgrid(np.linspace(-0.095, 0.095, 60), np.linspace(-0.055, 0.055, 40))
    beside = (np.abs(x) > 0.05) | (np.abs(y) > 0.025)
    points = np.stack([x[beside], y[beside], np.full(beside.sum(), Terminal().bar_thickness)], axis=-1)
    pixels = np.rint(shown(points, pose, intrinsics)).astype(int)
    inside = (pixels >= 0).all(axis=1) & (pixels < [640, 400]).all(axis=1)
    columns, rows = pixels[inside].T
    assert len(rows) > 500
    seen = np.stack([(columns - 319.5) / 441.0, (rows - 199.5) / 441.0], axis=-1)
    rays = np.concatenate([undistort(seen, distortion), np.ones((len(rows), 1))], axis=-1)
    normal = pose[:3, 2]
    expected = (normal @ (pose[:3, 3] + Terminal().bar_thickness * normal)) / (rays @ normal)
    np.testing.assert_allclose(depth[rows, columns], expected, atol=1e-4)


def test_a_mirrored_scene_gives_the_mirrored_image() -> None:
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    pose = view(0.35, 0.2, 0.3, 0.4, x=0.03)
    camera = SimulatedCamera(parameters=dataclasses.replace(IDEAL, occlusion=True, fattening=2))
    parameters = dataclasses.replace(SceneParameters(), streaks=0.0, mirrored=0.0, unevenness=0.0)
    one = RenderedScene(parameters=parameters, light=(0.3, 0.2, -1.0), foreground=(cover(Terminal(), 0.3, side=1),))
    other = RenderedScene(parameters=parameters, light=(-0.3, 0.2, -1.0), foreground=(cover(Terminal(), 0.3, side=-1),))
    image, twin = rendered(one, pose, camera), rendered(other, mirror @ pose @ mirror, camera)
    assert np.abs(image.color[:, ::-1].astype(int) - twin.color).max() <= 1
    differ = ~np.isclose(image.depth[:, ::-1], twin.depth, atol=1e-4, equal_nan=True)
    assert differ.mean() < 1e-3  # rounding decides where a pixel's centre lies on an edge
    assert np.isnan(image.depth).mean() > 0.01


@pytest.mark.parametrize("bar", [UPPER, LOWER])
@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.8])
def test_a_cover_hides_its_share_of_its_bar(bar: int, side: int, share: float) -> None:
    pose = view(0.4)
    whole = linear(rendered(FACES, pose).color)
    hidden = linear(rendered(dataclasses.replace(FACES, foreground=(cover(Terminal(), share, bar, side),)), pose).color)
    middle = shown(Terminal().corners().mean(axis=1), pose, OAK_D)
    for index, (x, y) in enumerate(middle):
        row, column = round(y), round(x)
        before, after = whole[row] > 0.3, hidden[row] > 0.3
        lost = 1.0 - after.sum() / before.sum()
        assert lost == pytest.approx(share if index == bar else 0.0, abs=0.02)
        # +x of the terminal is to the left in the image.
        gone = np.flatnonzero(before & ~after)
        if len(gone) and index == bar:
            assert np.sign(column - gone.mean()) == side


def test_near_things_hide_far_ones_in_any_order() -> None:
    near = Box(shifted((0.0, 0.0, 0.3)), (0.05, 0.05, 0.02), (0.9, 0.0, 0.0), in_camera=True)
    far = Box(shifted((0.0, 0.0, 0.4)), (0.2, 0.2, 0.02), (0.0, 0.0, 0.9), in_camera=True)
    for boxes in ((near, far), (far, near)):
        image = rendered(RenderedScene(parameters=EVEN, foreground=boxes, target=False), view(1.0))
        red, _, blue = image.color[200, 320].astype(int)
        assert red > blue
        assert image.depth[200, 320] == pytest.approx(0.29, abs=1e-6)
        red, _, blue = image.color[200, 400].astype(int)
        assert blue > red
        assert image.depth[200, 400] == pytest.approx(0.39, abs=1e-6)


def test_a_wide_box_hides_nothing_in_front_of_it() -> None:
    # The panel's centre is nearer to the camera than the item's.
    panel = Box(shifted((0.0, 0.0, 0.4)), (1.0, 0.5, 0.02), (0.0, 0.0, 0.9), in_camera=True)
    item = Box(shifted((0.2, 0.0, 0.35)), (0.05, 0.05, 0.02), (0.9, 0.0, 0.0), in_camera=True)
    image = rendered(RenderedScene(parameters=EVEN, foreground=(panel, item), target=False), view(1.0))
    column = round(319.5 + 441.0 * 0.2 / 0.34)
    red, _, blue = image.color[200, column].astype(int)
    assert red > blue
    assert image.depth[200, column] == pytest.approx(0.34, abs=1e-6)


def test_a_box_that_extends_behind_the_camera_is_complete() -> None:
    beside = Box(shifted((0.125, 0.0, 0.0)), (0.15, 1.0, 0.2), (0.9, 0.0, 0.0), in_camera=True)
    image = rendered(RenderedScene(parameters=EVEN, foreground=(beside,), target=False), view(1.0))
    # Its inner wall begins at x = 50 mm, z = 100 mm, and passes out of the image nearer to the camera.
    edge = 319.5 + 441.0 * 0.5
    red = image.color[:, :, 0].astype(int) - image.color[:, :, 2] > 20
    assert red[:, int(edge) + 2 :].all()
    assert not red[:, : int(edge) - 1].any()


def test_things_out_of_sight_change_nothing() -> None:
    nothing = rendered(RenderedScene(parameters=EVEN, target=False), view(0.5))
    behind = Box(shifted((0.0, 0.0, -0.5)), (0.1, 0.1, 0.1), (0.9, 0.9, 0.9), in_camera=True)
    around = Box(shifted((0.0, 0.0, 0.0)), (0.1, 0.1, 0.1), (0.9, 0.9, 0.9), in_camera=True)
    aside = Box(shifted((5.0, 0.0, 0.5)), (0.1, 0.1, 0.1), (0.9, 0.9, 0.9), in_camera=True)
    scene = RenderedScene(parameters=EVEN, foreground=(behind, around, aside), target=False)
    np.testing.assert_array_equal(rendered(scene, view(0.5)).color, nothing.color)


def test_the_sides_of_a_bar_are_visible_from_the_side() -> None:
    scene = dataclasses.replace(FACES, light=(0.0, 1.0, -0.2))  # from above: upper sides are brightest
    light = linear(rendered(scene, view(0.25, pitch=0.5)).color)
    below = linear(rendered(scene, view(0.25, pitch=-0.5)).color)
    assert (light > 0.4).sum() > 300 > 10 > (below > 0.4).sum()


@pytest.mark.parametrize(
    "pose",
    [np.eye(3), np.zeros((4, 4)), 2 * np.eye(4), np.diag([-1.0, 1.0, 1.0, 1.0]), np.full((4, 4), np.nan)],
)
def test_an_invalid_pose_is_refused(pose: np.ndarray) -> None:
    with pytest.raises(RenderingError, match="camera_T_terminal"):
        SimulatedCamera().render(RenderedScene(), pose, np.random.default_rng(0))
