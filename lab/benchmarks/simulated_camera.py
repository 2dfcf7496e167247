# SPDX-License-Identifier: Apache-2.0
"""Time per image of the simulated camera: `python lab/benchmarks/simulated_camera.py`, about 10 seconds on one core.

It measures CPU time of this thread, so that a busy computer changes the figures little. Set OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import dataclasses
import time

import numpy as np

from deltacharger_vision.images import Intrinsics
from deltacharger_vision.mount import look_at
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, RenderedScene, SceneParameters, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts, draw_scene

DISTORTION = (-0.30, 0.12, 0.001, -0.0005, -0.02)
CAMERA_AT, CENTRED = (0.0, 0.12, -0.12), (0.0, 0.0, 0.08)


def facing(distance: float) -> np.ndarray:
    """Return camera_T_terminal of a terminal straight ahead at `distance` m."""
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[2, 3] = distance
    return pose


def cost(
    camera: SimulatedCamera, scene: RenderedScene, pose: np.ndarray, images: int, color_only: bool = False
) -> np.ndarray:
    """Return CPU milliseconds (images,) of single images, after two for warm-up."""
    random, found = np.random.default_rng(1), []
    for _ in range(images + 2):
        start = time.thread_time()
        camera.render(scene, pose, random, color_only)
        found.append(1e3 * (time.thread_time() - start))
    return np.array(found[2:])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--images", type=int, default=40, help="per line")
    images = parser.parse_args().images
    plain, even = RenderedScene(), RenderedScene(parameters=SceneParameters.even())
    drawn = draw_scene(np.random.default_rng(3), clutter=12, decoys=6)
    mount = look_at(CAMERA_AT, CENTRED)
    docking = RenderedScene(foreground=tuple(charger_parts(mount, (0.0, 0.0, 0.02))))
    at_dock = np.linalg.inv(mount) @ shifted(CENTRED)
    blurred = dataclasses.replace(CameraParameters(), motion_x=6.0, defocus=1.0)
    lens = dataclasses.replace(OAK_D, distortion=DISTORTION)
    large = OAK_D.scaled(1280, 800)
    cases: list[tuple[str, Intrinsics, CameraParameters, RenderedScene, np.ndarray, bool]] = [
        ("terminal at 0.15 m", OAK_D, CameraParameters(), plain, facing(0.15), False),
        ("terminal at 0.3 m", OAK_D, CameraParameters(), plain, facing(0.3), False),
        ("terminal at 1 m", OAK_D, CameraParameters(), plain, facing(1.0), False),
        ("the same, colour only", OAK_D, CameraParameters(), plain, facing(1.0), True),
        ("the same, ideal camera, even scene", OAK_D, CameraParameters.ideal(), even, facing(1.0), False),
        ("0.5 m, 12 boxes, 6 decoys", OAK_D, CameraParameters(), drawn, facing(0.5), False),
        ("docking, charger's parts in view", OAK_D, CameraParameters(), docking, at_dock, False),
        ("0.3 m, lens distortion", lens, CameraParameters(), plain, facing(0.3), False),
        ("0.3 m, blurred", OAK_D, blurred, plain, facing(0.3), False),
        ("0.3 m, 1280 × 800 px", large, CameraParameters(), plain, facing(0.3), False),
    ]
    print(f"CPU ms per image of 640 × 400 px unless stated, {images} images each: median, 95 %")
    for name, intrinsics, parameters, scene, pose, color_only in cases:
        took = cost(SimulatedCamera(intrinsics, parameters), scene, pose, images, color_only)
        print(f"{name:38s} {np.median(took):7.1f} {np.percentile(took, 95):7.1f}")


if __name__ == "__main__":
    main()
