# SPDX-License-Identifier: Apache-2.0
"""The nodes that own the hardware's ports, and whether these are a simulated charger's. Part of docking_node."""

from __future__ import annotations

import threading
import time
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from deltacharger_core.runtime import is_simulated
from deltacharger_ros.action_caller import result_of

_OWNERS = ("servo_node", "tactile_node")  # of the hardware's ports
_PORT = "port"  # fixed once they run
_TIMEOUT = 2.0  # s for both to be there and to answer: nodes that start together find each other so late
_POLL = 0.02  # s


class PortOwners:
    """Asks the nodes that own the hardware's ports which ones they have opened.

    A node that does not answer or has no port, such as a mock, and a port of another computer prove nothing.
    """

    def __init__(self, node: Node) -> None:
        self._clients: list[Any] = [node.create_client(GetParameters, f"{name}/get_parameters") for name in _OWNERS]

    def is_simulated(self) -> bool:
        """Return whether both ports are known to be a simulated charger's; waits for the nodes, 2 s at most."""
        end = time.monotonic() + _TIMEOUT
        while not all(client.service_is_ready() for client in self._clients):
            if time.monotonic() > end:
                return False
            time.sleep(_POLL)
        return all(_port_is_simulated(client, end) for client in self._clients)


def _port_is_simulated(client: Any, end: float) -> bool:
    answered = threading.Event()
    future = client.call_async(GetParameters.Request(names=[_PORT]))
    future.add_done_callback(lambda done: answered.set())
    if not answered.wait(max(end - time.monotonic(), 0.0)):
        client.remove_pending_request(future)
        return False
    answer = result_of(future)
    values = [] if answer is None else answer.values
    return [value.type for value in values] == [ParameterType.PARAMETER_STRING] and is_simulated(values[0].string_value)
