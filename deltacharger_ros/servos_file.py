# SPDX-License-Identifier: Apache-2.0
"""Servo properties of a node: from its parameters or from a file of measured servos."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TypeVar

from rclpy.node import Node

from deltacharger_core.bounded_file import given_path
from deltacharger_core.servos_file import MeasuredServos, ServosFileParameters, load_servos
from deltacharger_ros import node_support
from deltacharger_ros.parameters import declare_all

T = TypeVar("T")


def declare_with_servos(node: Node, table: type[T], follows: Mapping[str, str], form: str = "{text} ({unit})") -> T:
    """Declare every parameter of a class on the node; those of its servos take their values from `servos_file`.

    With a `servos_file` its values are used and shown in the parameters. A parameter that is given as well must have
    the same value.

    Args:
        node: owner of the parameters.
        table: a parameter class without groups, all of whose parameters have defaults.
        follows: parameter name to key in the file, for the parameters that the file sets.
        form: format of the descriptions, see `Declaration.description`.

    Raises:
        StartupError: the file is missing or invalid, a value is out of range, or a given parameter differs.
    """
    file = declare_all(node, ServosFileParameters).servos_file
    if not file:
        return declare_all(node, table, form=form)
    servos = _load(node, file)
    measured = {name: getattr(servos, key) for name, key in follows.items()}
    try:
        defaults = dataclasses.replace(table(), **measured)  # type: ignore[type-var]
        given = declare_all(node, table, defaults=defaults, form=form)
    except (node_support.StartupError, ValueError) as error:
        raise node_support.StartupError(f"{error} (servos_file '{file}')") from error
    for name, value in measured.items():
        if getattr(given, name) != value:
            raise node_support.StartupError(
                f"{node.get_name()}: parameter '{name}' is {getattr(given, name)!r}, but parameter 'servos_file' "
                f"('{file}') has {value!r}; remove '{name}', or measure the servos again"
            )
    return given


def _load(node: Node, file: str) -> MeasuredServos:
    where = given_path(file).absolute()
    try:
        return load_servos(where)
    except OSError as error:
        reason = error.strerror or error
        problem = f"'{where}' cannot be read: {reason}; give a file of measured servos, or remove the parameter"
    except ValueError as error:
        problem = str(error)
    raise node_support.StartupError(f"{node.get_name()}: parameter 'servos_file': {problem}")
