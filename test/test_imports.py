# SPDX-License-Identifier: Apache-2.0
"""Import rules: libraries below, ROS as a thin layer on top, no upward imports, no two files importing each other."""

import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ALL = (
    *("core", "core.ros", "kinematics", "driver", "tactile", "vision", "docking", "docking.mission"),
    *("sim", "sim.mocks", "bringup.records", "bringup.scenes", "bringup"),
)
BELOW = {  # room, or a part of it that others may not import: what it may import, without the prefix deltacharger_
    "core": (),
    **dict.fromkeys(("core.ros", "kinematics", "driver", "tactile", "vision"), ("core",)),
    "docking": ("core", "kinematics"),
    "docking.mission": ("core", "kinematics", "docking"),
    "sim": ("core", "kinematics", "driver", "tactile", "vision", "docking"),
    **{name: ALL[: ALL.index(name)] for name in ("sim.mocks", "bringup.records", "bringup.scenes", "bringup")},
}
# The others only in *_node.py and ros/.
KNOWS_ROS = {"core.ros", "sim.mocks", "bringup.records", "bringup.scenes", "bringup"}
_ROS = re.compile(r"(rclpy|deltacharger|rcl_interfaces|builtin_interfaces|launch|launch_ros|\w+_msgs|\w+_srvs)(\.|$)")
_IMPORT = re.compile(r"^[ \t]*(?:from ([\w.]+) import (\([^)]*\)|[^\n]+)|import ([\w.]+))", re.MULTILINE)


@cache
def texts() -> dict[str, str]:
    """Return the text of every module of ours."""
    return {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path.read_text("utf-8")
        for path in sorted(ROOT.glob("deltacharger_*/**/*.py"))
    }


def package_of(module: str) -> str:
    room, _, part = module.removeprefix("deltacharger_").partition(".")
    inner = f"{room}.{part.partition('.')[0]}"
    return inner if inner in BELOW else room


def is_shell(module: str) -> bool:
    return module.endswith("_node") or ".ros." in module


def imported(text: str) -> Iterator[str]:
    """Yield the dotted names that a file imports, of our modules without names from inside of them."""
    for source, names, module in _IMPORT.findall(text):
        for name in re.findall(r"^\W*(\w+)|,\s*(\w+)", names) if source else ():
            whole = f"{source}.{''.join(name)}"
            yield whole if whole in texts() else source
        if module:
            yield module


@cache
def imports() -> dict[str, set[str]]:
    return {module: set(imported(text)) for module, text in texts().items()}


def test_imports_point_downward() -> None:
    assert {package_of(module) for module in texts()} == set(BELOW) == set(ALL)
    for module, names in imports().items():
        package = package_of(module)
        ours = {package_of(name) for name in names if name.startswith("deltacharger_")}
        allowed = {package, *BELOW[package], *(["core.ros"] if is_shell(module) else [])}
        assert ours <= allowed, f"{module} may not import {sorted(ours - allowed)}"


def test_libraries_do_not_import_ros() -> None:
    for module, names in imports().items():
        if package_of(module) not in KNOWS_ROS and not is_shell(module):
            ros = {name for name in names if _ROS.match(name) or (name in texts() and is_shell(name))}
            assert not ros, f"{module} is a library and may not import {sorted(ros)}"


def test_no_two_files_import_each_other() -> None:
    arrows = {(module, name) for module, names in imports().items() for name in names & texts().keys()}
    assert len(arrows) > 1000
    assert not sorted((a, b) for a, b in arrows if a < b and (b, a) in arrows)


def test_servos_and_board_know_nothing_of_each_other() -> None:
    """Whoever knows both, such as the emulated board with servos behind it, lies above them."""
    for mine, other in (("servos", "board"), ("board", "servos")):
        left = [name for name in texts() if name.startswith(f"deltacharger_driver.{mine}.")]
        found: set[str] = set()
        while left:
            if (name := left.pop()) not in found and name in texts():
                found.add(name)
                left += [each for each in imports()[name] if each.startswith("deltacharger_driver.")]
        assert not sorted(name for name in found if name.startswith(f"deltacharger_driver.{other}."))


def test_a_program_handles_signals_before_it_imports_what_takes_long() -> None:
    """In the standard library alone threading, ctypes, dataclasses and typing take longer than all that is allowed."""
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r}); "
        "import deltacharger_bringup.cli.__main__, deltacharger_bringup.scenes.executables; print(*sys.modules)"
    )
    found = subprocess.run([sys.executable, "-S", "-I", "-c", code], capture_output=True, text=True, check=True)
    ours = {name for name in found.stdout.split() if name.startswith("deltacharger_")}
    assert ours == {
        *(
            "deltacharger_core",
            "deltacharger_core.signals",
            "deltacharger_bringup.scenes",
            "deltacharger_bringup.scenes.executables",
        ),
        *("deltacharger_bringup", "deltacharger_bringup.cli", "deltacharger_bringup.cli.__main__"),
    }
    assert not {"threading", "ctypes", "dataclasses", "typing", "re"} & set(found.stdout.split())
