# SPDX-License-Identifier: Apache-2.0
"""Main function of every node; it always ends safely."""

import sys
import threading
from collections.abc import Callable, Sequence

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import try_shutdown

from deltacharger_core import environment, signals, streams
from deltacharger_core.real_time import exit_within, take_priority
from deltacharger_core.ros import executor, log

_LEAVING = 5.0  # s for a node to leave the network: Jazzy's Fast DDS may deadlock


class StartupError(RuntimeError):
    """A node cannot start as configured; the message states what to change. The process ends with code 2."""


def ros_problem(error: Exception) -> str:
    """Return rclpy's error as one line; '' for any other error."""
    kind = type(error)
    if not kind.__module__.startswith(("rclpy", "_rclpy")):
        return ""
    lines = str(error).strip().splitlines() or [kind.__name__]
    problem = f"unknown ROS arguments {lines[0]}" if kind.__name__ == "UnknownROSArgsError" else lines[0]
    return f"ROS refuses: {problem}; check names, --ros-args, ROS_DOMAIN_ID and ROS_LOG_DIR"


def run(factory: Callable[[], Node], args: Sequence[str] | None = None, has_deadlines: bool = False) -> int:
    """Run one node until SIGINT, SIGTERM or SIGHUP, then close it; the main function of every executable.

    Later signals are ignored. The end of the starting process counts as SIGTERM if that process asked for it
    (deltacharger_core.signals).

    Args:
        factory: builds the node (its class).
        args: command line; None = sys.argv.
        has_deadlines: a charge ends if the node is late, so it asks for real-time priority.

    Returns:
        Exit code: 0 after a signal, 2 if the node cannot start as configured, 1 if it ended by itself.
    """
    streams.secure()
    stop = signals.listen()
    try:
        return 0 if stop.is_set() else _run(factory, args, stop, has_deadlines)
    finally:
        signals.ignore()


def _run(factory: Callable[[], Node], args: Sequence[str] | None, stop: threading.Event, has_deadlines: bool) -> int:
    slow = take_priority() if has_deadlines else ""
    try:
        problem = environment.domain_problem()
        if problem:
            raise StartupError(problem)
        environment.announce()
        rclpy.init(args=None if args is None else list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy raises its own types for arguments, log folder and domain
        streams.write(streams.shortened(f"cannot start: {ros_problem(error) or error}"), sys.stderr)
        return 2
    try:
        try:
            node = factory()
        except Exception as error:
            problem = str(error) if isinstance(error, StartupError | OSError) else ros_problem(error)
            if not problem:
                raise
            streams.write(streams.shortened(problem), sys.stderr)
            return 0 if stop.is_set() else 2
        if slow:
            log.Log(node).info(slow)
        spinner = executor.Spinner(node)
        try:
            while not stop.wait(0.5) and spinner.is_alive():
                pass
        finally:
            try:
                spinner.stop()
            finally:
                exit_within(_LEAVING, 0 if stop.is_set() else 1)  # the hardware is safe by now
                node.destroy_node()
        return 0 if stop.is_set() else 1
    finally:
        # Kilted's rclpy.try_shutdown also uninstalls handlers, even none. That restores the default for an instant, and
        # a second signal would kill. This function uninstalls none, in Jazzy and Kilted.
        try_shutdown()
