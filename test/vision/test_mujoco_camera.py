# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's renderer against the ray-caster: the same positions, depths and materials."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from deltacharger_vision.errors import RendererError, RenderingError
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.mujoco_camera import MujocoCamera
from deltacharger_vision.rendering.parameters import CameraParameters
from deltacharger_vision.rendering.scene import Box, RenderedScene, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts, cover, draw_scene
from deltacharger_vision.terminal import UPPER, Terminal

from .views import EVEN, FACES, VIEWS, edge_errors, linear, shown, view

IDEAL = dataclasses.replace(CameraParameters.ideal(), disparities=1e4)
"""Sees depth at any distance."""
OTHER = Intrinsics(500, 380, 310.0, 352.0, 221.4, 208.3)
"""Neither square pixels nor a principal point in the middle."""


@pytest.fixture(scope="module")
def camera() -> Iterator[MujocoCamera]:
    try:
        made = MujocoCamera(parameters=IDEAL)
    except RendererError as error:
        pytest.skip(str(error))
    with made:
        yield made


def ideal(scene: RenderedScene, pose: np.ndarray, camera: MujocoCamera | SimulatedCamera) -> Any:
    return camera.render(scene, pose, np.random.default_rng(0))


def eroded(mask: np.ndarray, times: int = 2) -> np.ndarray:
    for _ in range(times):
        for axis in (0, 1):
            mask = mask & np.roll(mask, 1, axis) & np.roll(mask, -1, axis)
    return mask


def flat(depth: np.ndarray) -> np.ndarray:
    """Return (H, W) whether a pixel lies inside one face: 1/z is linear over it and its neighbours."""
    inverse = np.nan_to_num(1.0 / depth)
    bent = np.zeros(depth.shape, dtype=bool)
    for axis in (0, 1):
        bent |= np.abs(np.roll(inverse, 1, axis) + np.roll(inverse, -1, axis) - 2.0 * inverse) > 1e-4
    return eroded(~bent)


@pytest.mark.parametrize("pose", VIEWS)
def test_depth_inside_faces_matches_the_ray_caster(camera: MujocoCamera, pose: np.ndarray) -> None:
    scene = dataclasses.replace(draw_scene(np.random.default_rng(3), clutter=6), parameters=EVEN)
    ours, theirs = (ideal(scene, pose, each).depth for each in (camera, SimulatedCamera(parameters=IDEAL)))
    inside = flat(theirs) & np.isfinite(theirs)
    assert inside.mean() > 0.5
    assert np.isfinite(ours[inside]).all()
    near = inside & (theirs < 1.5)
    assert near.sum() > 10_000
    assert np.abs(ours - theirs)[near].max() < 2e-5
    np.testing.assert_allclose(ours[inside], theirs[inside], rtol=1e-4)


@pytest.mark.parametrize("pose", VIEWS)
def test_the_bars_edges_are_where_their_corners_project(camera: MujocoCamera, pose: np.ndarray) -> None:
    errors = edge_errors(ideal(FACES, pose, camera), pose)
    assert len(errors) == 24
    assert np.abs(errors).max() < 0.5
    assert np.abs(errors).mean() < 0.15


@pytest.mark.parametrize("pose", VIEWS)
def test_the_silhouettes_are_the_same(camera: MujocoCamera, pose: np.ndarray) -> None:
    scene = dataclasses.replace(RenderedScene(parameters=EVEN), foreground=(cover(Terminal(), 0.4),))
    ours, theirs = (
        np.nan_to_num(ideal(scene, pose, each).depth, nan=0.0) for each in (camera, SimulatedCamera(parameters=IDEAL))
    )
    differ = np.abs(ours - theirs) > 1e-3
    # Rounding decides where a pixel's centre lies on an edge: single pixels, never two adjacent ones across an edge.
    assert differ.mean() < 2e-3
    assert not eroded(differ, 1).any()


def test_pixels_need_not_be_square_nor_the_principal_point_in_the_middle(camera: MujocoCamera) -> None:
    pose = view(0.25, 0.3, 0.2, 0.4)
    with MujocoCamera(OTHER, IDEAL) as other:
        image = ideal(FACES, pose, other)
        assert np.abs(edge_errors(image, pose)).max() < 0.5
        theirs = ideal(FACES, pose, SimulatedCamera(OTHER, IDEAL)).depth
        inside = flat(theirs) & np.isfinite(theirs)
        assert np.abs(image.depth - theirs)[inside & (theirs < 0.8)].max() < 2e-5


