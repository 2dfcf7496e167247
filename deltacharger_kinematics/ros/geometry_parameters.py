# SPDX-License-Identifier: Apache-2.0
"""Geometry of the arm from a node's parameters or from a file."""

from __future__ import annotations

import dataclasses

from rclpy.node import Node

from deltacharger_core.bounded_file import given_path
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.geometry_file import load_geometry
from deltacharger_kinematics.parameters import GeometryFileParameters, GeometryParameters
from deltacharger_ros import node_support
from deltacharger_ros.parameters import declare_all


def declare_geometry(node: Node) -> DeltaGeometry:
    """Declare the geometry as parameters of `node` and return it.

    With a `geometry_file` its values are used, limb by limb, and shown in the single parameters. A parameter that is
    given as well must have the same value.

    Raises:
        StartupError: the file is missing or invalid, a value is out of range, or a given parameter differs.
    """
    file = declare_all(node, GeometryFileParameters).geometry_file
    base = _load(node, file) if file else DeltaGeometry()
    try:
        given = dataclasses.asdict(declare_all(node, GeometryParameters, defaults=base))
    except node_support.StartupError as error:
        raise node_support.StartupError(f"{error} (geometry_file '{file}')" if file else str(error)) from error
    for name, value in given.items():
        if file and value != (from_file := getattr(base, name)):
            raise node_support.StartupError(
                f"{node.get_name()}: parameter '{name}' is {value!r}, but parameter 'geometry_file' ('{file}') has "
                f"{from_file!r}; remove '{name}', or correct the file"
            )
    try:
        return dataclasses.replace(base, **given)
    except ValueError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


def _load(node: Node, file: str) -> DeltaGeometry:
    where = given_path(file).absolute()
    try:
        return load_geometry(where)
    except OSError as error:
        problem = f"'{where}' cannot be read: {error.strerror or error}; give a geometry file's path, or remove it"
    except ValueError as error:
        problem = str(error)
    raise node_support.StartupError(f"{node.get_name()}: parameter 'geometry_file': {problem}")
