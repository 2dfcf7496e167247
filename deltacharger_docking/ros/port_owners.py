# SPDX-License-Identifier: Apache-2.0
"""Checks that the ports behind docking's topics and services belong to a simulated charger. Part of docking_node."""

from __future__ import annotations

import threading
import time
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from deltacharger_core.runtime import is_simulated
from deltacharger_ros.action_caller import result_of
from deltacharger_ros.qos import SERVICE

_OWNERS = (
    (("servo_state",), ("set_torque",)),
    (("tactile_frame", "charger_power"), ("set_contactor", "probe")),
)
"""For the servos' and the board's port: topics and services of its owner, relative to docking's namespace."""
_PORT = "port"  # fixed once a node runs
_TIMEOUT = 2.0  # s for both owners to appear and answer: discovery takes that long for nodes that start together
_POLL = 0.02  # s

Endpoint = tuple[str, bytes]
"""Full name of a node, and the id of its publisher or server."""


class PortOwners:
    """Asks the nodes behind docking's own topics and services which ports they have opened.

    There is no proof of simulation if a node does not answer or has no port, such as a mock, if two nodes are found
    instead of one, or if a port belongs to another computer.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._proof: tuple[tuple[Endpoint, ...], ...] | None = None

    def is_simulated(self) -> bool:
        """Return whether both ports are known to be a simulated charger's; wait for the nodes, 2 s at most."""
        end = time.monotonic() + _TIMEOUT
        while (owners := self._owners()) is None and time.monotonic() < end:
            time.sleep(_POLL)
        proven = owners is not None and all(_port_is_simulated(self._node, found[0][0], end) for found in owners)
        self._proof = owners if proven else None
        return self.are_the_same()

    def are_the_same(self) -> bool:
        """Return whether docking's topics and services still belong to the nodes that were checked."""
        return self._proof is not None and self._owners() == self._proof

    def _owners(self) -> tuple[tuple[Endpoint, ...], ...] | None:
        """Return the endpoints of each port's owner; None if some are missing, duplicated or of several nodes."""
        found = tuple(self._endpoints(topics, services) for topics, services in _OWNERS)
        return None if any(len({name for name, _ in each}) != 1 or ("", b"") in each for each in found) else found

    def _endpoints(self, topics: tuple[str, ...], services: tuple[str, ...]) -> tuple[Endpoint, ...]:
        resolve_topic, resolve_service = self._node.resolve_topic_name, self._node.resolve_service_name
        places = [(resolve_topic(topic), False) for topic in topics]
        # A server publishes its replies under the name that DDS uses for them.
        places += [(f"rr{resolve_service(service)}Reply", True) for service in services]
        return tuple(self._only_publisher(*place) for place in places)

    def _only_publisher(self, topic: str, no_mangle: bool) -> Endpoint:
        """Return the publisher of a topic; empty values if there is none, several, or one without a name."""
        try:
            found = self._node.get_publishers_info_by_topic(topic, no_mangle=no_mangle)
        except UnicodeDecodeError:  # a forged name, which rclpy cannot decode
            return "", b""
        if len(found) != 1 or not found[0].node_name:
            return "", b""
        owner = found[0]
        return f"{owner.node_namespace.rstrip('/')}/{owner.node_name}", bytes(owner.endpoint_gid)


def _port_is_simulated(node: Node, owner: str, end: float) -> bool:
    """Return whether a node's port (full name) is a simulated charger's; False if two nodes have that name."""
    client: Any = node.create_client(GetParameters, f"{owner}/get_parameters", qos_profile=SERVICE)
    try:
        while not client.service_is_ready():
            if time.monotonic() > end:
                return False
            time.sleep(_POLL)
        if node.count_services(client.srv_name) != 1:
            return False
        value = _parameter(client, end)
        return value is not None and value.type == ParameterType.PARAMETER_STRING and is_simulated(value.string_value)
    finally:
        node.destroy_client(client)


def _parameter(client: Any, end: float) -> Any:
    """Return the value of the port's parameter; None without an answer."""
    answered = threading.Event()
    future = client.call_async(GetParameters.Request(names=[_PORT]))
    future.add_done_callback(lambda done: answered.set())
    if not answered.wait(max(end - time.monotonic(), 0.0)):
        client.remove_pending_request(future)
        return None
    answer = result_of(future)
    return answer.values[0] if answer is not None and len(answer.values) == 1 else None
