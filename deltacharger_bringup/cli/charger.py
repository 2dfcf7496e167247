# SPDX-License-Identifier: Apache-2.0
"""`deltacharger up` and `deltacharger undock`, and what all commands that speak to a charger share."""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli.main import DEFAULT_SCENE
from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    INTERRUPTED,
    WRONG_INPUT,
    CommandError,
    Interrupts,
    answer,
    say,
    tell,
    write_json,
)
from deltacharger_bringup.cli.scene import load_for_command
from deltacharger_core import environment
from deltacharger_ros.outcomes import Outcome, Progress
from deltacharger_scenes.overrides import Overrides, override
from deltacharger_scenes.scene import Scene, SceneError

if TYPE_CHECKING:
    from rclpy.context import Context

    from deltacharger_scenes.composition import Composition

DISCOVERY = 5.0  # s; a charger that runs is found in 0.25…3 s, and starting a second one beside it would be worse
_LOOK = 3.3  # s in each of two domains where a charger may be; who misses the first announcement waits 3 s for the next
_NEIGHBOUR = _LOOK  # s to notice a charger that runs already
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
    scene = load_for_command(options.scene or DEFAULT_SCENE)
    environment.prepare()
    problem = environment.domain_problem()
    if problem:
        raise CommandError(problem, WRONG_INPUT)
    options.discovery, options.must_run = DISCOVERY, False
    if scene.touches_hardware:
        return scene
    if look_around and options.scene is None and not os.environ.get("ROS_DOMAIN_ID"):
        options.discovery = _LOOK
        if _answers_by_default(options.namespace):
            say("using the charger that answers in ROS domain 0")
            options.discovery = DISCOVERY
            options.must_run = True
            return dataclasses.replace(scene, goal=None)  # a simulated target's place is no real one's
    environment.isolate()
    return scene


def _answers_by_default(namespace: str) -> bool:
    """Whether a charger answers in the ROS domain that this process would join by itself."""
    with ros_context() as context:
        from deltacharger_ros.client import ChargerClient

        with ChargerClient(namespace, context) as client:
            return client.wait_until_it_answers(_LOOK)


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


def start(scene: Scene, context: Context, namespace: str) -> Composition:
    """Start a scene's charger in this process.

    Raises:
        CommandError: a part of it cannot start; exit code 2 where its configuration is at fault.
    """
    from deltacharger_ros.node_support import StartupError
    from deltacharger_scenes.composition import Composition

    composition = Composition(scene, context, namespace)
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


def up(options: argparse.Namespace) -> int:
    """Run a scene's charger until a signal."""
    if options.recording and options.scene is None:
        options.scene = "replay"
    scene = _with_options(prepare(options), options)
    with Interrupts() as interrupts, ros_context() as context:
        from deltacharger_ros.client import ChargerClient
        from deltacharger_scenes.composition import describe, preload

        preload(scene)
        with ChargerClient(options.namespace, context) as other:
            if "docking_node" in scene.nodes and other.wait_until_it_answers(_NEIGHBOUR, interrupts.event):
                raise CommandError(
                    f"a charger already answers in ROS domain {environment.domain()}: stop it, or choose another "
                    "ROS_DOMAIN_ID or --namespace",
                    WRONG_INPUT,
                )
        with start(scene, context, options.namespace) as composition:
            say(f"{describe(composition)}; ROS domain {environment.domain()}")
            if scene.docks:
                with ChargerClient(options.namespace, context) as client:
                    answered = wait_for_actions(composition, client, interrupts)
            else:
                say(_what_is_there(composition))
                answered = True
            if not answered:
                raise CommandError("interrupted before it was ready", interrupts.exit_code(DONE))
            say("ready")
            if options.json:
                ports = composition.ports()
                answer(options, {"ready": True, "scene": scene.name, "domain": environment.domain(), **ports})
            while not interrupts.event.wait(0.5):
                raise_if_failed(composition)
        return interrupts.exit_code(DONE)


