"""Start a scene's nodes as separate processes, and its simulated hardware as another where the scene has one.

    ros2 launch deltacharger charger.launch.py scene:=simulated namespace:=left record:=records log_level:=info

This file only wires: what runs, and with which parameters, stands in the scene.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events.process import ProcessIO
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

from deltacharger_bringup.scene import Scene, load_scene
from deltacharger_bringup.scene_recorder import with_recorder
from launch import LaunchContext, LaunchDescription

PACKAGE = "deltacharger"


def generate_launch_description() -> LaunchDescription:
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value="simulated", description="name of a scene, or a YAML file"),
            DeclareLaunchArgument("namespace", default_value="", description="of the charger"),
            DeclareLaunchArgument("record", default_value="", description="folder for a record of each docking"),
            DeclareLaunchArgument("log_level", default_value="info", description="debug, info, warn, error or fatal"),
            OpaqueFunction(function=_wire),
        ]
    )


def _wire(context: LaunchContext) -> list[Any]:
    scene = load_scene(LaunchConfiguration("scene").perform(context))
    scene = with_recorder(scene, LaunchConfiguration("record").perform(context))
    return _nodes(scene, {}) if scene.simulation is None else _simulated(scene)


def _nodes(scene: Scene, ports: dict[str, str]) -> list[Node]:
    """Return the scene's nodes; a charger of which one part has ended is stopped as a whole."""
    return [
        Node(
            package=PACKAGE,
            executable=name,
            namespace=LaunchConfiguration("namespace"),
            parameters=[scene.node_parameters(name, ports)],
            arguments=["--ros-args", "--log-level", LaunchConfiguration("log_level")],
            output="screen",
            on_exit=Shutdown(reason=f"{name} has ended"),
        )
        for name in scene.start_order()
    ]


def _simulated(scene: Scene) -> list[Any]:
    """Return the simulated hardware, and the nodes once its ports are there."""
    folder = Path(tempfile.mkdtemp(prefix="deltacharger-"))
    hardware = ExecuteProcess(
        cmd=[
            ExecutableInPackage(package=PACKAGE, executable="deltacharger"),
            *("simulate", "--scene", scene.file, "--directory", str(folder)),
        ],
        name="simulated_charger",
        output="screen",
        on_exit=Shutdown(reason="the simulated hardware has ended"),
    )
    nodes = _nodes(scene, {"servo": str(folder / "servo"), "board": str(folder / "board")})

    def when_ready(event: ProcessIO) -> list[Node] | None:
        if b"ready" not in event.text:
            return None
        started, nodes[:] = list(nodes), []
        return started

    return [
        RegisterEventHandler(OnProcessIO(target_action=hardware, on_stdout=when_ready)),
        RegisterEventHandler(
            OnProcessExit(
                target_action=hardware, on_exit=lambda event, context: shutil.rmtree(folder, ignore_errors=True)
            )
        ),
        hardware,
    ]
