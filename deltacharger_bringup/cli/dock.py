# SPDX-License-Identifier: Apache-2.0
"""`deltacharger dock` and `undock`: send one goal, show progress and result, draw a picture."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli import arguments, charger, output
from deltacharger_core import environment
from deltacharger_core.ros.outcomes import DockRequest, Outcome, Pose, Progress, place
from deltacharger_core.texts import figure

if TYPE_CHECKING:
    from deltacharger_bringup.records.replay.record import Recorder
    from deltacharger_bringup.scenes.composition import Composition
    from deltacharger_bringup.scenes.scene import Scene
    from deltacharger_core.ros.client import ChargerClient

_DEFAULT_PICTURE = "dock.png"


def _result(outcome: Outcome, more: dict[str, Any], code: int, remarks: Sequence[str] = ()) -> output.Result:
    """Return the result of an action."""
    lines = [f"{outcome.action}: {outcome.ending()}"]
    suggested = None if outcome.success else outcome.details.get("suggested_base_pose")
    if suggested:
        where = ", ".join(f"{1e3 * value:.1f}" for value in suggested["position"])
        turn = f", turned by {math.degrees(suggested['yaw']):+.1f}° about its y" if suggested["yaw"] else ""
        lines.append(f"  possible with charger_base at ({where}) mm of {suggested['frame_id']}{turn}")
    return output.Result("\n".join(lines), {**outcome.as_dict(), **more}, code, remarks)


class PhasePrinter:
    """Print one line when a phase begins, and store the phases.

    Args:
        force: returns the present contact force (N, NaN = unknown).

    Attributes:
        phases: the first progress of each, with the force (N).
    """

    def __init__(self, force: Any = None) -> None:
        self._force = force
        self.phases: list[dict[str, Any]] = []

    def __call__(self, progress: Progress) -> None:
        """Handle one feedback message."""
        if self.phases and self.phases[-1]["phase"] == progress.phase:
            return
        force = float("nan") if self._force is None else self._force()
        self.phases.append({**asdict(progress), "force": force})
        columns = [f"{progress.time:7.2f} s", f"{progress.phase:<9}", f"z {figure(1e3 * progress.z, 'mm', 1, 7)}"]
        if progress.charge_current == progress.charge_current:
            columns.append(f"charge {figure(progress.charge_current, 'A', 2, 7)}")
        else:
            columns.append(f"I_c {figure(progress.contact_current, 'A', 3, 7)}")
        if self._force is not None:
            columns.append(f"force {figure(force, 'N', 1, 7)}")
        if progress.waiting_for:
            columns.append(f"waits for {progress.waiting_for}")
        output.log_line("  ".join(columns))


def add_dock(parser: argparse.ArgumentParser) -> None:
    """Add the options of `dock`."""
    add = parser.add_argument
    arguments.scene_option(parser)
    arguments.namespace_option(parser)
    for axis in "xyz":
        text = f"position of the electrodes along {axis} of charger_base"
        add(f"--{axis}-mm", type=arguments.MILLIMETRES, metavar="MM", help=text)
    add("--roll-deg", type=arguments.DEGREES, metavar="DEG", help="roll of the electrodes about z, -90 to 90")
    add("--camera", action="store_true", help="use the camera even if the scene has coordinates")
    text = "stricter critical angle than the charger's"
    add("--critical-angle-deg", type=arguments.NOT_NEGATIVE, default=0.0, metavar="DEG", help=text)
    add("--no-charge", action="store_true", help="dock, but do not charge")
    add("--hold", action="store_true", help="charge until a stop condition, a full target or Ctrl-C")
    add("--stop-after-s", type=arguments.NOT_NEGATIVE, default=0.0, metavar="S", help="end after this time of charging")
    add("--stop-energy-j", type=arguments.NOT_NEGATIVE, default=0.0, metavar="J", help="end after this energy")
    text = "name of the target's profile (default: the charger's first one)"
    add("--target-profile", default="", metavar="NAME", help=text)
    add("--deadline-s", type=arguments.deadline, default=math.inf, metavar="S", help="cancel after this time")
    add("--request-id", default="", metavar="ID", help="is returned in docking_state")
    add("--picture", default=_DEFAULT_PICTURE, metavar="FILE", help=f"picture of the run (default: {_DEFAULT_PICTURE})")
    add("--no-picture", action="store_true", help="write no picture")
    arguments.record_option(parser)


def dock(options: argparse.Namespace) -> output.Result:
    """Dock with the running charger, or start the charger of the scene in this process."""
    if not options.no_picture and options.picture != _DEFAULT_PICTURE:  # without a picture no writable folder is needed
        arguments.picture_to_write(options.picture)
    scene = charger.prepare(options, look_around=True)
    charger.require_docking(scene)
    request = dock_request(options, scene)
    with output.Interrupts() as interrupts, charger.ros_context() as context, contextlib.ExitStack() as stack:
        from deltacharger_bringup.records.replay.record import Recorder
        from deltacharger_bringup.scenes.scene import RECORDER, recorder_alone, with_recorder
        from deltacharger_core.ros.client import ChargerClient

        client = stack.enter_context(ChargerClient(options.namespace, context))
        composition: Composition | None = None
        if not client.wait_until_it_answers(options.discovery, interrupts.event) and not interrupts.event.is_set():
            if options.must_run:
                raise output.CommandError(f"the charger in ROS domain {environment.domain()} no longer answers")
            output.log_line(f"no charger answers in ROS domain {environment.domain()}; starting scene '{scene.name}'")
            stack.enter_context(charger.only_charger(options.namespace))
            _log_warnings_only()
            composition = stack.enter_context(
                charger.start(with_recorder(scene, options.record), context, options.namespace)
            )
            charger.wait_for_actions(composition, client, interrupts)
        if interrupts.event.is_set():
            raise output.CommandError("interrupted", output.INTERRUPTED)
        if composition is None and options.scene is not None:
            output.log_line(f"using the running charger; only the goal of scene '{scene.name}' is used")
        own = composition
        if own is None and options.record:
            own = stack.enter_context(charger.start(recorder_alone(scene, options.record), context, options.namespace))
        keepers = [own.node(RECORDER)] if own is not None and RECORDER in own.nodes else []
        recorder = stack.enter_context(Recorder(context, options.namespace))
        result = _Run(options, scene, request, client, recorder, composition, interrupts).carry_out()
        if own is not None:
            own.close()  # completes the record
        for keeper in keepers:
            if keeper.problem:
                remarks = [*result.remarks, f"{RECORDER}: {keeper.problem}"]
                result = replace(result, code=result.code or output.FAILED, remarks=remarks)
        return result


def _log_warnings_only() -> None:
    """Limit the nodes of this process to warnings: the command prints goal, phases and result."""
    from rclpy.impl.logging_severity import LoggingSeverity
    from rclpy.logging import set_logger_level

    set_logger_level("", LoggingSeverity.WARN)


def dock_request(options: argparse.Namespace, scene: Scene) -> DockRequest:
    """Return the goal: coordinates of the command line, else of the scene, else from the camera.

    Raises:
        CommandError: some coordinates are given and the others are unknown.
    """
    given = {axis: getattr(options, f"{axis}_mm") for axis in "xyz"}
    flags = {axis: 1e-3 * millimetres for axis, millimetres in given.items() if millimetres is not None}
    if options.roll_deg is not None:
        flags["roll"] = math.radians(options.roll_deg)
    return DockRequest(
        electrodes=_electrodes(flags, options.camera, scene),
        critical_angle=math.radians(options.critical_angle_deg),
        start_charging=not options.no_charge,
        hold=options.hold,
        stop_energy=options.stop_energy_j,
        stop_after=options.stop_after_s,
        request_id=options.request_id,
        target_profile=options.target_profile,
    )


def _electrodes(flags: dict[str, Any], camera: bool, scene: Scene) -> Pose | None:
    if camera:
        if flags:
            raise output.WrongInput("--camera and coordinates exclude each other")
        return None
    if scene.goal is not None:
        return Pose(**{**asdict(scene.goal), **flags})
    if not flags:
        return None
    missing = [f"--{axis}-mm" for axis in "xyz" if axis not in flags]
    if missing:
        raise output.WrongInput(f"{', '.join(missing)} missing: scene '{scene.name}' has no key goal; give them")
    return Pose(**flags)


@dataclass
class _Run:
    """One docking from goal to report."""

    options: argparse.Namespace
    scene: Scene
    request: DockRequest
    client: ChargerClient
    recorder: Recorder
    composition: Composition | None
    interrupts: output.Interrupts

    def carry_out(self) -> output.Result:
        """Dock, undock if this process started the charger, draw and report."""
        output.log_line(self._goal_line())
        printer = PhasePrinter(self.recorder.force)
        outcome = self._dock(printer)
        advice = self._advice(outcome)
        self.recorder.finish(outcome)
        more: dict[str, Any] = {
            "scene": self.scene.name,
            "charger": "running" if self.composition is None else "started",
            "phases": printer.phases,
        }
        unsafe = ""
        if self.composition is not None:
            if outcome.success:
                more["undock"] = self._undock()
            unsafe = self._truth(more)
            # Drawing blocks the interpreter for seconds; nodes in this process would take that for a broken cable.
            self.recorder.close()
            self.composition.close()
        more["picture"] = self._draw()
        code = output.DONE if outcome.success and not unsafe else output.FAILED
        remarks = [advice, outcome.figures() if outcome.success else "", unsafe]
        return _result(outcome, more, output.INTERRUPTED if self.interrupts.number else code, [*filter(None, remarks)])

    def _goal_line(self) -> str:
        pose = self.request.electrodes
        if pose is None:
            return "goal: electrodes as detected by the camera"
        return f"goal: electrodes at {place(pose.x, pose.y, pose.z, pose.roll)}"

    def _dock(self, printer: PhasePrinter) -> Outcome:
        from deltacharger_core.ros.client import ClientError

        try:
            return self.client.dock(
                self.request, printer, self.interrupts.event, self.options.deadline_s, self.interrupts.impatient
            )
        except ClientError as error:
            raise output.CommandError(str(error), self.interrupts.failure) from error

    def _advice(self, outcome: Outcome) -> str:
        """Return what to do if the camera was requested and there is none; else ''."""
        if outcome.error_name != "ELECTRODES_NOT_FOUND" or self.client.has_detector():
            return ""
        return (
            "no detector of electrodes runs: give coordinates (--x-mm --y-mm --z-mm), or start a charger whose scene "
            "has a detector, such as --scene camera (simulated), oakd or rgbd"
        )

    def _undock(self) -> dict[str, Any]:
        from deltacharger_core.ros.client import ClientError

        output.log_line("undocking, because this command stops the charger that it started")
        try:
            outcome = self.client.undock(on_progress=PhasePrinter(), deadline=60.0)
        except ClientError as error:
            output.log_line(str(error))
            return {"success": False, "error_message": str(error)}
        if not outcome.success:
            output.log_line(f"undock: {outcome.ending()}")
        return outcome.as_dict()

    def _draw(self) -> str | None:
        if self.options.no_picture:
            return None
        from deltacharger_bringup.records.replay.picture import PictureError, draw

        path = Path(self.options.picture)
        whose = "the running charger" if self.composition is None else f"scene '{self.scene.name}'"
        try:
            draw(self.recorder.run, path, f"{whose}; {self._goal_line()}")
        except PictureError as error:
            output.log_line(f"no picture: {error}")
            return None
        output.log_line(f"picture: {path}")
        return str(path)

    def _truth(self, more: dict[str, Any]) -> str:
        """Add the record of the simulated world, if any; return why it was unsafe, or ''."""
        assert self.composition is not None
        if self.composition.charger is None:
            return ""
        record = self.composition.charger.record()
        more["simulation"] = record
        if record.get("energised_shorts") or record.get("energised_unsafe"):
            return "short or lost clearance while energised in the simulated world: this docking failed"
        return ""


def add_undock(parser: argparse.ArgumentParser) -> None:
    """Add the options of `undock`."""
    add = parser.add_argument
    arguments.scene_option(parser)
    arguments.namespace_option(parser)
    add("--deadline-s", type=arguments.deadline, default=math.inf, metavar="S", help="cancel after this time")
    add("--request-id", default="", metavar="ID", help="is returned in docking_state")


def undock(options: argparse.Namespace) -> output.Result:
    """Undock the running charger."""
    charger.require_docking(charger.prepare(options, look_around=True))
    with output.Interrupts() as interrupts, charger.ros_context() as context:
        from deltacharger_core.ros.client import ChargerClient, ClientError

        with ChargerClient(options.namespace, context) as client:
            if not client.wait_until_it_answers(options.discovery, interrupts.event):
                if interrupts.event.is_set():
                    raise output.CommandError("interrupted", output.INTERRUPTED)
                raise output.CommandError(
                    f"no charger answers in ROS domain {options.searched}: start one with `deltacharger up`"
                )
            printer = PhasePrinter()
            try:
                outcome = client.undock(options.request_id, printer, interrupts.event, options.deadline_s)
            except ClientError as error:
                raise output.CommandError(str(error), interrupts.failure) from error
        code = output.INTERRUPTED if interrupts.number else output.DONE if outcome.success else output.FAILED
        return _result(outcome, {"phases": printer.phases}, code)
