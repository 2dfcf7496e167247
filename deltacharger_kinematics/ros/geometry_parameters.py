# SPDX-License-Identifier: Apache-2.0
"""Geometry of the arm from a node's file."""

from __future__ import annotations

from rclpy.node import Node

from deltacharger_core.files import given_path
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_kinematics.parameters import GeometryFileParameters
from deltacharger_ros import node_support
from deltacharger_ros.parameters import declare_all


def declare_geometry(node: Node) -> DeltaGeometry:
    """Declare `geometry_file` as a parameter of `node`, and return the arm's dimensions from it; empty = the defaults.

    Raises:
        StartupError: the file is missing or invalid.
    """
    file = declare_all(node, GeometryFileParameters).geometry_file
    return _load(node, file) if file else DeltaGeometry()


def _load(node: Node, file: str) -> DeltaGeometry:
    where = given_path(file).absolute()
    try:
        return load_geometry(where)
    except OSError as error:
        problem = f"'{where}' cannot be read: {error.strerror or error}; give a geometry file's path, or remove it"
    except ValueError as error:
        problem = str(error)
    raise node_support.StartupError(f"{node.get_name()}: parameter 'geometry_file': {problem}")
