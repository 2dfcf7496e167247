# SPDX-License-Identifier: Apache-2.0
"""`deltacharger up`, and what is common to all commands that start a charger or communicate with one.

Only one charger may run in a ROS domain and namespace. A lock refuses a second one of this user on this machine at
once. ROS discovery finds others, also on other machines: once before the first node starts, then until `LOOK` has
passed. Until then docking_node sends no commands and its goals wait.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli import arguments, output
from deltacharger_core import environment, real_time, runtime

if TYPE_CHECKING:
    from rclpy.context import Context

    from deltacharger_bringup.scenes.composition import Composition
    from deltacharger_bringup.scenes.scene import Scene
    from deltacharger_core.ros.client import ChargerClient

LOOK = 3.3  # s until every running charger is found; after a missed announcement the next comes 3 s later
DISCOVERY = 5.0  # s for hardware, where a second charger beside an unnoticed one is worse than the wait
START_UP = 60.0  # s until the actions of a started charger are available


def prepare(options: argparse.Namespace, look_around: bool = False) -> Scene:
    """Load the scene of a command and set its environment, before anything imports rclpy.

    Args:
        options: of the command.
        look_around: if neither a scene nor a domain is given, prefer a charger that answers in ROS domain 0 (the
            domain of chargers on hardware) to the domain of simulated ones. Sets `discovery` (s to search for a
            running charger), `searched` (domains) and `must_run` (start no other charger) of the options.

    Raises:
        CommandError: the scene or ROS_DOMAIN_ID is refused; exit code 2.
    """
    from deltacharger_bringup.cli.scene import load_for_command  # takes hundreds of ms, so --help does not import it

    given = getattr(options, "scene", None)  # some commands have no --scene
    scene = load_for_command(given or arguments.DEFAULT_SCENE)
    environment.prepare()
    require_domain()
    options.discovery, options.must_run = DISCOVERY, False
    if scene.touches_hardware:
        environment.reach(scene.network)
        options.searched = str(environment.domain())
        return scene
    both = look_around and given is None and not os.environ.get("ROS_DOMAIN_ID")
    if both and _answers_by_default(options.namespace):
        output.log_line("using the charger in ROS domain 0")
        options.searched, options.must_run = "0", True
        return dataclasses.replace(scene, goal=None)  # the goal of a simulated scene is wrong for a real target
    environment.isolate()
    options.discovery = LOOK
    options.searched = f"{'0 or ' if both else ''}{environment.domain()}"
    return scene


def require_domain() -> None:
    """Refuse a ROS_DOMAIN_ID that cannot be used.

    Raises:
        CommandError: exit code 2.
    """
    problem = environment.domain_problem()
    if problem:
        raise output.WrongInput(problem)


def _answers_by_default(namespace: str) -> bool:
    """Whether a charger answers in the default ROS domain of this process."""
    with ros_context() as context:
        from deltacharger_core.ros.client import ChargerClient

        with ChargerClient(namespace, context) as client:
            return client.wait_until_it_answers(LOOK)


@contextlib.contextmanager
def ros_context() -> Iterator[Context]:
    """Run an rclpy context without signal handlers; the command handles signals. Every command starts ROS here.

    Raises:
        CommandError: ROS cannot start; exit code 2.
    """
    if problem := environment.problem():
        raise output.WrongInput(problem)
    try:
        import deltacharger.action  # noqa: F401  (fails here if the interfaces are not built)
        import rclpy
        from rclpy.context import Context
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        cause = str(error).partition("\n")[0]
        raise output.WrongInput(
            f"ROS 2 or the built interfaces cannot be loaded ({cause}): install the package or source its workspace; "
            f"if another ROS is sourced, {environment.NEW_SHELL}"
        ) from error
    context = Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def refusal(exit_code: int, holder: str = "") -> output.CommandError:
    """Return the error of a command that would start a second charger beside a running one."""
    where = f"ROS domain {environment.domain()}{holder and f' (process {holder})'}"
    return output.CommandError(
        f"a charger already answers in {where}: stop it, or choose another ROS_DOMAIN_ID or --namespace", exit_code
    )


@contextlib.contextmanager
def only_charger(namespace: str) -> Iterator[None]:
    """Hold a lock: this user runs only one charger of this ROS domain and namespace on this machine.

    Raises:
        CommandError: another process holds it, exit code 2; or the folder of the lock cannot be used.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(runtime.only_one(environment.domain(), namespace))
        except runtime.Taken as taken:
            raise refusal(output.WRONG_INPUT, taken.process) from taken
        except OSError as error:
            raise output.CommandError(f"the lock against a second charger cannot be taken: {error}") from error
        yield


def start(scene: Scene, context: Context, namespace: str, held: bool = False) -> Composition:
    """Start a scene's charger in this process; `held` as in `Composition`.

    Raises:
        CommandError: a part of it cannot start; exit code 2 if its configuration is wrong.
    """
    from deltacharger_bringup.scenes.composition import Composition
    from deltacharger_core.ros.node_support import StartupError

    if scene.touches_hardware:
        output.log_line(f"open to {environment.openness()}; see docs/security.md")
    composition = Composition(scene, context, namespace, held)
    try:
        return composition.start()
    except StartupError as error:
        raise output.WrongInput(f"{scene.file}: {error}", file=scene.file) from error
    except ImportError as error:
        raise output.CommandError(f"scene '{scene.name}' needs a library that is not installed: {error}") from error


