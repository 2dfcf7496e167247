# SPDX-License-Identifier: Apache-2.0
"""A charger in a separate process, for commands that move its arm."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from deltacharger.msg import ServoState
from rclpy.context import Context
from rclpy.node import Node

from deltacharger_ros import qos
from deltacharger_ros.node_support import Spinner

from ..chargers import Process, new_namespace, wait_until


class Charger:
    """The servo_state of a running charger."""

    def __init__(self, namespace: str, node: Node) -> None:
        self.namespace = namespace
        self.node = node
        self.state: Any = None
        node.create_subscription(ServoState, f"/{namespace}/servo_state", self._on_state, qos.LATEST)

    def _on_state(self, message: ServoState) -> None:
        self.state = message

    def torque(self) -> bool:
        return self.state is not None and any(self.state.torque_enabled)


@contextmanager
def running(scene: Path) -> Iterator[Charger]:
    """Run `deltacharger up` until the end of the block; it must end with 0."""
    namespace, context = new_namespace(), Context()
    rclpy.init(context=context, args=[])
    command = (sys.executable, "-m", "deltacharger_bringup.cli", "up", "--scene", str(scene))
    process = Process(*command, "--namespace", namespace)
    spinner = Spinner(Node("listener", context=context, use_global_arguments=False))
    try:
        charger = Charger(namespace, spinner.node)
        process.wait_for_line("ready", process.err)
        wait_until(lambda: charger.state is not None, "servo_state")
        yield charger
    finally:
        spinner.close()
        rclpy.try_shutdown(context=context)
        assert process.end(signal.SIGTERM) == 0
