# SPDX-License-Identifier: Apache-2.0
"""Checks of ROS in a separate process: python -m deltacharger_bringup.doctor.ros_probe.

A wrong library can end or hang the process that loads it, so this process may do so. Before each step it prints its
results as a line of JSON; the last line shows the failed step. With `--alone` it does not search for chargers.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import time
from typing import Any

from deltacharger_core import streams

ALONE = "--alone"
_LOOK = 3.3  # s; after a missed announcement of a charger the next comes 3 s later
_MATCH = 1.0  # s until the actions of a charger whose topic was found are found too
_STEP = 0.05  # s


def main() -> int:
    """Probe step by step."""
    report: dict[str, Any] = {"error": ""}
    try:
        _probe(report)
        _print(report, "")
    except Exception as error:
        lines = str(error).strip().splitlines() or [type(error).__name__]
        report["error"] = f"{type(error).__name__}: {lines[0]}"
        _print(report, report["step"])
    os._exit(0)  # the middleware's threads must not delay the report


def _print(report: dict[str, Any], step: str) -> None:
    """Print the results before `step`; '' = after the last step."""
    report["step"] = step
    streams.write(json.dumps(report), sys.stdout)


def _probe(report: dict[str, Any]) -> None:
    _print(report, "rclpy")
    import rclpy

    report["rclpy"] = os.path.dirname(os.path.dirname(str(rclpy.__file__)))
    _print(report, "version")
    importlib.import_module("rclpy.experimental.events_executor")
    _print(report, "interfaces")
    report["interfaces"] = _load_interfaces()
    _print(report, "numpy")
    _exchange_arrays()
    report["numpy"] = True
    _print(report, "middleware")
    _look_around(report)


def _load_interfaces() -> int:
    """Load the compiled part of every interface and return their number."""
    count = 0
    for kind in ("msg", "srv", "action"):
        module = importlib.import_module(f"deltacharger.{kind}")
        for name, interface in vars(module).items():
            if isinstance(interface, type) and hasattr(interface, "__import_type_support__"):
                interface.__import_type_support__()
                count += "_" not in name  # Dock_Goal is part of Dock
    return count


def _exchange_arrays() -> None:
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


def _look_around(report: dict[str, Any]) -> None:
    import rclpy
    from rclpy.context import Context
    from rclpy.node import Node
    from rclpy.utilities import get_rmw_implementation_identifier

    report["rmw"] = get_rmw_implementation_identifier()
    context = Context()
    rclpy.init(context=context, args=[])
    node = Node("charger_doctor", context=context, enable_rosout=False, start_parameter_services=False)
    end = time.monotonic() + (0.0 if ALONE in sys.argv else _LOOK)
    chargers: list[str] = []
    while not chargers and time.monotonic() < end:
        time.sleep(_STEP)
        topics = dict(node.get_topic_names_and_types())
        chargers = sorted(
            name.removesuffix("/docking_state") or "/"
            for name, types in topics.items()
            if name.endswith("/docking_state") and types == ["deltacharger/msg/DockingState"]
        )
    report["chargers"] = chargers
    report["silent"] = next(filter(None, (_silence(name, context) for name in chargers)), "")
    names = [name for name, _ in node.get_topic_names_and_types() if name.endswith("/color/image_raw")]
    report["images"] = sum(node.count_publishers(name) for name in names)


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
