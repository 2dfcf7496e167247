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
    """Makes the tunable parameters of a table settable while their node runs; one table per node.

    One call sets all its values or none, and the answer states the reason. rclpy refuses read-only parameters and wrong
    types; this class also refuses values outside their bounds, contradicting values, and changes that the node does not
    accept now.

    Args:
        node: has declared the table with `declare_all` and called `reject_unknown`.
        given: the declared values.
        take: applies new values and returns '', or returns the reason of a refusal; must not wait.
    """

    def __init__(self, node: Node, given: T, take: Callable[[T], str]) -> None:
        self._log = Log(node)
        self._given = given
        self._take = take
        self._lock = threading.Lock()
        self._several = {each.name: isinstance(each.default, tuple) for each in declared(type(given))}
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        """Apply new values. rclpy has already checked type and access, and no later callback refuses."""
        values = {each.name: each.value for each in parameters if each.name in self._several}
        changes = {name: tuple(value) if self._several[name] else value for name, value in values.items()}
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
            self._log.info(f"{name} set to {value!r}")
        return SetParametersResult(successful=True)
