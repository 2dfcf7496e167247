# SPDX-License-Identifier: Apache-2.0
"""`deltacharger up`: run a scene's charger until a signal.

Only one charger may run in a ROS domain and namespace. A lock refuses a second one of this user on this machine at
once. ROS discovery finds others, also on other machines: once before the first node starts, then until `LOOK` has
passed. Until then docking_node sends no commands and its goals wait.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import time
from typing import TYPE_CHECKING

from deltacharger_bringup.cli.arguments import namespace_option, record_option, scene_option
from deltacharger_bringup.cli.charger import (
    LOOK,
    only_charger,
    prepare,
    raise_if_failed,
    refusal,
    ros_context,
    start,
    wait_for_actions,
)
from deltacharger_bringup.cli.output import DONE, FAILED, CommandError, Interrupts, Result, WrongInput, answer, log_line
from deltacharger_core import environment, real_time

if TYPE_CHECKING:
    from rclpy.context import Context

    from deltacharger_ros.client import ChargerClient
    from deltacharger_scenes.composition import Composition
    from deltacharger_scenes.scene import Scene


def add_up(parser: argparse.ArgumentParser) -> None:
    """Add the options of `up`; options that change the scene are checked with it."""
    add = parser.add_argument
    scene_option(parser)
    namespace_option(parser)
    record_option(parser)
    add("--recording", metavar="FILE", help="recording that the scene plays (without --scene: scene replay plays it)")
    add("--servo-port", default="", metavar="PORT", help="port of the servos, instead of the scene's")
    add("--board-port", default="", metavar="PORT", help="port of the board, instead of the scene's")
    text = "source of images, instead of the scene's: an OAK-D, image topics of another driver, or none"
    add("--camera", default="", metavar="oak|topics|none", help=text)
    for what, text in (("frame", "frame, for two chargers in one tf tree"), ("joint", "joint, for two in one URDF")):
        add(f"--{what}-prefix", default="", metavar="TEXT", help=f"prefix of each {text}")
    add("--model", default="", metavar="FILE", help="pose model (npz) of misalignment_node")


def up(options: argparse.Namespace) -> Result:
    """Run a scene's charger until a signal."""
    if options.recording and options.scene is None:
        options.scene = "replay"
    scene = _with_options(prepare(options), options)
    if scene.docks and (slow := real_time.take_priority()):
        log_line(slow)
    with Interrupts() as interrupts, contextlib.ExitStack() as stack:
        if scene.docks:
            stack.enter_context(only_charger(options.namespace))
        context = stack.enter_context(ros_context())
        if scene.docks:
            composition = _alone(scene, context, options, interrupts, stack)
        else:
            composition = stack.enter_context(start(scene, context, options.namespace))
            _print_nodes(composition)
            log_line(_interfaces(composition))
            _print_ready(composition, options)
        while not interrupts.event.wait(0.5):
            raise_if_failed(composition)
    return Result(code=interrupts.exit_code(DONE))


def _alone(
    scene: Scene, context: Context, options: argparse.Namespace, interrupts: Interrupts, stack: contextlib.ExitStack
) -> Composition:
    """Start a charger that docks, and release it when no other charger has answered.

    Raises:
        CommandError: another charger answers, a part failed, or a signal arrived before it was ready.
    """
    from deltacharger_ros.client import ChargerClient
    from deltacharger_scenes.composition import load_nodes

    with ChargerClient(options.namespace, context) as client:
        asked = time.monotonic()
        load_nodes(scene)
        _refuse_others(client, 0)
        composition = stack.enter_context(start(scene, context, options.namespace, held=True))
        _print_nodes(composition)
        if not wait_for_actions(composition, client, interrupts):
            raise CommandError("interrupted before the charger was ready", interrupts.exit_code(DONE))
        _print_ready(composition, options)
        while not interrupts.event.wait(0.1):
            raise_if_failed(composition)
            _refuse_others(client, 1)
            if time.monotonic() >= asked + LOOK:
                composition.release()
                break
    return composition


def _refuse_others(client: ChargerClient, own: int) -> None:
    if client.node.count_publishers("dock/_action/feedback") > own:  # one of each action server
        raise refusal(FAILED)


def _print_nodes(composition: Composition) -> None:
    from deltacharger_scenes.composition import describe

    log_line(f"{describe(composition)}; ROS domain {environment.domain()}")


def _print_ready(composition: Composition, options: argparse.Namespace) -> None:
    ready = {"ready": True, "scene": composition.scene.name, "domain": environment.domain()}
    answer(options, Result("", {**ready, **composition.ports()}, remarks=["ready"]))


def _with_options(scene: Scene, options: argparse.Namespace) -> Scene:
    """Return the scene with the values that the options of `up` replace.

    Raises:
        CommandError: they do not fit the scene; exit code 2.
    """
    from deltacharger_scenes.overrides import Overrides, override
    from deltacharger_scenes.scene import SceneError

    fields = dataclasses.fields(Overrides)
    try:
        return override(scene, Overrides(**{each.name: getattr(options, each.name) or "" for each in fields}))
    except SceneError as error:
        problem = f"{error.file}: --{error.key.replace('_', '-')}: {error.problem}"
        raise WrongInput(problem, file=error.file, key=error.key) from error


def _interfaces(composition: Composition) -> str:
    """Return a line with the nodes of a scene that cannot dock."""
    names = ", ".join(running.node.get_name() for running in composition.nodes)
    return f"no docking_node, so no goals are accepted; this scene starts {names} (docs/topics.md)"
