# SPDX-License-Identifier: Apache-2.0
"""Start a scene's nodes as separate processes, and its simulated hardware, if any, as another process.

    ros2 launch deltacharger charger.launch.py scene:=bench charger_servo_port:=/dev/ttyUSB1 charger_namespace:=left

The scene lists nodes and parameters; deltacharger_bringup.scenes.scene applies the other arguments to it. A wrong
argument ends the launch before anything starts. deltacharger_bringup.launch_arguments lists the arguments.

Settings of an including launch file (namespace, parameters, remaps, environment) apply to every process, also to nodes
that start only after the simulated hardware has its ports.

A node that moves nothing and carries no current restarts when it dies (`may_restart` in node_table). The end of any
other process ends the complete charger, including docking_node, which leaves the arm safe; ros2 launch then exits with
code 1. If launch itself is killed, its processes detect it and end (deltacharger_core.signals).
"""

from __future__ import annotations

import argparse
import contextlib
import copy
import os
import signal
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    GroupAction,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessExit, OnProcessIO, OnProcessStart, OnShutdown
from launch.events import Shutdown as ShutdownBegins
from launch.events.process import ProcessExited, ProcessIO, ProcessStarted
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.substitutions import ExecutableInPackage
from launch_ros.utilities import prefix_namespace

from deltacharger_bringup.cli.arguments import namespace
from deltacharger_bringup.launch_arguments import (
    CHARGER,
    LEVELS,
    given,
    in_launch,
    is_launched_itself,
    refuse_unknown_arguments,
)
from deltacharger_bringup.scenes.node_table import NODES
from deltacharger_bringup.scenes.scene import Overrides, Scene, SceneError, load_scene, override
from deltacharger_core import environment, signals
from launch import LaunchContext, LaunchDescription

PACKAGE = "deltacharger"
REFUSED = 2  # exit code of a node that cannot start as configured; a restart would not help
RESPAWN_DELAY = 1.0  # s
PATIENCE = ("sigterm_timeout", "sigkill_timeout")  # s before launch sends these signals
USUAL_PATIENCE = "15"  # launch's 5 s are too short for a node that makes its hardware safe on a busy computer


def generate_launch_description() -> LaunchDescription:
    declared = [
        DeclareLaunchArgument(in_launch(name), default_value=default, description=text)
        for name, (default, text) in CHARGER.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=_wire)])


def _wire(context: LaunchContext) -> list[Any]:
    refuse_unknown_arguments(__file__, context.argv, CHARGER)
    args = given(CHARGER, context.launch_configurations)
    if args["log_level"] not in LEVELS:
        raise ValueError(f"{in_launch('log_level')} is '{args['log_level']}'; give one of {', '.join(LEVELS)}")
    args["namespace"] = _namespace(args["namespace"])
    args |= {name: LaunchConfiguration(name, default=USUAL_PATIENCE).perform(context) for name in PATIENCE}
    scene = _override(load_scene(args["scene"]), args)
    variables = dict(context.environment)
    _choose_network(scene, variables)
    variables |= signals.end_with(os.getpid())
    scoped = _scope(context, variables)
    if scene.simulation is None:
        started: list[Any] = _nodes(scene, args)
        wired = scoped(started)
    else:
        started, wired = _simulated(scene, args, _full_namespace(context, args["namespace"]), scoped)
    return [LogInfo(msg=_start_message(scene, variables)), *_forward_sigint(started), *wired]


def _override(scene: Scene, args: dict[str, str]) -> Scene:
    """Return the scene with the values that arguments replace; an error names the argument as launch has it."""
    try:
        return override(scene, Overrides(**{item.name: args[item.name] for item in fields(Overrides)}))
    except SceneError as error:
        raise SceneError(error.file, in_launch(error.key), error.problem) from error


def _namespace(text: str) -> str:
    """Return the charger's namespace: relative to the including launch file's, unless it begins with a slash."""
    try:
        return ("/" if text.startswith("/") else "") + namespace(text)
    except argparse.ArgumentTypeError as error:
        raise ValueError(f"{in_launch('namespace')}: {error}") from error


def _full_namespace(context: LaunchContext, relative: str) -> str:
    """Return the nodes' full namespace, without outer slashes."""
    return (prefix_namespace(context.launch_configurations.get("ros_namespace"), relative) or "").strip("/")


def _choose_network(scene: Scene, variables: dict[str, str]) -> None:
    """Set discovery range and domain unless the user has set them.

    A simulated scene that is launched directly gets the domain of simulated chargers, as with `deltacharger up`, so
    that robots on this computer do not discover it. If included, it keeps the domain of the including launch file.
    """
    if scene.touches_hardware:
        environment.reach(scene.network, variables)
    elif is_launched_itself(__file__):
        environment.isolate(variables)
    else:
        environment.reach("localhost", variables)


