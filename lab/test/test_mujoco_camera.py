# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's renderer against the ray-caster: the same positions, depths and materials."""

import dataclasses
import os
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from deltacharger_lab.mujoco.camera import MujocoCamera, RendererError
from deltacharger_vision import images, terminal
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene
from test.marks import rest
from test.vision.views import EVEN, FACES, IDEAL as EXACT, VIEWS, cover, edge_errors, linear, shown, view

IDEAL = dataclasses.replace(EXACT, disparities=1e4)
"""Sees depth at any distance."""
OTHER = images.Intrinsics(500, 380, 310.0, 352.0, 221.4, 208.3)
"""Neither square pixels nor a principal point in the middle."""


def opened(lens: images.Intrinsics, parameters: CameraParameters) -> MujocoCamera:
    try:
        return MujocoCamera(lens, parameters)
    except RendererError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def camera() -> Iterator[MujocoCamera]:
    with opened(OAK_D, IDEAL) as made:
        yield made


def ideal(scene: RenderedScene, pose: np.ndarray, camera: MujocoCamera | SimulatedCamera) -> Any:
    return camera.render(scene, pose, np.random.default_rng(0))


def run(code: str, **variables: str) -> Any:
    kept = {name: each for name, each in os.environ.items() if "DISPLAY" not in name and name != "MUJOCO_GL"}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=False, env=kept | variables)


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


def test_light_shadow_highlight_and_streaks_are_those_of_the_scene(camera: MujocoCamera) -> None:
    pose = view(0.25)
    places = np.array(
        [*terminal.Terminal().corners().mean(axis=1), (0.05, 0.05, 0.006), (0.3, 0.0, EVEN.wall_distance)]
    )
    columns, rows = np.rint(shown(places, pose, OAK_D)).astype(int).T
    lit = RenderedScene(parameters=EVEN, light=(0.0, 1.0, -0.7))
    ours, theirs = (linear(ideal(lit, pose, each).color) for each in (camera, SimulatedCamera(parameters=IDEAL)))
    assert ours[rows, columns] == pytest.approx(theirs[rows, columns], rel=0.05)
    shaded = np.array([0.0, -terminal.Terminal().spacing / 2 - 0.008, 0.006]), np.array([0.0, -0.04, 0.006])
    (column, below), (_, free) = np.rint(shown(np.array(shaded), pose, OAK_D)).astype(int)
    bright = EVEN.ambient + EVEN.diffuse * 0.7 / np.hypot(1.0, 0.7)
    assert ours[below, column] / ours[free, column] == pytest.approx(EVEN.ambient / bright, rel=0.12), "a bar's shadow"
    shining = RenderedScene(parameters=dataclasses.replace(EVEN, highlight=0.9), light=(0.0, 0.0, -1.0))
    straight, aside = (
        ideal(each, pose, camera).color[rows[terminal.UPPER], columns[terminal.UPPER]].max()
        for each in (shining, dataclasses.replace(shining, light=(1.0, 0.0, -0.3)))
    )
    assert straight == 255 > 230 > aside
    brushed = dataclasses.replace(lit, parameters=dataclasses.replace(EVEN, streaks=0.1))
    streaks = linear(ideal(brushed, pose, camera).color)
    metal = eroded(ours > 0.4)
    assert np.std(streaks[metal] / ours[metal]) > 0.03
    assert np.abs(streaks - ours)[~(ours > 0.2)].max() == 0.0


@pytest.mark.parametrize(
    ("lens", "pose"), [(OAK_D, VIEWS[2]), (OTHER, view(0.25, 0.3, 0.2, 0.4)), *(rest(OAK_D, pose) for pose in VIEWS)]
)
def test_edges_depth_and_silhouettes_match_the_ray_caster(lens: images.Intrinsics, pose: np.ndarray) -> None:
    covered = RenderedScene(parameters=EVEN, foreground=(cover(0.4),))
    with opened(lens, IDEAL) as other:
        errors, ours = np.abs(edge_errors(ideal(FACES, pose, other), pose)), ideal(covered, pose, other).depth
    assert errors.max() < 0.5
    assert errors.mean() < 0.15
    theirs = ideal(covered, pose, SimulatedCamera(lens, IDEAL)).depth
    inside = flat(theirs) & np.isfinite(theirs)
    assert np.abs(ours - theirs)[inside & (theirs < 1.5)].max() < 2e-5
    differ = np.abs(np.nan_to_num(ours) - np.nan_to_num(theirs)) > 1e-3
    # Rounding decides where a pixel's centre lies on an edge: single pixels, never two adjacent ones across an edge.
    assert differ.mean() < 2e-3
    assert not eroded(differ, 1).any()


def test_a_closed_camera_raises_and_a_lens_that_distorts_is_refused(camera: MujocoCamera) -> None:
    with MujocoCamera(parameters=IDEAL) as other:
        pass
    other.close()
    with pytest.raises(RendererError, match="closed"):
        ideal(RenderedScene(), view(0.3), other)
    assert ideal(FACES, view(0.3), camera).color.max() > 100  # the other camera has its own context
    with pytest.raises(RendererError, match="SimulatedCamera"):
        MujocoCamera(dataclasses.replace(OAK_D, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0)))


@pytest.mark.rest
@pytest.mark.parametrize("backend", ["disable", "glfw", "nonsense"])
def test_without_opengl_the_error_states_what_to_install(camera: MujocoCamera, backend: str) -> None:
    code = "from deltacharger_lab.mujoco.camera import MujocoCamera; MujocoCamera()"
    ended = run(code, MUJOCO_GL=backend)
    assert ended.returncode == 1
    assert "libegl1" in ended.stderr.splitlines()[-1]
