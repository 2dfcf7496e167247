# SPDX-License-Identifier: Apache-2.0
"""What every node of the package shares: declared parameters, and a main that always ends safely."""

from __future__ import annotations

import difflib
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from types import FrameType
from typing import Any, Protocol

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import (
    InvalidParameterTypeException,
    InvalidParameterValueException,
    ParameterException,
)
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from deltacharger_core import environment
from deltacharger_ros.executor import Spinner

_OWN_PARAMETERS = {"use_sim_time", "start_type_description_service"}


class StartupError(RuntimeError):
    """A node cannot start as configured; the message says what to change. The process ends with code 2."""


class ClosableNode(Protocol):
    """A node whose `close` leaves the hardware safe and its threads joined; calling it twice does no harm."""

    def close(self) -> None:
        """Make everything that the node drives safe."""

    def destroy_node(self) -> None:
        """Release the ROS side."""


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    minimum: float | None = None,
    maximum: float | None = None,
    choices: Sequence[str] = (),
    read_only: bool = True,
) -> Any:
    """Declare a parameter with its description and bounds and return its value.

    Args:
        node: the node that owns it.
        name: parameter name.
        default: value and type when nothing is given.
        description: one sentence with the unit.
        minimum: smallest allowed number (also for each element of an array).
        maximum: largest allowed number (also for each element of an array).
        choices: the allowed strings.
        read_only: whether it is fixed once the node runs.

    Raises:
        StartupError: the given value has another type or lies outside its bounds.
    """
    descriptor = ParameterDescriptor(name=name, description=description, read_only=read_only)
    if choices:
        descriptor.additional_constraints = "one of: " + ", ".join(choices)
    elif minimum is not None or maximum is not None:
        _bound(descriptor, default, minimum, maximum)
    try:
        value = node.declare_parameter(name, default, descriptor).value
    except (InvalidParameterTypeException, InvalidParameterValueException, ParameterException) as error:
        raise StartupError(f"{node.get_name()}: parameter '{name}': {error}. {description}") from error
    problem = _problem(value, minimum, maximum, choices)
    if problem:
        raise StartupError(f"{node.get_name()}: parameter '{name}' is {value!r}, {problem}. {description}")
    return value


def _bound(descriptor: ParameterDescriptor, default: Any, minimum: float | None, maximum: float | None) -> None:
    if isinstance(default, bool | str | list):
        descriptor.additional_constraints = f"{minimum} to {maximum}"
    elif isinstance(default, int):
        low = -(2**63) if minimum is None else int(minimum)
        high = 2**63 - 1 if maximum is None else int(maximum)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    else:
        low_f = -float("inf") if minimum is None else float(minimum)
        high_f = float("inf") if maximum is None else float(maximum)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low_f, to_value=high_f, step=0.0)]


def _problem(value: Any, minimum: float | None, maximum: float | None, choices: Sequence[str]) -> str:
    if choices:
        return "" if value in choices else "not one of " + ", ".join(choices)
    numbers = list(value) if hasattr(value, "__iter__") and not isinstance(value, str) else [value]
    for number in numbers:
        if isinstance(number, bool | str):
            continue
        if number != number:
            return "not a number"
        if minimum is not None and number < minimum:
            return f"below {minimum}"
        if maximum is not None and number > maximum:
            return f"above {maximum}"
    return ""


def reject_unknown(node: Node) -> None:
    """Stop the node where a parameter was given that it does not have.

    Raises:
        StartupError: names the parameter and the nearest known one.
    """
    known = set(node._parameters) | _OWN_PARAMETERS
    for name in node._parameter_overrides:
        if name in known or name.startswith("qos_overrides."):
            continue
        near = difflib.get_close_matches(name, sorted(known), 1)
        hint = f"; did you mean '{near[0]}'?" if near else ""
        raise StartupError(f"{node.get_name()}: unknown parameter '{name}'{hint}")


def ros_problem(error: Exception) -> str:
    """Return in one line what rclpy refused, or '' where `error` is not one of its own."""
    kind = type(error)
    if not kind.__module__.startswith(("rclpy", "_rclpy")):
        return ""
    lines = str(error).strip().splitlines() or [kind.__name__]
    what = f"unknown ROS arguments {lines[0]}" if kind.__name__ == "UnknownROSArgsError" else lines[0]
    return f"ROS refuses: {what}; check names, --ros-args, ROS_DOMAIN_ID and ROS_LOG_DIR"


def run(factory: Callable[[], Node], args: Sequence[str] | None = None) -> int:
    """Run one node until SIGINT, SIGTERM or SIGHUP, then close it; the main of every executable.

    Args:
        factory: builds the node (its class).
        args: command line, default sys.argv.

    Returns:
        Exit code: 0 after a signal, 2 where the node cannot start as configured.
    """
    stop = threading.Event()

    def request_stop(number: int, frame: FrameType | None) -> None:
        stop.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # ignored = started by nohup
            signal.signal(number, request_stop)
    try:
        problem = environment.domain_problem()
        if problem:
            raise StartupError(problem)
        environment.announce()
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises its own kinds for arguments, log folder and domain
        print(f"cannot start: {ros_problem(error) or error}", file=sys.stderr)
        return 2
    try:
        try:
            node = factory()
        except Exception as error:
            problem = str(error) if isinstance(error, StartupError | OSError) else ros_problem(error)
            if not problem:
                raise
            print(problem, file=sys.stderr)
            return 0 if stop.is_set() else 2
        spinner = Spinner(node)
        try:
            while not stop.wait(0.5) and spinner.is_alive():
                pass
        finally:
            spinner.close()
        return 0 if stop.is_set() else 1
    finally:
        rclpy.try_shutdown()
