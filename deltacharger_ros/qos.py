# SPDX-License-Identifier: Apache-2.0
"""The quality of service of the package's topics, as the interface contract states it."""

from __future__ import annotations

from typing import Any

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)

LATEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""servo_state, charger_power, joint_trajectory: only the newest counts, and it arrives."""

SENSOR = qos_profile_sensor_data
"""tactile_frame and images: a late sample is worth nothing."""

STATE = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=10,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""docking_state as a subscriber wants it: changes in order. The publisher keeps one, the present, for late ones."""

SERVICE = QoSProfile(depth=1000)
"""Services. Fast DDS queues the answers to all clients with each of them: with the usual depth of 10, others who call
without end push out the answer of a client whose thread is late by a moment."""

ACTION: dict[str, Any] = {f"{service}_service_qos_profile": SERVICE for service in ("goal", "result", "cancel")}
"""Actions, keywords of their clients and servers: their services alike."""

DEFAULT_DEPTH = 10
"""Depth of the topics with default quality of service."""
