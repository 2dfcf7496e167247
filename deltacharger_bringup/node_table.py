"""The nodes that a scene can start, by executable name."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NodeSpec:
    """Where a node lives.

    Attributes:
        module: Python module.
        class_name: node class in it.
        port: which port of the scene is its parameter `port` ("servo", "board" or "" for none).
        stands_in_for: the node whose topics and services it provides, where it is a mock or a simulation.
        sees_target: whether it simulates what sees the target, so that a simulated world's target is its own, and
            never stands beside real hardware.
        told_scene: whether the scene's name is its parameter `scene`.
    """

    module: str
    class_name: str
    port: str = ""
    stands_in_for: str = ""
    sees_target: bool = False
    told_scene: bool = False


NODES: dict[str, NodeSpec] = {
    "servo_node": NodeSpec("deltacharger_driver.servo_node", "ServoNode", port="servo"),
    "mock_servo_node": NodeSpec("deltacharger_bringup.mock_servo_node", "MockServoNode", stands_in_for="servo_node"),
    "tactile_node": NodeSpec("deltacharger_driver.tactile_node", "TactileNode", port="board"),
    "mock_tactile_node": NodeSpec(
        "deltacharger_bringup.mock_tactile_node", "MockTactileNode", stands_in_for="tactile_node"
    ),
    "kinematics_node": NodeSpec("deltacharger_kinematics.kinematics_node", "KinematicsNode"),
    "misalignment_node": NodeSpec("deltacharger_tactile.misalignment_node", "MisalignmentNode"),
    "camera_node": NodeSpec("deltacharger_vision.camera_node", "CameraNode"),
    "simulated_camera_node": NodeSpec(
        "deltacharger_bringup.simulated_camera_node",
        "SimulatedCameraNode",
        stands_in_for="camera_node",
        sees_target=True,
    ),
    "electrode_detector_node": NodeSpec("deltacharger_vision.electrode_detector_node", "ElectrodeDetectorNode"),
    "mock_detector_node": NodeSpec(
        "deltacharger_bringup.mock_detector_node", "MockDetectorNode", stands_in_for="electrode_detector_node"
    ),
    "docking_recorder_node": NodeSpec(
        "deltacharger_bringup.docking_recorder_node", "DockingRecorderNode", told_scene=True
    ),
    "mock_navigator_node": NodeSpec("deltacharger_bringup.mock_navigator_node", "MockNavigatorNode"),
    "docking_node": NodeSpec("deltacharger_docking.docking_node", "DockingNode"),
    "mission_node": NodeSpec("deltacharger_docking.mission_node", "MissionNode"),
}
"""In the order of starting; closing goes the other way, so who commands closes first: mission_node, docking_node."""
