# SPDX-License-Identifier: Apache-2.0
"""The quality of service of the package's topics, as the interface contract states it."""

from __future__ import annotations

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

DEFAULT_DEPTH = 10
"""Depth of the topics with default quality of service."""
