# SPDX-License-Identifier: Apache-2.0
"""Declared parameters as those of a node."""

from __future__ import annotations

import math
from typing import Any, TypeVar

from rclpy.node import Node

from deltacharger_core.parameters import ParameterError, declared
from deltacharger_ros import node_support

T = TypeVar("T")


def declare_all(node: Node, table: type[T], defaults: T | None = None, form: str = "{text} ({unit})") -> T:
    """Declare every parameter of a class as one of the node, and return what was given.

    Args:
        node: the node that owns them.
        table: a parameter class without groups.
        defaults: in place of the class's own.
        form: of the descriptions, see `Declaration.description`.

    Raises:
        StartupError: a given value has another type, lies outside its bounds or contradicts another one.
    """
    values: dict[str, Any] = {}
    for each in declared(table):
        default = each.default if defaults is None else getattr(defaults, each.name)
        value = node_support.declare(
            node,
            each.name,
            list(default) if isinstance(default, tuple) else default,
            each.description(form),
            each.low if math.isfinite(each.low) else None,
            each.high if math.isfinite(each.high) else None,
            each.choices,
            read_only=not each.live,
        )
        values[each.name] = tuple(value) if isinstance(default, tuple) else value
    try:
        return table(**values)
    except ParameterError as error:
        raise node_support.StartupError(f"{node.get_name()}: parameter '{error.key}': {error.problem}") from error
