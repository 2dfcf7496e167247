# SPDX-License-Identifier: Apache-2.0
"""Start a scene's nodes as separate processes, and its simulated hardware as another where the scene has one.

    ros2 launch deltacharger charger.launch.py scene:=bench servo_port:=/dev/ttyUSB1 namespace:=left record:=true

This file only wires: what runs, and with which parameters, stands in the scene; what the other arguments change of it
is decided in deltacharger_scenes.overrides. A wrong argument ends the launch before anything starts.

A node that moves nothing and carries no current is started again when it dies (`may_restart` in node_table). The end of
any other ends the charger as a whole, docking_node among them, which leaves the arm safe; ros2 launch then ends with 1.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import fields
from pathlib import Path
from typing import Any

from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit, OnProcessIO
from launch.events.process import ProcessExited, ProcessIO
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage

from deltacharger_bringup.cli.types import namespace
from deltacharger_bringup.launch_arguments import refuse_slips
from deltacharger_core import environment
from deltacharger_core.parameters import declared
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.overrides import Overrides, override
from deltacharger_scenes.scene import Scene, load_scene
from launch import LaunchContext, LaunchDescription

PACKAGE = "deltacharger"
LEVELS = ("debug", "info", "warn", "error", "fatal")
OWN = {
    "scene": ("simulated", "name of a scene, or a YAML file"),
    "namespace": ("", "of the charger"),
    "log_level": ("info", ", ".join(LEVELS)),
}
ARGUMENTS = OWN | {item.name: ("", item.text) for item in declared(Overrides)}
REFUSED = 2  # exit code of a node that cannot start as configured; starting it again would not help
RESPAWN_DELAY = 1.0  # s
# A node that makes its hardware safe on a busy computer needs longer than launch's usual 5 s to end.
PATIENCE = {name: LaunchConfiguration(name, default="15") for name in ("sigterm_timeout", "sigkill_timeout")}


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_wire)])


def _wire(context: LaunchContext) -> list[Any]:
    refuse_slips(__file__, context.argv, ARGUMENTS)
    told = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    if told["log_level"] not in LEVELS:
        raise ValueError(f"log_level is '{told['log_level']}'; give one of {', '.join(LEVELS)}")
    try:
        told["namespace"] = namespace(told["namespace"])
    except argparse.ArgumentTypeError as error:
        raise ValueError(f"namespace: {error}") from error
    scene = override(load_scene(told["scene"]), Overrides(**{item.name: told[item.name] for item in fields(Overrides)}))
    environment.reach(scene.network if scene.touches_hardware else "localhost")
    wired = _nodes if scene.simulation is None else _simulated
    said = [LogInfo(msg=f"open to {environment.openness()}; see docs/security.md")] if scene.touches_hardware else []
    return said + wired(scene, told)


def _nodes(scene: Scene, told: dict[str, str], ports: dict[str, str] | None = None) -> list[Any]:
    return [
        Node(
            package=PACKAGE,
            executable=name,
            namespace=told["namespace"],
            parameters=[scene.node_parameters(name, ports or {})],
            arguments=["--ros-args", "--log-level", told["log_level"], "--enclave", f"/{PACKAGE}/{name}"],
            output="screen",
            respawn=NODES[name].may_restart,
            respawn_delay=RESPAWN_DELAY,
            on_exit=_judge,
            **PATIENCE,
        )
        for name in scene.start_order()
    ]


def _judge(event: ProcessExited, context: LaunchContext) -> list[Any]:
    """End the charger when a part of it has ended, but for those that are started again."""
    name = event.action.node_executable if isinstance(event.action, Node) else "the simulated hardware"
    if context.is_shutdown or (name in NODES and NODES[name].may_restart and event.returncode != REFUSED):
        return []
    why = "cannot start as configured" if event.returncode == REFUSED else f"has ended with {event.returncode}"
    reason = f"{name} {why}; ending the charger"
    # launch ends with 1 where its loop met an error, and with 0 after a Shutdown alone.
    fail = OpaqueFunction(function=lambda context: context.asyncio_loop.call_exception_handler({"message": reason}))
    return [fail, Shutdown(reason=reason)]


def _simulated(scene: Scene, told: dict[str, str]) -> list[Any]:
    """Return the simulated hardware, and the nodes once its ports are there."""
    folder = tempfile.TemporaryDirectory(prefix="deltacharger-", ignore_cleanup_errors=True)
    hardware = ExecuteProcess(
        cmd=[
            ExecutableInPackage(package=PACKAGE, executable="deltacharger"),
            *("simulate", "--scene", scene.file, "--directory", folder.name, "--as-node"),
        ],
        name="simulated_charger",
        output="screen",
        on_exit=_judge,
        **PATIENCE,
    )
    nodes = _nodes(scene, told, {port: str(Path(folder.name) / port) for port in ("servo", "board")})

    def when_ready(event: ProcessIO) -> list[Any] | None:
        if b"ready" not in event.text:
            return None
        started, nodes[:] = list(nodes), []
        return started

    def when_ended(event: ProcessExited, context: LaunchContext) -> None:
        folder.cleanup()

    return [
        RegisterEventHandler(OnProcessIO(target_action=hardware, on_stdout=when_ready)),
        RegisterEventHandler(OnProcessExit(target_action=hardware, on_exit=when_ended)),
        hardware,
    ]
