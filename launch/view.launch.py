# SPDX-License-Identifier: Apache-2.0
"""Show a running charger in RViz: robot model, frames, contact force and the camera's detection.

    ros2 launch deltacharger view.launch.py namespace:=left geometry_file:=arm.yaml mount_file:=mount.yaml

Start the charger with charger.launch.py or `deltacharger up`. Needs robot_state_publisher, rviz2 and xacro.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from deltacharger_bringup.launch_arguments import refuse_unknown_arguments
from deltacharger_core.bounded_file import given_path
from deltacharger_kinematics.geometry_file import load_geometry
from deltacharger_vision.mount import Mount
from launch import LaunchContext, LaunchDescription

SHARE = Path(__file__).resolve().parents[1]
MODEL = {
    "geometry_file": ("", "same as kinematics_node's parameter"),
    "mount_file": ("", "same as electrode_detector_node's parameter"),
    "base_pose": ("0 0 0 0.5 0.5 0.5 0.5", "pose of charger_base in base_link: x y z, x y z w"),
}
ARGUMENTS = {
    "namespace": ("", "namespace of the charger"),
    **MODEL,
    "frame_prefix": ("", "prefix of the charger's frames, same as its nodes' parameter; base_link has none"),
    "joint_prefix": ("", "prefix of joint_states, same as servo_node's parameter"),
    "rviz": ("true", "false: publish only robot model and tf"),
}


FILES = {"geometry_file": load_geometry, "mount_file": Mount.load}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_wire)])


def _wire(context: LaunchContext) -> list[Any]:
    import xacro
    from launch_ros.parameter_descriptions import ParameterValue

    refuse_unknown_arguments(__file__, context.argv, ARGUMENTS)
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    given |= {name: _read(name, given[name]) for name in FILES if given[name]}
    description = xacro.process_file(
        str(SHARE / "urdf" / "deltacharger.urdf.xacro"),
        mappings={"prefix": given["frame_prefix"], **{name: given[name] for name in ("joint_prefix", *MODEL)}},
    ).toxml()
    namespace = given["namespace"]
    parameters = {name: given[name] for name in ("geometry_file", "frame_prefix", "joint_prefix") if given[name]}
    nodes = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
        ),
        Node(package="deltacharger", executable="passive_joints_node", namespace=namespace, parameters=[parameters]),
    ]
    if given["rviz"].lower() in ("true", "1"):
        config = str(SHARE / "config" / "charger.rviz")
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", config],
                on_exit=Shutdown(reason="RViz was closed"),
            )
        )
    return nodes


def _read(argument: str, text: str) -> str:
    """Check a file and return its absolute path: xacro resolves relative paths from its own file."""
    path = given_path(text).absolute()
    try:
        FILES[argument](path)
    except OSError as error:
        raise ValueError(f"{argument}: '{text}': {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{argument}: {error}") from error
    return str(path)
