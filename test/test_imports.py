# SPDX-License-Identifier: Apache-2.0
"""Import rules: libraries below, ROS as a thin layer on top, no upward imports, no two files importing each other."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BELOW = {  # package: the packages that it may import, without the prefix deltacharger_
    "core": "",
    "ros": "core",
    "kinematics": "core",
    "driver": "core",
    "tactile": "core",
    "vision": "core",
    "docking": "core kinematics",
    "mission": "core kinematics docking",
    "sim": "core kinematics driver tactile vision",
    "records": "core ros kinematics driver tactile vision docking mission sim",
    "scenes": "core ros kinematics driver tactile vision docking mission sim records",
    "lab": "core ros kinematics driver tactile vision docking mission sim records scenes",
    "bringup": "core ros kinematics driver tactile vision docking mission sim records scenes lab",
}
KNOWS_ROS = {"ros", "records", "scenes", "lab", "bringup"}  # the others only in *_node.py, *_node_io.py and ros/
ROS_ROOTS = {"rclpy", "deltacharger", "rcl_interfaces", "builtin_interfaces", "launch", "launch_ros"}
ROS_SUFFIX = ("_msgs", "_srvs")
HEAVY = {"torch", "sklearn", "cv2", "depthai", "mujoco", "matplotlib", "xgboost", "onnxruntime"}
FILES = sorted(ROOT.glob("deltacharger_*/**/*.py"))
MODULES = {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in FILES}
NAME_OF = {path: name for name, path in MODULES.items()}


def is_shell(path: Path) -> bool:
    return path.stem.endswith(("_node", "_node_io")) or path.parent.name == "ros"


def package_of(path: Path) -> str:
    return path.relative_to(ROOT).parts[0].removeprefix("deltacharger_")


@cache
def imported(path: Path, *, at_once: bool = False) -> frozenset[str]:
    """Return the dotted names that a file imports; `at_once`: without imports inside functions."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = set()
    for node in tree.body if at_once else ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, f"{path}:{node.lineno}: use an absolute import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return frozenset(found)


def roots(names: frozenset[str]) -> set[str]:
    return {name.split(".")[0] for name in names}


def test_imports_point_downward() -> None:
    for path in FILES:
        package = package_of(path)
        ours = {root[13:] for root in roots(imported(path)) if root.startswith("deltacharger_")}
        allowed = {package, *BELOW[package].split(), *(["ros"] if is_shell(path) else [])}
        assert ours <= allowed, f"{path} may not import {sorted(ours - allowed)}"


def test_libraries_do_not_import_ros() -> None:
    for path in FILES:
        if package_of(path) in KNOWS_ROS or is_shell(path):
            continue
        ros = {name for name in roots(imported(path)) if name in ROS_ROOTS or name.endswith(ROS_SUFFIX)}
        shells = {name for name in imported(path) if (module := module_of(name)) and is_shell(MODULES[module])}
        assert not ros | shells, f"{path} is a library and may not import {sorted(ros | shells)}"


def test_no_package_below_scenes_imports_the_node_of_another() -> None:
    for path in FILES:
        if package_of(path) in ("scenes", "lab", "bringup"):  # which start nodes, or read what they declare
            continue
        others = {module_of(name) for name in imported(path)} - {""}
        foreign = {name for name in others if package_of(MODULES[name]) != package_of(path)}
        nodes = {name for name in foreign if name.endswith(("_node", "_node_io"))}
        assert not nodes, f"{path}: move the shared part of {sorted(nodes)} to its package's ros/"


def test_heavy_modules_are_imported_where_used() -> None:
    for path in FILES:
        assert not (heavy := roots(imported(path, at_once=True)) & HEAVY), f"{path}: {heavy}"


def module_of(name: str) -> str:
    """Return our module that an imported name is or belongs to; '' = not ours."""
    return name if name in MODULES else name.rpartition(".")[0] if name.rpartition(".")[0] in MODULES else ""


def test_no_two_files_import_each_other() -> None:
    arrows = {(NAME_OF[path], module_of(name)) for path in FILES for name in imported(path) if module_of(name)}
    assert not sorted((a, b) for a, b in arrows if a < b and (b, a) in arrows)


def test_no_two_public_classes_have_one_name() -> None:
    homes: dict[str, list[str]] = {}
    for path in FILES:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(NAME_OF[path])
    assert not {name: found for name, found in homes.items() if len(found) > 1}
    messages = {path.stem for folder in ("msg", "srv", "action") for path in (ROOT / folder).iterdir()}
    assert not messages & homes.keys(), "a class that is no message has a message's name"


def test_every_package_is_in_the_layer_table() -> None:
    assert {package_of(path) for path in FILES} == set(BELOW)
    order = list(BELOW)
    assert all(order.index(below) < order.index(package) for package in BELOW for below in BELOW[package].split())


def test_no_module_is_too_long() -> None:
    assert not {str(path.relative_to(ROOT)): n for path in FILES if (n := len(path.read_text().splitlines())) > 350}