def _with_options(scene: Scene, options: argparse.Namespace) -> Scene:
    """Return the scene with what the options of `up` put in place of its own.

    Raises:
        CommandError: they do not fit the scene; exit code 2.
    """
    told = dataclasses.fields(Overrides)
    try:
        return override(scene, Overrides(**{each.name: getattr(options, each.name) or "" for each in told}))
    except SceneError as error:
        problem = f"{error.file}: --{error.key.replace('_', '-')}: {error.problem}"
        raise CommandError(problem, WRONG_INPUT, file=error.file, key=error.key) from error


def _what_is_there(composition: Composition) -> str:
    """Return what a scene that cannot dock has instead."""
    from deltacharger_lab.pages.topics import endpoints

    found = [each for running in composition.nodes for each in endpoints(running.node) if "/_" not in each.name]
    has = []
    for verb in ("publishes", "serves"):
        names = {each.name.lstrip("/") for each in found if each.verb == verb} - {"diagnostics"}
        has += [f"{verb} {', '.join(sorted(names))}"] if names else []
    return f"no docking_node, so no goal is served; it {' and '.join(has) or 'is silent'}"


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


def undock(options: argparse.Namespace) -> int:
    """Undock the running charger."""
    require_docking(prepare(options, look_around=True))
    with Interrupts() as interrupts, ros_context() as context:
        from deltacharger_ros.client import ChargerClient, ClientError

        with ChargerClient(options.namespace, context) as client:
            if not client.wait_until_it_answers(options.discovery, interrupts.event):
                if interrupts.event.is_set():
                    raise CommandError("interrupted", INTERRUPTED)
                where = "0 or " if options.discovery == _LOOK else ""
                raise CommandError(
                    f"no charger answers in ROS domain {where}{environment.domain()}: start one with `deltacharger up`"
                )
            printer = PhasePrinter()
            try:
                outcome = client.undock(options.request_id, printer, interrupts.event, options.deadline_s)
            except ClientError as error:
                raise CommandError(str(error), INTERRUPTED if interrupts.event.is_set() else FAILED) from error
        report(outcome, options.json, {"phases": printer.phases})
        if interrupts.event.is_set():
            return INTERRUPTED
        return DONE if outcome.success else FAILED


def report(outcome: Outcome, as_json: bool, more: dict[str, Any]) -> None:
    """Print how an action ended: for people, or as the one JSON object."""
    if as_json:
        write_json({**outcome.as_dict(), **more})
        return
    if outcome.success:
        tell(f"{outcome.action}: done in {outcome.elapsed:.1f} s")
    else:
        retry = "; the same goal may succeed if sent again" if outcome.retriable else ""
        tell(f"{outcome.action}: failed, {outcome.error_code} {outcome.error_name}: {outcome.error_message}{retry}")
        suggested = outcome.details.get("suggested_base_pose")
        if suggested:
            place = ", ".join(f"{1e3 * value:.1f}" for value in suggested["position"])
            tell(f"  it could with charger_base at ({place}) mm of {suggested['frame_id']}")


class PhasePrinter:
    """Print one line when a phase begins and remember when each one did.

    Args:
        force: gives the contact force now (N, NaN = unknown).

    Attributes:
        phases: one mapping a phase: phase, start (s), z (m), contact_current (A), force (N), alignments.
    """

    def __init__(self, force: Any = None) -> None:
        self._force = force
        self.phases: list[dict[str, Any]] = []

    def __call__(self, progress: Progress) -> None:
        """Take one feedback message."""
        if self.phases and self.phases[-1]["phase"] == progress.phase:
            return
        force = float("nan") if self._force is None else self._force()
        self.phases.append(
            {
                "phase": progress.phase,
                "start": progress.time,
                "z": progress.z,
                "contact_current": progress.contact_current,
                "force": force,
                "alignments": progress.alignments,
            }
        )
        columns = [f"{progress.time:7.2f} s", f"{progress.phase:<9}", _number("z", 1e3 * progress.z, "mm", 1)]
        if progress.charge_current == progress.charge_current:
            columns.append(_number("charge", progress.charge_current, "A", 2))
        else:
            columns.append(_number("I_c", progress.contact_current, "A", 3))
        if self._force is not None:
            columns.append(_number("force", force, "N", 1))
        say("  ".join(columns))


def _number(name: str, value: float, unit: str, digits: int) -> str:
    text = "–" if value != value else f"{value:.{digits}f}"
    return f"{name} {text:>7} {unit}"