def test_the_light_matches_the_scene(camera: MujocoCamera) -> None:
    scene, pose = RenderedScene(parameters=EVEN, light=(0.1, 0.9, -0.7)), view(0.25, 0.3)
    ours, theirs = (linear(ideal(scene, pose, each).color) for each in (camera, SimulatedCamera(parameters=IDEAL)))
    places = Terminal().corners().mean(axis=1)
    for point in (*places, np.array([0.05, 0.05, 0.006]), np.array([0.3, 0.0, EVEN.wall_distance])):
        column, row = np.rint(shown(point, pose, OAK_D)).astype(int)
        assert ours[row, column] == pytest.approx(theirs[row, column], rel=0.05)


def test_a_bar_casts_a_shadow_on_the_plate(camera: MujocoCamera) -> None:
    pose = view(0.25)
    image = linear(ideal(RenderedScene(parameters=EVEN, light=(0.0, 1.0, -0.7)), pose, camera).color)
    column, below = np.rint(shown(np.array([0.0, -Terminal().spacing / 2 - 0.008, 0.006]), pose, OAK_D)).astype(int)
    _, free = np.rint(shown(np.array([0.0, -0.04, 0.006]), pose, OAK_D)).astype(int)
    lit = EVEN.ambient + EVEN.diffuse * 0.7 / np.hypot(1.0, 0.7)
    assert image[below, column] / image[free, column] == pytest.approx(EVEN.ambient / lit, rel=0.12)


def test_a_highlight_moves_with_the_light(camera: MujocoCamera) -> None:
    shining = dataclasses.replace(EVEN, highlight=0.9)
    straight, aside = (
        ideal(RenderedScene(parameters=shining, light=light), view(0.25), camera).color.astype(int)
        for light in ((0.0, 0.0, -1.0), (1.0, 0.0, -0.3))
    )
    column, row = np.rint(shown(Terminal().corners()[UPPER].mean(axis=0), view(0.25), OAK_D)).astype(int)
    assert straight[row, column].min() == 255
    assert aside[row, column].max() < 230


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_holes_are_in_metal(camera: MujocoCamera, share: float) -> None:
    holes = dataclasses.replace(IDEAL, hole_metal=share, hole_glare=share)
    pose = view(0.3, 0.3)
    with MujocoCamera(parameters=holes) as holed:
        depth = ideal(RenderedScene(parameters=EVEN), pose, holed).depth
    metal = linear(ideal(FACES, pose, SimulatedCamera(parameters=IDEAL)).color) > 0.4
    assert eroded(metal).sum() > 500
    assert np.isnan(depth[eroded(metal)]).mean() == share
    plate = np.rint(shown(np.array([[0.06, 0.03, 0.006], [-0.06, -0.03, 0.006]]), pose, OAK_D)).astype(int)
    assert np.isfinite(depth[plate[:, 1], plate[:, 0]]).all()


def test_only_metal_has_streaks(camera: MujocoCamera) -> None:
    pose = view(0.25)
    plain = linear(ideal(RenderedScene(parameters=EVEN), pose, camera).color)
    brushed = linear(ideal(RenderedScene(parameters=dataclasses.replace(EVEN, streaks=0.1)), pose, camera).color)
    metal = eroded(plain > 0.4)
    assert np.std(brushed[metal] / plain[metal]) > 0.03
    assert np.abs(brushed - plain)[~(plain > 0.2)].max() == 0.0


