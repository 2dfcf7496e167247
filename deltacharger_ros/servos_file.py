# SPDX-License-Identifier: Apache-2.0
"""What a node takes its servos for: parameters of its own, or out of a file of measured servos."""

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
    """Declare every parameter of a class as one of the node, those of its servos with what `servos_file` says of them.

    With `servos_file` the file alone decides these, and the parameters show what it says; one that was given beside it
    must say the same.

    Args:
        node: the node that owns them.
        table: a parameter class without groups, all of whose parameters have defaults.
        follows: of each parameter that the file decides, what it is called there.
        form: of the descriptions, see `Declaration.description`.

    Raises:
        StartupError: the file is missing or refused, a value is out of its range, or both were given and differ.
    """
    file = declare_all(node, ServosFileParameters).servos_file
    if not file:
        return declare_all(node, table, form=form)
    servos = _load(node, file)
    told = {name: getattr(servos, there) for name, there in follows.items()}
    try:
        usual = dataclasses.replace(table(), **told)  # type: ignore[type-var]
        given = declare_all(node, table, defaults=usual, form=form)
    except (node_support.StartupError, ValueError) as error:
        raise node_support.StartupError(f"{error} (servos_file '{file}')") from error
    for name, value in told.items():
        if getattr(given, name) != value:
            raise node_support.StartupError(
                f"{node.get_name()}: parameter '{name}' is {getattr(given, name)!r}, but parameter 'servos_file' "
                f"('{file}') says {value!r}; the file decides, so remove '{name}' or measure the servos again"
            )
    return given


def _load(node: Node, file: str) -> MeasuredServos:
    where = given_path(file).absolute()
    try:
        return load_servos(where)
    except OSError as error:
        problem = (
            f"'{where}' cannot be read: {error.strerror or error}; give a file of measured servos, or leave it out"
        )
    except ValueError as error:
        problem = str(error)
    raise node_support.StartupError(f"{node.get_name()}: parameter 'servos_file': {problem}")
