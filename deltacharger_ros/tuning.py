# SPDX-License-Identifier: Apache-2.0
"""Parameters that may be set while their node runs, and periodic work at such a rate."""

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

_LAST = 2.0  # s for running work to end when its node closes

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


class Regularly:
    """A thread that works at a rate; no thread at rate 0.

    Args:
        work: called with its period (s) and an event; it must return when the event is set.
        name: name of the thread.
    """

    def __init__(self, work: Callable[[float, threading.Event], None], name: str) -> None:
        self._work = work
        self._name = name
        self._lock = threading.Lock()
        self._stopped = False
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, rate: float) -> None:
        """Work at a new rate (Hz), unless stopped; does not wait for running work."""
        with self._lock:
            if self._stopped:
                return
            self._stopping.set()
            self._stopping, self._thread = threading.Event(), None
            if rate > 0.0:
                arguments = (1.0 / rate, self._stopping)
                self._thread = threading.Thread(target=self._work, args=arguments, name=self._name, daemon=True)
                self._thread.start()

    def stop(self) -> None:
        """Stop, and wait for running work. Safe to call twice."""
        with self._lock:
            self._stopped = True
            self._stopping.set()
            thread, self._thread = self._thread, None
        if thread is not None:
            thread.join(_LAST)
