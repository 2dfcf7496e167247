# SPDX-License-Identifier: Apache-2.0
"""Parameters that may be set while their node runs."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_core.parameters import ParameterError, declared
from deltacharger_ros.log import Log

T = TypeVar("T")


class Tuning(Generic[T]):
    """Lets the live parameters of a table be set while their node runs; one table a node.

    What one call sets is taken as a whole or refused as a whole, with the reason in the answer: as rclpy does with
    what is read-only or has another type, so with what lies outside its bounds, what contradicts another value, and
    what the node does not take now.

    Args:
        node: declared the table by `declare_all`, and refuses what it does not know by `reject_unknown`.
        given: what was declared.
        take: works with new values from now on and returns '', or returns why it does not; must not wait.
    """

    def __init__(self, node: Node, given: T, take: Callable[[T], str]) -> None:
        self._log = Log(node)
        self._given = given
        self._take = take
        self._lock = threading.Lock()
        self._several = {each.name: isinstance(each.default, tuple) for each in declared(type(given))}
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        """Take what is about to be set; rclpy has looked at type and access, and no other callback refuses after it."""
        told = {each.name: each.value for each in parameters if each.name in self._several}
        changes = {name: tuple(value) if self._several[name] else value for name, value in told.items()}
        with self._lock:
            try:
                given = replace(self._given, **changes)  # type: ignore[type-var]
            except ParameterError as error:
                return SetParametersResult(successful=False, reason=str(error))
            reason = self._take(given) if given != self._given else ""
            if reason:
                return SetParametersResult(successful=False, reason=f"{', '.join(changes)} not set: {reason}")
            self._given = given
        for name, value in changes.items():
            self._log.info(f"{name} is {value!r} from now on")
        return SetParametersResult(successful=True)