def _start_message(scene: Scene, variables: dict[str, str]) -> str:
    domain = environment.domain(variables)
    text = f"scene '{scene.name}' in ROS domain {domain}, open to {environment.openness(variables)}"
    if scene.touches_hardware:
        return f"{text}; see docs/security.md"
    chosen = " ".join(f"{name}={variables[name]}" for name in environment.CHOSEN if name in variables)
    return f"{text}; in other shells: export {chosen}"


def _scope(context: LaunchContext, variables: dict[str, str]) -> Callable[[list[Any]], list[Any]]:
    """Return a function that wraps actions in the present launch configurations and these environment variables.

    Namespace, parameters and remaps of an including launch file are launch configurations, which no longer exist when
    an event handler runs.
    """
    configurations = copy.deepcopy(dict(context.launch_configurations))

    def enter(context: LaunchContext) -> None:
        for now, then in ((context.launch_configurations, configurations), (context.environment, variables)):
            now.clear()
            now.update(then)

    return lambda actions: [GroupAction([OpaqueFunction(function=enter), *actions])]


def _nodes(scene: Scene, args: dict[str, str], ports: dict[str, str] | None = None) -> list[Any]:
    return [
        Node(
            package=PACKAGE,
            executable=name,
            namespace=args["namespace"],
            parameters=[scene.node_parameters(name, ports or {})],
            arguments=["--ros-args", "--log-level", args["log_level"], "--enclave", f"/{PACKAGE}/{name}"],
            output="screen",
            respawn=NODES[name].may_restart,
            respawn_delay=RESPAWN_DELAY,
            on_exit=_on_exit,
            **{name: args[name] for name in PATIENCE},
        )
        for name in scene.start_order()
    ]


def _on_exit(event: ProcessExited, context: LaunchContext) -> list[Any]:
    """End the charger when a process has ended that does not restart."""
    name = event.action.node_executable if isinstance(event.action, Node) else "the simulated hardware"
    if context.is_shutdown or (name in NODES and NODES[name].may_restart and event.returncode != REFUSED):
        return []
    why = "cannot start as configured" if event.returncode == REFUSED else f"ended with code {event.returncode}"
    reason = f"{name} {why}; ending the charger"
    # launch exits with 1 after an error in its loop, but with 0 after only a Shutdown.
    fail = OpaqueFunction(function=lambda context: context.asyncio_loop.call_exception_handler({"message": reason}))
    return [fail, Shutdown(reason=reason)]


def _forward_sigint(started: list[Any]) -> list[Any]:
    """Forward a SIGINT that only launch received: launch assumes that its processes share its terminal."""

    def interrupt(process: Any) -> None:
        pid = (process.process_details or {}).get("pid")
        if pid is not None and process.return_code is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGINT)

    def when_ending(event: ShutdownBegins, context: LaunchContext) -> None:
        if event.due_to_sigint and not context.noninteractive:
            for process in started:
                interrupt(process)

    def when_begun(event: ProcessStarted, context: LaunchContext) -> None:
        if context.is_shutdown and event.action in started:
            interrupt(event.action)

    return [
        RegisterEventHandler(OnShutdown(on_shutdown=when_ending)),
        RegisterEventHandler(OnProcessStart(on_start=when_begun)),
    ]


def _simulated(
    scene: Scene, args: dict[str, str], full_namespace: str, scoped: Callable[[list[Any]], list[Any]]
) -> tuple[list[Any], list[Any]]:
    """Return all processes, and the actions that start the simulated hardware and, once its ports exist, the nodes."""
    folder = tempfile.TemporaryDirectory(prefix="deltacharger-", ignore_cleanup_errors=True)
    hardware = ExecuteProcess(
        cmd=[
            ExecutableInPackage(package=PACKAGE, executable="deltacharger"),
            *("simulate", "--scene", scene.file, "--directory", folder.name, "--namespace", full_namespace),
            "--as-node",
        ],
        name="simulated_charger",
        output="screen",
        on_exit=_on_exit,
        **{name: args[name] for name in PATIENCE},
    )
    nodes = _nodes(scene, args, {port: str(Path(folder.name) / port) for port in ("servo", "board")})
    waiting = list(nodes)

    def when_ready(event: ProcessIO) -> list[Any] | None:
        if b"ready" not in event.text.split():
            return None
        begun, waiting[:] = scoped(list(waiting)), []
        return begun

    def when_ended(event: ProcessExited, context: LaunchContext) -> None:
        folder.cleanup()

    return [hardware, *nodes], [
        RegisterEventHandler(OnProcessIO(target_action=hardware, on_stdout=when_ready)),
        RegisterEventHandler(OnProcessExit(target_action=hardware, on_exit=when_ended)),
        *scoped([hardware]),
    ]
