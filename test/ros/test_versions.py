# SPDX-License-Identifier: Apache-2.0
"""Supported ROS versions, and the refusal of others in one line before anything starts."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_core.environment import RUNS_ON

ROOT = Path(__file__).resolve().parents[2]
PINS = ROOT / "constraints" / "jazzy.txt"
OLDER = "import sys; sys.modules['rclpy.experimental'] = None\n"  # which rclpy has since Jazzy

CMAKE = shutil.which("cmake", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]))
needs_cmake = pytest.mark.skipif(CMAKE is None, reason="cmake is neither beside this Python nor on PATH")


def on_older_ros(folder: Path, *command: str) -> subprocess.CompletedProcess[str]:
    """Run a program on this ROS without the parts that an older ROS lacks."""
    (folder / "sitecustomize.py").write_text(OLDER)
    path = os.pathsep.join(filter(None, [str(folder), os.environ.get("PYTHONPATH")]))
    variables = {**os.environ, "PYTHONPATH": path}
    return subprocess.run([sys.executable, *command], env=variables, capture_output=True, text=True, timeout=60)


def refused(process: subprocess.CompletedProcess[str]) -> str:
    """Return the only output line; the exit code must be 2."""
    (line,) = process.stderr.splitlines()
    assert process.returncode == 2
    assert RUNS_ON in line
    return line


@pytest.mark.rest
@pytest.mark.ros
def test_a_node_refuses_an_older_ros(tmp_path: Path) -> None:
    """Called like the script that pip and colcon write for it."""
    process = on_older_ros(
        tmp_path, "-c", "import sys; from deltacharger_scenes.executables import docking_node; sys.exit(docking_node())"
    )
    refused(process)
    assert not process.stdout


@pytest.mark.rest
@pytest.mark.ros
def test_a_command_refuses_an_older_ros(tmp_path: Path) -> None:
    process = on_older_ros(tmp_path, "-m", "deltacharger_bringup.cli", "dock", "--scene", "mocks", "--json")
    line = refused(process)
    assert json.loads(process.stdout) == {"success": False, "error": line}


@pytest.mark.rest
def test_a_command_without_nodes_runs_on_any_ros(tmp_path: Path) -> None:
    process = on_older_ros(tmp_path, "-m", "deltacharger_bringup.cli", "scene")
    assert process.returncode == 0, process.stderr


def configured(folder: Path, version: str) -> str:
    """Return CMake's output for our project on a ROS that consists only of a version."""
    for package, stated in (("ament_cmake", "1"), ("ament_cmake_python", "1"), ("rosidl_default_generators", version)):
        place = folder / "share" / package / "cmake"
        place.mkdir(parents=True)
        (place / f"{package}Config.cmake").touch()
        (place / f"{package}ConfigVersion.cmake").write_text(
            f'set(PACKAGE_VERSION "{stated}")\nset(PACKAGE_VERSION_COMPATIBLE TRUE)\n'
        )
    variables = {name: value for name, value in os.environ.items() if name != "AMENT_PREFIX_PATH"}
    command = [str(CMAKE), "-S", str(ROOT), "-B", str(folder / "build"), f"-DCMAKE_PREFIX_PATH={folder}", "-Wno-dev"]
    command += [f"-D{package}_DIR={folder}/share/{package}/cmake" for package in ("ament_cmake", "ament_cmake_python")]
    command.append(f"-Drosidl_default_generators_DIR={folder}/share/rosidl_default_generators/cmake")
    process = subprocess.run(command, env=variables, capture_output=True, text=True, timeout=100)
    assert process.returncode != 0
    return process.stderr


@pytest.mark.rest
@needs_cmake
@pytest.mark.parametrize(("version", "supported"), [("1.5.0", False), ("1.6.0", True)])  # Iron's, Jazzy's
def test_it_is_built_on_supported_versions_only(tmp_path: Path, version: str, supported: bool) -> None:
    lines = configured(tmp_path, version).splitlines()
    refusals = [line for line in lines if "deltacharger runs on" in line]
    assert len(refusals) == (not supported)
    assert all(version in line for line in refusals)
    assert supported is any("action_msgs" in line for line in lines)  # the next dependency


def test_every_ros_package_of_the_build_has_its_jazzy_version() -> None:
    """A missing package would be installed in Kilted's version, or fail in CMake after a minute."""
    wanted = set(re.findall(r'^  "(ros-[a-z-]+)', (ROOT / "pyproject.toml").read_text(), re.MULTILINE))
    pinned = set(re.findall(r"^(ros-[a-z-]+)==[0-9.]+$", PINS.read_text(), re.MULTILINE))
    assert wanted - pinned == {"ros-ament-cmake-ros-core"}  # Kilted's half of ros-ament-cmake-ros
    assert "ros-ament-cmake-ros" in pinned
