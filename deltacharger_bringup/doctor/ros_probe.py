# SPDX-License-Identifier: Apache-2.0
"""Checks of ROS in a separate process: python -m deltacharger_bringup.doctor.ros_probe.

A wrong library can end or hang the process that loads it, so this process may do so. It prints lines of JSON: the step
that begins, and its findings. With `--alone` it does not search for chargers.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from deltacharger_bringup.doctor.findings import Finding, hint, ok, wrong
from deltacharger_core import environment, streams

ALONE = "--alone"
ADVICE = {
    "rclpy": "in a venv: pip install 'ros-rclpy[fastrtps]'; on a ROS installation: source its setup.bash",
    "ros version": f"use {environment.RUNS_ON}",
    "interfaces": "build them: pip install ., or colcon build and source install/setup.bash",
    "numpy and ROS": "build the interfaces again with the numpy that is installed now: "
    "pip install --no-build-isolation .",
    "ros middleware": "unset RMW_IMPLEMENTATION or install that middleware; check ROS_DOMAIN_ID and the network",
}
"""What to do about each step."""
_LOOK = 3.3  # s; after a missed announcement of a charger the next comes 3 s later
_MATCH = 1.0  # s until the actions of a charger whose topic was found are found too
_STEP = 0.05  # s


def main() -> int:
    """Probe step by step."""
    steps = (_rclpy, _version, _interfaces, _exchange_arrays, _look_around)
    step = ""
    try:
        for step, check in zip(ADVICE, steps, strict=True):
            _print(begins=step)
            for finding in check():
                _print(**asdict(finding))
    except Exception as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        cause = cause_of(step, lines[0])
        _print(**asdict(wrong(cause, f"{type(error).__name__}: {lines[0]}", ADVICE[cause])))
    _print(begins="")
    os._exit(0)  # the middleware's threads must not delay the report


def _print(**values: Any) -> None:
    streams.write(json.dumps(values), sys.stdout)


def cause_of(step: str, problem: str) -> str:
    """Return the step that caused a problem; an earlier step may have reported it."""
    for cause, word in (("numpy and ROS", "numpy"), ("ros middleware", "rmw")):
        if word in problem.lower():
            return cause
    return step


def _rclpy() -> Iterator[Finding]:
    import rclpy

    yield ok("rclpy", f"loaded from {os.path.dirname(os.path.dirname(str(rclpy.__file__)))}")


def _version() -> Iterator[Finding]:
    importlib.import_module("rclpy.experimental.events_executor")
    yield from ()


def _interfaces() -> Iterator[Finding]:
    """Load the compiled part of every interface."""
    count = 0
    for kind in ("msg", "srv", "action"):
        module = importlib.import_module(f"deltacharger.{kind}")
        for name, interface in vars(module).items():
            if isinstance(interface, type) and hasattr(interface, "__import_type_support__"):
                interface.__import_type_support__()
                count += "_" not in name  # Dock_Goal is part of Dock
    yield ok("interfaces", f"{count} messages, services and actions are built and loaded")


def _exchange_arrays() -> Iterator[Finding]:
    """Pass numpy arrays through the compiled interfaces; this fails with another ABI of numpy."""
    import numpy as np
    from deltacharger.msg import ServoState, TactileFrame
    from geometry_msgs.msg import PoseWithCovariance
    from rclpy.serialization import deserialize_message, serialize_message

    sent = PoseWithCovariance(covariance=np.arange(36.0))
    received: Any = deserialize_message(serialize_message(sent), PoseWithCovariance)
    if not np.array_equal(received.covariance, sent.covariance):
        raise RuntimeError("an array was changed by serialisation")
    deserialize_message(serialize_message(TactileFrame(left=[1.0] * 100)), TactileFrame)
    deserialize_message(serialize_message(ServoState(position=[1.0] * 3)), ServoState)
    yield ok("numpy and ROS", "arrays are compatible")


def _look_around() -> Iterator[Finding]:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.utilities import get_rmw_implementation_identifier

    context = Context()
    rclpy.init(context=context, args=[])
    node = Node("charger_doctor", context=context, enable_rosout=False, start_parameter_services=False)
    yield ok("ros middleware", f"{get_rmw_implementation_identifier()} runs")
    if ALONE in sys.argv:
        return
    end = time.monotonic() + _LOOK
    chargers: list[str] = []
    while not chargers and time.monotonic() < end:
        time.sleep(_STEP)
        topics = dict(node.get_topic_names_and_types())
        chargers = sorted(
            name.removesuffix("/docking_state") or "/"
            for name, types in topics.items()
            if name.endswith("/docking_state") and types == ["deltacharger/msg/DockingState"]
        )
    yield running(chargers, next(filter(None, (_silence(name, context) for name in chargers)), ""))
    names = [name for name, _ in node.get_topic_names_and_types() if name.endswith("/color/image_raw")]
    _print(images=sum(node.count_publishers(name) for name in names))


def running(chargers: list[str], silent: str) -> Finding:
    """Return the finding about chargers by their namespaces, one of which may not answer: why, and what to do."""
    domain = environment.domain()
    if silent:
        what, _, remedy = silent.partition(": ")
        return wrong("charger", what, remedy)
    if chargers:
        text = f"a charger runs in ROS domain {domain}, namespace {', '.join(chargers)}"
        return hint("charger", text, "stop it before you start another one there; it has opened the ports of its scene")
    return ok("charger", f"none runs in ROS domain {domain}")


def _silence(namespace: str, context: Any) -> str:
    """Return why nothing is heard of a charger's actions; '' if they answer, or there are none."""
    from deltacharger_ros.client import ChargerClient, ClientError

    try:
        ChargerClient(namespace, context).wait_until_it_answers(_MATCH)
    except ClientError as error:
        return str(error)
    return ""


if __name__ == "__main__":
    raise SystemExit(main())
