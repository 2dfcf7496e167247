# SPDX-License-Identifier: Apache-2.0
"""Who may import whom: libraries below, ROS as a thin shell on top."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = sorted(path.parent.name for path in ROOT.glob("deltacharger_*/__init__.py"))
LIBRARIES_ALLOWED = {
    "deltacharger_kinematics": set(),
    "deltacharger_driver": set(),
    "deltacharger_tactile": set(),
    "deltacharger_vision": set(),
    "deltacharger_docking": {"deltacharger_kinematics"},
    "deltacharger_sim": {"deltacharger_kinematics"},
    "deltacharger_bringup": set(PACKAGES),
}
ROS_ROOTS = {"rclpy", "deltacharger", "rcl_interfaces", "builtin_interfaces", "launch", "launch_ros"}
ROS_SUFFIX = ("_msgs", "_srvs")
HEAVY = {"torch", "sklearn", "cv2", "depthai", "mujoco", "matplotlib", "xgboost", "onnxruntime"}
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def is_shell(path: Path) -> bool:
    return path.stem.endswith(("_node", "_node_io"))


def roots(tree: ast.AST, package: str) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(package if node.level else (node.module or "").split(".")[0])
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_imports_point_downward(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    imported = roots(ast.parse(path.read_text()), package)
    ours = {name for name in imported if name.startswith("deltacharger_")} - {package}
    allowed = LIBRARIES_ALLOWED[package] | ({"deltacharger_bringup"} if is_shell(path) else set())
    assert ours <= allowed, f"{path} may not import {sorted(ours - allowed)}"
    if package != "deltacharger_bringup" and not is_shell(path):
        ros = {name for name in imported if name in ROS_ROOTS or name.endswith(ROS_SUFFIX)}
        assert not ros, f"{path} is a library and may not import {sorted(ros)}"


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_heavy_modules_are_imported_where_used(path: Path) -> None:
    tree = ast.parse(path.read_text())
    top = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    assert not set().union(*(roots(node, "") for node in top)) & HEAVY


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_node_shells_use_of_bringup_only_what_nodes_share(path: Path) -> None:
    if not is_shell(path) or path.parent.name == "deltacharger_bringup":
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("deltacharger_bringup"):
            names = {alias.name for alias in node.names}
            modules = names if node.module == "deltacharger_bringup" else {node.module.split(".")[1]}  # type: ignore[union-attr]
            assert modules <= {"node_support", "on_demand"}