def test_a_seed_determines_the_image_after_any_other(camera: MujocoCamera) -> None:
    with MujocoCamera() as noisy:
        scene, pose = draw_scene(np.random.default_rng(5), clutter=4), view(0.3, 0.3)
        first = noisy.render(scene, pose, np.random.default_rng(1))
        crowd = tuple(
            Box(shifted((0.02 * (i % 15) - 0.15, 0.02 * (i // 15) - 0.1, 0.5)), (0.01,) * 3, (0.5,) * 3)
            for i in range(150)
        )
        many = noisy.render(RenderedScene(background=crowd), pose, np.random.default_rng(2))
        again = noisy.render(scene, pose, np.random.default_rng(1))
        alone = noisy.render(scene, pose, np.random.default_rng(1), color_only=True)
    np.testing.assert_array_equal(first.color, again.color)
    np.testing.assert_array_equal(first.depth, again.depth)
    np.testing.assert_array_equal(first.color, alone.color)
    assert np.isnan(alone.depth).all()
    assert np.abs(many.color.astype(int) - first.color).mean() > 2.0


def test_the_chargers_own_parts_move_with_the_camera(camera: MujocoCamera) -> None:
    mount = Mount.default().pose
    target = np.eye(4)
    target[2, 3] = 0.08
    scene = RenderedScene(parameters=EVEN, foreground=tuple(charger_parts(mount, (0.0, 0.0, 0.04))))
    pose = np.linalg.inv(mount) @ target
    ours, theirs = (ideal(scene, pose, each) for each in (camera, SimulatedCamera(parameters=IDEAL)))
    inside = flat(theirs.depth) & (theirs.depth < 0.22)
    assert inside.sum() > 2000
    assert np.abs(ours.depth - theirs.depth)[inside].max() < 2e-5


@pytest.mark.parametrize(("width", "sizes"), [(1.0, (0.75, 1.25)), (1.8, (1.3, 2.1)), (6.0, (4.0, 7.0))])
def test_edges_are_as_wide_as_asked(camera: MujocoCamera, width: float, sizes: tuple[float, float]) -> None:
    pose = view(0.25, roll=0.02)  # slightly rotated, so that all parts of a pixel are tested
    with MujocoCamera(parameters=dataclasses.replace(IDEAL, edge_width=width)) as other:
        light = linear(ideal(FACES, pose, other).color)
    column, row = np.rint(shown(Terminal().corners()[UPPER].mean(axis=0), pose, OAK_D)).astype(int)
    # The ramp's width: 1 over its steepest mean slope, as the height of the step is 1.
    spreads = []
    for offset in range(-40, 41):
        profile = light[row - 40 : row, column + offset]
        step = np.abs(np.diff(profile)) / (profile.max() - profile.min())
        middle = step @ np.arange(len(step)) / step.sum()
        spreads.append(step @ (np.arange(len(step)) - middle) ** 2 / step.sum() - 1.0 / 12.0)
    # Sampling a ramp of variance w²/12 once a pixel adds 1/12.
    assert sizes[0] ** 2 / 12 < np.median(spreads) < sizes[1] ** 2 / 12


def test_a_closed_camera_raises_and_closing_twice_is_harmless(camera: MujocoCamera) -> None:
    with pytest.raises(RenderingError), MujocoCamera(parameters=IDEAL) as other:
        other.render(RenderedScene(), np.zeros((4, 4)), np.random.default_rng(0))
    other.close()
    with pytest.raises(RendererError, match="closed"):
        ideal(RenderedScene(), view(0.3), other)
    assert ideal(FACES, view(0.3), camera).color.max() > 100  # the other camera has its own context


def test_a_context_is_released_if_its_buffer_fails(camera: MujocoCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    import mujoco
    import mujoco.egl

    released: list[int] = []

    class Counted(mujoco.egl.GLContext):
        def free(self) -> None:
            if self._context:
                released.append(id(self))
            super().free()

    def refuse(*arguments: object) -> None:
        raise mujoco.FatalError("no framebuffer")

    monkeypatch.setattr(mujoco.egl, "GLContext", Counted)
    monkeypatch.setattr(mujoco, "MjrContext", refuse)
    with pytest.raises(RendererError, match="a smaller image"):
        MujocoCamera()
    assert len(released) == 1


def test_a_lens_that_distorts_is_refused() -> None:
    lens = dataclasses.replace(OAK_D, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    with pytest.raises(RendererError, match="SimulatedCamera"):
        MujocoCamera(lens)


def test_without_mujoco_the_error_states_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(RendererError, match=r"deltacharger\[sim\]"):
        MujocoCamera()


@pytest.mark.parametrize("backend", ["disable", "glfw", "nonsense"])
def test_without_opengl_the_error_states_what_to_install(camera: MujocoCamera, backend: str) -> None:
    code = "from deltacharger_vision.rendering.mujoco_camera import MujocoCamera; MujocoCamera()"
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    ended = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        env={**environment, "MUJOCO_GL": backend},
    )
    assert ended.returncode == 1
    assert "RendererError" in ended.stderr
    assert "libegl1" in ended.stderr.splitlines()[-1]


def test_it_draws_after_mujoco_has_simulated_a_world(camera: MujocoCamera) -> None:
    code = (
        "from deltacharger_sim.mujoco_world import mujoco_world\n"
        "from deltacharger_sim.parameters import WorldParameters\n"
        "from deltacharger_vision.rendering.mujoco_camera import MujocoCamera\n"
        "mujoco_world(WorldParameters()).step()\n"
        "MujocoCamera().close()"
    )
    environment = {name: value for name, value in os.environ.items() if name != "MUJOCO_GL"}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=environment)
    assert (ended.returncode, ended.stderr) == (0, "")


def test_the_detector_finds_what_it_draws(camera: MujocoCamera) -> None:
    pytest.importorskip("cv2", reason="the detector needs deltacharger[vision]")
    from deltacharger_vision.detector.detector import ElectrodeDetector

    with MujocoCamera() as noisy:
        for seed, away in enumerate((0.16, 0.25, 0.5)):
            pose = view(away, 0.3, 0.1, 0.2)
            found = ElectrodeDetector().detect(noisy.render(RenderedScene(), pose, np.random.default_rng(seed)))
            assert found is not None
            assert np.linalg.norm(found.position - pose[:3, 3]) < 0.002
