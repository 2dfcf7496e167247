# SPDX-License-Identifier: Apache-2.0
"""What all commands that start a charger or speak to one share."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli.output import WRONG_INPUT, CommandError, Interrupts, say
from deltacharger_bringup.cli.parser import DEFAULT_SCENE
from deltacharger_core import environment, runtime

if TYPE_CHECKING:
    from rclpy.context import Context

    from deltacharger_scenes.composition import Composition
    from deltacharger_scenes.scene import Scene

DISCOVERY = 5.0  # s; a charger that runs is found in 0.25…3 s, and starting a second one beside it would be worse
LOOK = 3.3  # s after which no charger that runs is unknown: who misses its first announcement waits 3 s for the next
START_UP = 60.0  # s until the actions of a scene's own charger answer


def prepare(options: argparse.Namespace, look_around: bool = False) -> Scene:
    """Load the scene of a command and set the environment that it needs, before anything imports rclpy.

    Args:
        options: of the command.
        look_around: where neither a scene nor a domain was given, use a charger that answers in the default domain, as
            one on hardware does, rather than the domain of simulated ones. Sets `discovery` (s to look for a running
            charger) and `must_run` (start no other one) of the options.

    Raises:
        CommandError: the scene or ROS_DOMAIN_ID is refused; exit code 2.
    """
    from deltacharger_bringup.cli.scene import load_for_command  # hundreds of ms, for which --help does not wait

    given = getattr(options, "scene", None)  # some commands take the scene as it comes
    scene = load_for_command(given or DEFAULT_SCENE)
    environment.prepare()
    require_domain()
    options.discovery, options.must_run = DISCOVERY, False
    if scene.touches_hardware:
        environment.reach(scene.network)
        return scene
    if look_around and given is None and not os.environ.get("ROS_DOMAIN_ID"):
        options.discovery = LOOK
        if _answers_by_default(options.namespace):
            say("using the charger that answers in ROS domain 0")
            options.discovery = DISCOVERY
            options.must_run = True
            return dataclasses.replace(scene, goal=None)  # a simulated target's place is no real one's
    environment.isolate()
    return scene


def require_domain() -> None:
    """Refuse a ROS_DOMAIN_ID that cannot be used.

    Raises:
        CommandError: exit code 2.
    """
    problem = environment.domain_problem()
    if problem:
        raise CommandError(problem, WRONG_INPUT)


def _answers_by_default(namespace: str) -> bool:
    """Whether a charger answers in the ROS domain that this process would join by itself."""
    with ros_context() as context:
        from deltacharger_ros.client import ChargerClient

        with ChargerClient(namespace, context) as client:
            return client.wait_until_it_answers(LOOK)


@contextlib.contextmanager
def ros_context() -> Iterator[Context]:
    """Run an rclpy context that leaves signals to the command.

    Raises:
        CommandError: ROS cannot start.
    """
    try:
        import deltacharger.action  # noqa: F401  (fails here, by name, where the interfaces are not built)
        import rclpy
        from rclpy.context import Context
        from rclpy.signals import SignalHandlerOptions
    except ImportError as error:
        raise CommandError(
            f"ROS 2 or the built interfaces are missing ({error}): install the package or source its workspace"
        ) from error
    context = Context()
    rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield context
    finally:
        rclpy.try_shutdown(context=context)


def refusal(exit_code: int, holder: str = "") -> CommandError:
    """Return the error of a command that would start a second charger beside one that runs."""
    where = f"ROS domain {environment.domain()}{holder and f' (process {holder})'}"
    return CommandError(
        f"a charger already answers in {where}: stop it, or choose another ROS_DOMAIN_ID or --namespace", exit_code
    )


@contextlib.contextmanager
def only_charger(namespace: str) -> Iterator[None]:
    """Be the only process of this user on this machine that runs a charger of this ROS domain and namespace.

    Raises:
        CommandError: another one is, exit code 2; or the folder of the lock cannot be used.
    """
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(runtime.only_one(environment.domain(), namespace))
        except runtime.Taken as taken:
            raise refusal(WRONG_INPUT, taken.process) from taken
        except OSError as error:
            raise CommandError(f"no lock can be taken that keeps a second charger away: {error}") from error
        yield


def start(scene: Scene, context: Context, namespace: str, held: bool = False) -> Composition:
    """Start a scene's charger in this process; `held` as in `Composition`.

    Raises:
        CommandError: a part of it cannot start; exit code 2 where its configuration is at fault.
    """
    from deltacharger_ros.node_support import StartupError
    from deltacharger_scenes.composition import Composition

    if scene.touches_hardware:
        say(f"open to {environment.openness()}; see docs/security.md")
    composition = Composition(scene, context, namespace, held)
    try:
        return composition.start()
    except StartupError as error:
        raise CommandError(f"{scene.file}: {error}", WRONG_INPUT, file=scene.file) from error
    except ImportError as error:
        raise CommandError(f"scene '{scene.name}' needs something that is not installed: {error}") from error


def wait_for_actions(composition: Composition, client: Any, interrupts: Interrupts) -> bool:
    """Wait until a composition's actions answer; False where a signal came first.

    Raises:
        CommandError: a part broke, or they do not answer in time.
    """
    waited = 0.0
    while not client.wait_until_ready(0.5, interrupts.event):
        waited += 0.5
        if interrupts.event.is_set():
            return False
        raise_if_failed(composition)
        if waited >= START_UP:
            raise CommandError(f"the actions do not answer after {START_UP:.0f} s; look at the log above")
    return True


def raise_if_failed(composition: Composition) -> None:
    """Raise CommandError where a part of the composition no longer runs."""
    failed = composition.failed()
    if failed:
        raise CommandError(f"no longer running: {', '.join(failed)}; look at the log above")


def require_docking(scene: Scene) -> None:
    """Refuse a scene whose charger could not serve a goal.

    Raises:
        CommandError: it has no docking_node; exit code 2.
    """
    if not scene.docks:
        raise CommandError(
            f"scene '{scene.name}' starts no docking_node, so it cannot dock and undock; it starts "
            f"{', '.join(scene.nodes)}; choose another --scene",
            WRONG_INPUT,
        )
