# SPDX-License-Identifier: Apache-2.0
"""Quality of service of the package's topics and services."""

from typing import Any

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)

LATEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""servo_state, charger_power, joint_trajectory: reliable, only the newest counts."""

SENSOR = qos_profile_sensor_data
"""tactile_frame and images: late samples are useless."""

STATE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""docking_state for subscribers: changes in order. The publisher keeps only the present state for late subscribers."""

SERVICE = QoSProfile(depth=1000)
"""Services. Fast DDS queues the answers to all clients in each client. With the usual depth of 10, clients that call
continuously push out the answer of a client whose thread is slightly late."""

ACTION: dict[str, Any] = {f"{service}_service_qos_profile": SERVICE for service in ("goal", "result", "cancel")}
"""Keyword arguments of action clients and servers: the same depth for their services."""

DEFAULT_DEPTH = 10
"""Depth of the topics with default quality of service."""
