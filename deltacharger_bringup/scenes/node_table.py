# SPDX-License-Identifier: Apache-2.0
"""The nodes that a scene can start, by executable name."""

import importlib
from dataclasses import dataclass
from typing import Any


def load(path: str) -> Any:
    """Return the object with a dotted path."""
    module, _, name = path.rpartition(".")
    return getattr(importlib.import_module(module), name)


@dataclass(frozen=True)
class NodeSpec:
    """Description of a node.

    Attributes:
        path: of its class, with the module.
        parameters: the classes that declare its parameters, with their modules.
        named: its parameter that lists names, and the class that declares the parameters of each, with its module.
        port: the scene's port for its parameter `port` ("servo", "board" or "" for none).
        stands_in_for: the node whose topics and services it provides, if it is a mock or a simulation.
        sees_target: whether it simulates a camera that sees the target. In a simulated scene it uses the world's
            target; it never runs beside real hardware.
        takes_scene_name: whether its parameter `scene` is the scene's name.
        may_restart: whether it may restart alone beside the others: it moves nothing, carries no current,
            and its end loses no state.
        lacks: what is missing in a scene without it and without a substitute.
    """

    path: str
    parameters: tuple[str, ...] = ()
    named: tuple[str, str] = ("", "")
    port: str = ""
    stands_in_for: str = ""
    sees_target: bool = False
    takes_scene_name: bool = False
    may_restart: bool = False
    lacks: str = ""

    @property
    def module(self) -> str:
        """Module with its class and its main."""
        return self.path.rpartition(".")[0]


_GEOMETRY = "deltacharger_kinematics.parameters.GeometryFileParameters"

_SERVOS = "deltacharger_core.servo_types.ServosFileParameters"
_FRAMES = "deltacharger_core.frames.FrameParameters"
_JOINT_FRAMES = "deltacharger_core.frames.JointFrameParameters"
_TRANSFORMS = "deltacharger_core.frames.TransformParameters"

# In start order: servos may be connected to the board, so tactile_node starts first and ends last.
NODES: dict[str, NodeSpec] = {
    "tactile_node": NodeSpec(
        "deltacharger_driver.board.tactile_node.TactileNode",
        parameters=("deltacharger_driver.parameters.TactileNodeParameters", _FRAMES),
        port="board",
        lacks="no touch, no charging",
    ),
    "mock_tactile_node": NodeSpec(
        "deltacharger_sim.mocks.mock_tactile_node.MockTactileNode",
        parameters=("deltacharger_sim.mocks.parameters.MockTactileNodeParameters", _FRAMES),
        stands_in_for="tactile_node",
    ),
    "servo_node": NodeSpec(
        "deltacharger_driver.servos.servo_node.ServoNode",
        parameters=("deltacharger_driver.parameters.ServoNodeParameters", _JOINT_FRAMES, _SERVOS),
        port="servo",
        lacks="no arm moves",
    ),
    "mock_servo_node": NodeSpec(
        "deltacharger_sim.mocks.mock_servo_node.MockServoNode",
        parameters=("deltacharger_sim.mocks.parameters.MockServoNodeParameters", _JOINT_FRAMES),
        stands_in_for="servo_node",
    ),
    "kinematics_node": NodeSpec(
        "deltacharger_kinematics.kinematics_node.KinematicsNode",
        parameters=("deltacharger_kinematics.parameters.KinematicsNodeParameters", _FRAMES, _GEOMETRY, _SERVOS),
        may_restart=True,
        lacks="no end_effector_pose, no contact_wrench, no kinematics services",
    ),
    "misalignment_node": NodeSpec(
        "deltacharger_tactile.misalignment_node.MisalignmentNode",
        parameters=("deltacharger_tactile.parameters.MisalignmentNodeParameters", _FRAMES),
        may_restart=True,
        lacks="no misalignment is estimated",
    ),
    "camera_node": NodeSpec(
        "deltacharger_vision.cameras.camera_node.CameraNode",
        parameters=(
            "deltacharger_vision.parameters.OakSettings",
            _FRAMES,
        ),
        may_restart=True,
        lacks="no images except from a camera's own driver",
    ),
    "simulated_camera_node": NodeSpec(
        "deltacharger_sim.charger.simulated_camera_node.SimulatedCameraNode",
        parameters=(
            "deltacharger_sim.charger.simulation.SimulatedCameraNodeParameters",
            _FRAMES,
        ),
        stands_in_for="camera_node",
        sees_target=True,
        may_restart=True,
    ),
    "electrode_detector_node": NodeSpec(
        "deltacharger_vision.detector.electrode_detector_node.ElectrodeDetectorNode",
        parameters=(
            "deltacharger_vision.parameters.DetectorNodeParameters",
            "deltacharger_vision.terminal.Terminal",
            _TRANSFORMS,
        ),
        may_restart=True,
        lacks="docking needs coordinates",
    ),
    "mock_detector_node": NodeSpec(
        "deltacharger_sim.mocks.mock_detector_node.MockDetectorNode",
        parameters=("deltacharger_sim.mocks.parameters.MockDetectorNodeParameters", _FRAMES),
        stands_in_for="electrode_detector_node",
        may_restart=True,
    ),
    "docking_recorder_node": NodeSpec(
        "deltacharger_bringup.records.recording.docking_recorder_node.DockingRecorderNode",
        parameters=("deltacharger_bringup.records.recording.folder.DockingRecorderNodeParameters",),
        takes_scene_name=True,
        may_restart=True,
        lacks="dockings leave no record, unless --record asks for them",
    ),
    "mock_navigator_node": NodeSpec(
        "deltacharger_sim.mocks.mock_navigator_node.MockNavigatorNode",
        parameters=("deltacharger_sim.mocks.parameters.MockNavigatorNodeParameters",),
    ),
    "docking_node": NodeSpec(
        "deltacharger_docking.ros.docking_node.DockingNode",
        parameters=(
            "deltacharger_docking.parameters.DockingParameters",
            "deltacharger_docking.parameters.DockingNodeParameters",
            "deltacharger_docking.parameters.ProfileNames",
            _TRANSFORMS,
            _GEOMETRY,
            _SERVOS,
        ),
        named=("target_profiles", "deltacharger_docking.parameters.TargetProfile"),
        lacks="no actions dock and undock",
    ),
    "mission_node": NodeSpec(
        "deltacharger_docking.mission.ros.mission_node.MissionNode",
        parameters=(
            "deltacharger_docking.mission.parameters.MissionParameters",
            _TRANSFORMS,
        ),
        lacks="no action charge_robot",
    ),
}
"""In start order; closing is the reverse, so commanding nodes close first: mission_node, docking_node."""
