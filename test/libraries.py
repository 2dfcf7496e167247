# SPDX-License-Identifier: Apache-2.0
"""Libraries of nodes, and of simulated_charger, besides messages, rclpy and rclpy's own, such as numpy."""

from __future__ import annotations

_OF: dict[str, tuple[str, ...]] = {
    "tactile_node": ("serial",),
    "mock_tactile_node": ("serial",),
    "servo_node": ("dynamixel_sdk", "serial"),
    "simulated_charger": ("serial",),
    "camera_node": ("depthai",),
    "simulated_camera_node": ("cv2", "serial"),
    "electrode_detector_node": ("cv2", "tf2_ros"),
    "docking_recorder_node": ("lz4", "mcap", "zstandard"),
    "mock_navigator_node": ("nav2_msgs", "tf2_ros"),
    "docking_node": ("tf2_ros",),
    "mission_node": ("nav2_msgs", "tf2_ros"),
}


def of(name: str) -> set[str]:
    """Return all libraries that a node may load."""
    return set(_OF.get(name, ()))
