# SPDX-License-Identifier: Apache-2.0
"""Connects pip to CMakeLists.txt: builds the interfaces with CMake and installs the result as data files.

package.xml has name and version, setup.cfg the executables.
"""

from __future__ import annotations

import configparser
import os
import shutil
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ElementTree
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

from setuptools import Command, setup
from setuptools.command.build import build
from setuptools.dist import Distribution

ROOT = Path(__file__).resolve().parent
# One build folder per Python and environment, because their ROS may differ. It is laid out as colcon's --build-base, so
# that a colcon build of the same environment finds the interfaces compiled.
ENVIRONMENT = Path(sys.prefix).name.lstrip(".")
BASE = ROOT / "build" / f"{sysconfig.get_platform()}-{sys.implementation.cache_tag}-{ENVIRONMENT}"
BUILD = BASE / "deltacharger"
STAGE = BASE / "stage"

# Forwarders in lib/deltacharger let launch files and `ros2 run` find the executables of any venv.
FORWARDER = '#!/bin/sh\nexec "$(dirname "$(readlink -f "$0")")/../../bin/{name}" "$@"\n'


def ros_prefix() -> Path:
    """Return the prefix that the ROS build tools are installed in."""
    spec = find_spec("ament_package")
    if spec is None or spec.origin is None:
        sys.exit(
            "deltacharger: the ROS build tools are missing (no module named ament_package). Run pip without "
            "--no-build-isolation, or install the packages of [build-system] in pyproject.toml first."
        )
    package = Path(spec.origin).resolve()
    site = Path("lib") / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
    for parent in package.parents:
        if (parent / "share" / "ament_cmake").is_dir() or (parent / site).is_dir():
            return parent
    return package.parents[4]


def run_cmake() -> None:
    """Configure, build and install the CMake project into STAGE."""
    prefix = ros_prefix()
    environment = dict(os.environ)
    for variable in ("CMAKE_PREFIX_PATH", "AMENT_PREFIX_PATH"):
        environment[variable] = os.pathsep.join(filter(None, [str(prefix), environment.get(variable)]))
    # The cmake and ninja that [build-system] asks for, also where the environment is not activated.
    environment["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", os.defpath)])
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    command = [
        "cmake", "-S", str(ROOT), "-B", str(BUILD), "-G", "Ninja",
        f"-DCMAKE_INSTALL_PREFIX={STAGE}", "-DCMAKE_BUILD_TYPE=Release", "-DBUILD_TESTING=OFF",
        "-DDELTACHARGER_PYTHON_PACKAGES=OFF", f"-DPython3_EXECUTABLE={sys.executable}", "-Wno-dev",
    ]  # fmt: skip
    install = ["cmake", "--build", str(BUILD), "--target", "install"]
    shutil.rmtree(STAGE, ignore_errors=True)  # what an older version installed is not part of this one
    for step in (command, install):
        if subprocess.run(step, env=environment, stdout=sys.stderr).returncode:
            sys.exit("deltacharger: CMake cannot build the ROS interfaces; see the reason above")


def executables() -> list[str]:
    """Return the names of the executables in setup.cfg."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    lines = config["options.entry_points"]["console_scripts"].strip().splitlines()
    return [line.split("=")[0].strip() for line in lines]


def write_forwarders() -> None:
    """Write a script for each executable to lib/deltacharger of the stage."""
    folder = STAGE / "lib" / "deltacharger"
    folder.mkdir(parents=True, exist_ok=True)
    for name in executables():
        script = folder / name
        script.write_text(FORWARDER.format(name=name))
        script.chmod(0o755)


def staged_files() -> list[tuple[str, list[str]]]:
    """Return the staged tree in the form of setuptools' data_files, relative to the prefix."""
    folders: dict[str, list[str]] = {}
    for path in sorted(STAGE.rglob("*")):
        # The interfaces' egg-info would be a second distribution of the same name.
        skipped = "__pycache__" in path.parts or any(part.endswith(".egg-info") for part in path.parts)
        if path.is_file() and not skipped:
            folders.setdefault(str(path.relative_to(STAGE).parent), []).append(os.path.relpath(path, ROOT))
    return list(folders.items())


class BuildInterfaces(Command):
    """Run CMake first, so that its files exist when data files are listed."""

    description = "build the ROS interfaces and shared files with CMake"
    user_options: ClassVar[list[tuple[str, str, str]]] = []
    editable_mode = False

    def initialize_options(self) -> None:
        """Do nothing: CMakeLists.txt and package.xml have all settings."""

    def finalize_options(self) -> None:
        """Do nothing."""

    def run(self) -> None:
        """Build, stage and list the files."""
        run_cmake()
        write_forwarders()
        self.distribution.data_files = staged_files()


class Build(build):
    """The usual build, with the interfaces first."""

    sub_commands: ClassVar[list[Any]] = [("build_interfaces", None), *build.sub_commands]


class InterfaceDistribution(Distribution):
    """A platform wheel without extension module; its data files are also installed in editable mode."""

    def has_ext_modules(self) -> bool:
        """Mark the wheel as platform-specific."""
        return True

    def has_data(self) -> bool:
        """Return True, because otherwise setuptools' editable wheel omits data files."""
        return True


manifest = ElementTree.parse(ROOT / "package.xml").getroot()
setup(
    version=manifest.findtext("version"),
    cmdclass={"build": Build, "build_interfaces": BuildInterfaces},
    distclass=InterfaceDistribution,
    data_files=[],
)