def wait_for_actions(composition: Composition, client: Any, interrupts: output.Interrupts) -> bool:
    """Wait until a composition's actions are available; return False after a signal.

    Raises:
        CommandError: a part failed, or they are not available in time.
    """
    waited = 0.0
    while not client.wait_until_ready(0.5, interrupts.event):
        waited += 0.5
        if interrupts.event.is_set():
            return False
        raise_if_failed(composition)
        if waited >= START_UP:
            raise output.CommandError(f"the actions are not available after {START_UP:.0f} s; see the log above")
    return True


def raise_if_failed(composition: Composition) -> None:
    """Raise CommandError if a part of the composition no longer runs."""
    failed = composition.failed()
    if failed:
        raise output.CommandError(f"no longer running: {', '.join(failed)}; see the log above")


def require_docking(scene: Scene) -> None:
    """Refuse a scene whose charger cannot accept a goal.

    Raises:
        CommandError: it has no docking_node; exit code 2.
    """
    if not scene.docks:
        raise output.WrongInput(
            f"scene '{scene.name}' starts no docking_node, so it cannot dock and undock; it starts "
            f"{', '.join(scene.nodes)}; choose another --scene"
        )


def add_up(parser: argparse.ArgumentParser) -> None:
    """Add the options of `up`; options that change the scene are checked with it."""
    add = parser.add_argument
    arguments.scene_option(parser)
    arguments.namespace_option(parser)
    arguments.record_option(parser)
    add("--servo-port", default="", metavar="PORT", help="port of the servos, instead of the scene's")
    add("--board-port", default="", metavar="PORT", help="port of the board, instead of the scene's")
    text = "source of images, instead of the scene's: an OAK-D, image topics of another driver, or none"
    add("--camera", default="", metavar="oak|topics|none", help=text)
    for what, text in (("frame", "frame, for two chargers in one tf tree"), ("joint", "joint, for two in one URDF")):
        add(f"--{what}-prefix", default="", metavar="TEXT", help=f"prefix of each {text}")
    add("--model", default="", metavar="FILE", help="pose model (npz) of misalignment_node")


def up(options: argparse.Namespace) -> output.Result:
    """Run a scene's charger until a signal."""
    scene = _with_options(prepare(options), options)
    if scene.docks and (slow := real_time.take_priority()):
        output.log_line(slow)
    with output.Interrupts() as interrupts, contextlib.ExitStack() as stack:
        if scene.docks:
            stack.enter_context(only_charger(options.namespace))
        context = stack.enter_context(ros_context())
        if scene.docks:
            composition = _alone(scene, context, options, interrupts, stack)
        else:
            composition = stack.enter_context(start(scene, context, options.namespace))
            _print_nodes(composition)
            output.log_line("no docking_node, so no goals are accepted")
            _print_ready(composition, options)
        while not interrupts.event.wait(0.5):
            raise_if_failed(composition)
    return output.Result(code=interrupts.exit_code(output.DONE))


def _alone(
    scene: Scene,
    context: Context,
    options: argparse.Namespace,
    interrupts: output.Interrupts,
    stack: contextlib.ExitStack,
) -> Composition:
    """Start a charger that docks, and release it when no other charger has answered.

    Raises:
        CommandError: another charger answers, a part failed, or a signal arrived before it was ready.
    """
    from deltacharger_bringup.scenes.composition import load_nodes
    from deltacharger_core.ros.client import ChargerClient

    with ChargerClient(options.namespace, context) as client:
        asked = time.monotonic()
        load_nodes(scene)
        _refuse_others(client, 0)
        composition = stack.enter_context(start(scene, context, options.namespace, held=True))
        _print_nodes(composition)
        if not wait_for_actions(composition, client, interrupts):
            raise output.CommandError("interrupted before the charger was ready", interrupts.exit_code(output.DONE))
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
        raise refusal(output.FAILED)


def _print_nodes(composition: Composition) -> None:
    from deltacharger_bringup.scenes.composition import describe

    output.log_line(f"{describe(composition)}; ROS domain {environment.domain()}")


def _print_ready(composition: Composition, options: argparse.Namespace) -> None:
    ready = {"ready": True, "scene": composition.scene.name, "domain": environment.domain()}
    output.answer(options, output.Result("", {**ready, **composition.ports()}, remarks=["ready"]))


def _with_options(scene: Scene, options: argparse.Namespace) -> Scene:
    """Return the scene with the values that the options of `up` replace.

    Raises:
        CommandError: they do not fit the scene; exit code 2.
    """
    from deltacharger_bringup.scenes.scene import Overrides, SceneError, override

    fields = dataclasses.fields(Overrides)
    try:
        return override(scene, Overrides(**{each.name: getattr(options, each.name) or "" for each in fields}))
    except SceneError as error:
        problem = f"{error.file}: --{error.key.replace('_', '-')}: {error.problem}"
        raise output.WrongInput(problem, file=error.file, key=error.key) from error
