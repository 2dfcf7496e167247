# SPDX-License-Identifier: Apache-2.0
"""Supported ROS versions, and the refusal of others in one line before anything starts."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_core.environment import RUNS_ON

ROOT = Path(__file__).resolve().parents[2]
PINS = ROOT / "constraints" / "jazzy.txt"
OLDER = "import sys; sys.modules['rclpy.experimental'] = None\n"  # which rclpy has since Jazzy


def on_older_ros(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a program on this ROS without the parts that an older ROS lacks."""
    (folder / "sitecustomize.py").write_text(OLDER)
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    variables = {**os.environ, "PYTHONPATH": path}
    return subprocess.run([sys.executable, *command], env=variables, capture_output=True, text=True, timeout=60)


@pytest.mark.rest
@pytest.mark.ros
def test_a_command_refuses_an_older_ros(tmp_path: Path) -> None:
    process = on_older_ros(tmp_path, "-m", "deltacharger_bringup.cli", "dock", "--scene", "mocks", "--json")
    (line,) = process.stderr.splitlines()
    assert process.returncode == 2
    assert RUNS_ON in line
    assert json.loads(process.stdout) == {"success": False, "error": line}


def test_every_ros_package_of_the_build_has_its_jazzy_version() -> None:
    """A missing package would be installed in Kilted's version, or fail in CMake after a minute."""
    wanted = set(re.findall(r'^  "(ros-[a-z-]+)', (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    pinned = set(re.findall(r"^(ros-[a-z-]+)==[0-9.]+$", PINS.read_text(), re.MULTILINE))
    assert wanted - pinned == {"ros-ament-cmake-ros-core"}  # Kilted's half of ros-ament-cmake-ros
    assert "ros-ament-cmake-ros" in pinned
