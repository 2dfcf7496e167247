# SPDX-License-Identifier: Apache-2.0
"""Show a running charger in RViz: robot model, frames, contact force and the camera's detection.

    ros2 launch deltacharger view.launch.py charger_namespace:=left charger_geometry_file:=arm.yaml

Start the charger with charger.launch.py or `deltacharger up`. Needs robot_state_publisher, rviz2 and xacro.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch_ros.actions import Node

from deltacharger_bringup.launch_arguments import MODEL, VIEW, given, in_launch, refuse_unknown_arguments
from deltacharger_core.files import given_path
from deltacharger_kinematics.geometry import load_geometry
from deltacharger_vision.mount import Mount
from launch import LaunchContext, LaunchDescription

SHARE = Path(__file__).resolve().parents[1]
FILES = {"geometry_file": load_geometry, "mount_file": Mount.load}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(in_launch(name), default_value=default, description=text)
        for name, (default, text) in VIEW.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_wire)])


def _wire(context: LaunchContext) -> list[Any]:
    import xacro
    from launch_ros.parameter_descriptions import ParameterValue

    refuse_unknown_arguments(__file__, context.argv, VIEW)
    args = given(VIEW, context.launch_configurations)
    args |= {name: _read(name, args[name]) for name in FILES if args[name]}
    description = xacro.process_file(
        str(SHARE / "urdf" / "deltacharger.urdf.xacro"),
        mappings={"prefix": args["frame_prefix"], **{name: args[name] for name in ("joint_prefix", *MODEL)}},
    ).toxml()
    namespace = args["namespace"]
    parameters = {name: args[name] for name in ("geometry_file", "frame_prefix", "joint_prefix") if args[name]}
    nodes = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
        ),
        Node(package="deltacharger", executable="passive_joints_node", namespace=namespace, parameters=[parameters]),
    ]
    if args["rviz"].lower() in ("true", "1"):
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
        raise ValueError(f"{in_launch(argument)}: '{text}': {error.strerror or error}") from error
    except ValueError as error:
        raise ValueError(f"{in_launch(argument)}: {error}") from error
    return str(path)
