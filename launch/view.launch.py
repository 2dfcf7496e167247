# SPDX-License-Identifier: Apache-2.0
"""Show a running charger in RViz: the robot model, its frames, contact force and what the camera found.

    ros2 launch deltacharger view.launch.py namespace:=left geometry_file:=arm.yaml mount_file:=mount.yaml

The charger itself is started by charger.launch.py or `deltacharger up`. Needs robot_state_publisher, rviz2 and xacro.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription

SHARE = Path(__file__).resolve().parents[1]
MODEL = ("geometry_file", "mount_file", "base_pose")


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="of the charger"),
            DeclareLaunchArgument("geometry_file", default_value="", description="as kinematics_node's parameter"),
            DeclareLaunchArgument("mount_file", default_value="", description="as electrode_detector_node's parameter"),
            DeclareLaunchArgument(
                "base_pose",
                default_value="0 0 0 0.5 0.5 0.5 0.5",
                description="charger_base in base_link: x y z, x y z w",
            ),
            DeclareLaunchArgument("rviz", default_value="true", description="false: only the robot model and tf"),
            OpaqueFunction(function=_wire),
        ]
    )


def _wire(context: LaunchContext) -> list[Any]:
    import xacro
    from launch_ros.parameter_descriptions import ParameterValue

    told = {name: LaunchConfiguration(name).perform(context) for name in (*MODEL, "rviz")}
    description = xacro.process_file(
        str(SHARE / "urdf" / "deltacharger.urdf.xacro"), mappings={name: told[name] for name in MODEL}
    ).toxml()
    namespace = LaunchConfiguration("namespace")
    geometry = {"geometry_file": told["geometry_file"]} if told["geometry_file"] else {}
    nodes = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            namespace=namespace,
            parameters=[{"robot_description": ParameterValue(description, value_type=str)}],
        ),
        Node(package="deltacharger", executable="passive_joints_node", namespace=namespace, parameters=[geometry]),
    ]
    if told["rviz"].lower() in ("true", "1"):
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
