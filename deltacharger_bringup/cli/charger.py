# SPDX-License-Identifier: Apache-2.0
"""Common to all commands that start a charger or communicate with one."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli.arguments import DEFAULT_SCENE
from deltacharger_bringup.cli.output import WRONG_INPUT, CommandError, Interrupts, WrongInput, log_line
from deltacharger_core import environment, runtime

if TYPE_CHECKING:
    from rclpy.context import Context

    from deltacharger_scenes.composition import Composition
    from deltacharger_scenes.scene import Scene

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
    scene = load_for_command(given or DEFAULT_SCENE)
    environment.prepare()
    require_domain()
    options.discovery, options.must_run = DISCOVERY, False
    if scene.touches_hardware:
        environment.reach(scene.network)
        options.searched = str(environment.domain())
        return scene
    both = look_around and given is None and not os.environ.get("ROS_DOMAIN_ID")
    if both and _answers_by_default(options.namespace):
        log_line("using the charger in ROS domain 0")
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
        raise WrongInput(problem)


def _answers_by_default(namespace: str) -> bool:
    """Whether a charger answers in the default ROS domain of this process."""
    with ros_context() as context:
        from deltacharger_ros.client import ChargerClient

        with ChargerClient(namespace, context) as client:
            return client.wait_until_it_answers(LOOK)


@contextlib.contextmanager
def ros_context() -> Iterator[Context]:
    """Run an rclpy context without signal handlers; the command handles signals. Every command starts ROS here.

    Raises:
        CommandError: ROS cannot start; exit code 2.
    """
    if problem := environment.problem():
        raise WrongInput(problem)
    try:
        import deltacharger.action  # noqa: F401  (fails here if the interfaces are not built)
        import rclpy
        from rclpy.context import Context
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        cause = str(error).partition("\n")[0]
        raise WrongInput(
            f"ROS 2 or the built interfaces cannot be loaded ({cause}): install the package or source its workspace; "
            f"if another ROS is sourced, {environment.NEW_SHELL}"
        ) from error
    context = Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def refusal(exit_code: int, holder: str = "") -> CommandError:
    """Return the error of a command that would start a second charger beside a running one."""
    where = f"ROS domain {environment.domain()}{holder and f' (process {holder})'}"
    return CommandError(
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
            raise refusal(WRONG_INPUT, taken.process) from taken
        except OSError as error:
            raise CommandError(f"the lock against a second charger cannot be taken: {error}") from error
        yield


def start(scene: Scene, context: Context, namespace: str, held: bool = False) -> Composition:
    """Start a scene's charger in this process; `held` as in `Composition`.

    Raises:
        CommandError: a part of it cannot start; exit code 2 if its configuration is wrong.
    """
    from deltacharger_ros.node_support import StartupError
    from deltacharger_scenes.composition import Composition

    if scene.touches_hardware:
        log_line(f"open to {environment.openness()}; see docs/security.md")
    composition = Composition(scene, context, namespace, held)
    try:
        return composition.start()
    except StartupError as error:
        raise WrongInput(f"{scene.file}: {error}", file=scene.file) from error
    except ImportError as error:
        raise CommandError(f"scene '{scene.name}' needs a library that is not installed: {error}") from error


def wait_for_actions(composition: Composition, client: Any, interrupts: Interrupts) -> bool:
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
            raise CommandError(f"the actions are not available after {START_UP:.0f} s; see the log above")
    return True


def raise_if_failed(composition: Composition) -> None:
    """Raise CommandError if a part of the composition no longer runs."""
    failed = composition.failed()
    if failed:
        raise CommandError(f"no longer running: {', '.join(failed)}; see the log above")


def require_docking(scene: Scene) -> None:
    """Refuse a scene whose charger cannot accept a goal.

    Raises:
        CommandError: it has no docking_node; exit code 2.
    """
    if not scene.docks:
        raise WrongInput(
            f"scene '{scene.name}' starts no docking_node, so it cannot dock and undock; it starts "
            f"{', '.join(scene.nodes)}; choose another --scene"
        )
