# SPDX-License-Identifier: Apache-2.0
"""Optional libraries are imported where they are used, and named where they are missing."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.rest
IMAGES = "from pathlib import Path; from deltacharger_vision.image_files import read_color; read_color(Path('a.png'))"
MUJOCO = "from deltacharger_vision.rendering.mujoco_camera import MujocoCamera; MujocoCamera()"
MODULES = ("detector.detector", "detector.annotate", "cameras.oak_pipeline", "image_files", "rendering.mujoco_camera")


def run(code: str) -> tuple[int, str]:
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return ended.returncode, ended.stderr


@pytest.mark.parametrize("modules", [MODULES, ("cameras.camera_node",)])
def test_importing_vision_loads_no_optional_library(modules: tuple[str, ...]) -> None:
    names = ", ".join(f"deltacharger_vision.{name}" for name in modules)
    unwanted = {"cv2", "depthai", "mujoco"} | ({"rclpy"} if modules is MODULES else set())
    assert run(f"import sys, {names}\nassert not {unwanted} & {{*sys.modules}}") == (0, "")


@pytest.mark.parametrize(("library", "code", "extra"), [("cv2", IMAGES, "[vision]"), ("mujoco", MUJOCO, "[sim]")])
def test_a_missing_library_is_named_with_what_to_install(library: str, code: str, extra: str) -> None:
    status, text = run(f"import sys; sys.modules['{library}'] = None\n{code}")
    assert (status, extra in text.splitlines()[-1]) == (1, True), text
