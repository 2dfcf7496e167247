# SPDX-License-Identifier: Apache-2.0
"""`deltacharger tactile record`: the paper's data sets from a running charger."""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.cli.charger import DISCOVERY, prepare, ros_context
from deltacharger_bringup.records import session
from deltacharger_core import environment
from deltacharger_docking import codes, observation
from deltacharger_kinematics.geometry import Vector

if TYPE_CHECKING:
    from deltacharger_bringup.records.charger import RecordingCharger
    from deltacharger_docking.machine import DockingMachine

_TRIES = 3  # at one docking with a retriable failure; other failures end the command
_PAUSE = 3.0  # s before the next try, so that a silent device may recover
_FRAME = 1.0 / 120.0  # s
_DWELL = 0.5  # s from rest in contact to the first frame


def add_record(parser: argparse.ArgumentParser) -> None:
    """Add the options of `tactile record`."""
    add = parser.add_argument
    add("--out", required=True, metavar="F.npz", help="data set, continued if it exists")
    add(
        "--set",
        choices=session.SETS,
        required=True,
        help="the paper's sets, dockings at zero, or random offsets up to 12 mm",
    )
    add(
        "--angle-deg",
        type=arguments.between(-20.0, 20.0),
        metavar="DEG",
        help="angle of the target (sets angle and sweep)",
    )
    text = "dockings per offset (position: 20) or in total (angle: 100, reference: 10, sweep: 100)"
    add("--repeat", type=arguments.integer(1, 10000), metavar="N", help=text)
    text = "offsets of the set position (-10 -5 0 5 10)"
    add("--offsets-mm", type=arguments.between(-20.0, 20.0), nargs="+", metavar="MM", help=text)
    add("--seed", type=arguments.SEED, default=0, metavar="N", help="random seed of order and offsets (0)")
    text = "dockings per tare, i.e. per session (25)"
    add("--tare-every", type=arguments.integer(1, 10000), default=25, metavar="N", help=text)
    arguments.namespace_option(parser)
    add = parser.add_argument_group("position of the target's electrodes in charger_base").add_argument
    for flag, default in (("--x-mm", 0.0), ("--y-mm", 0.0), ("--z-mm", 80.0)):
        add(flag, type=arguments.MILLIMETRES, default=default, metavar="MM", help=f"({default:g})")
    add = parser.add_argument_group("for the complete data set").add_argument
    add("--rig", type=arguments.integer(0, 2**31 - 1), default=0, metavar="N", help="number of this charger (0)")
    add("--frames", type=arguments.integer(1, 240), default=1, metavar="N", help="frames averaged in each docking (1)")


def record(options: argparse.Namespace) -> output.Result:
    """Record the missing dockings of a set."""
    out, part = arguments.file_to_write("--out", options.out, ".npz"), _part(options)
    environment.prepare()
    from deltacharger_tactile.errors import DatasetError

    with output.wrong_input(session.Mismatch, DatasetError, file=options.out):
        journal = session.Journal(out)
        recording = _Recording(journal, part, session.Settings(options.rig, options.frames))
        if recording.left():
            try:
                recording.record(options)
            except output.CommandError as error:
                count = recording.count
                kept = f"; {out} contains the {count} dockings of this call" if count else ""
                details = {**error.details, **recording.summary()}
                raise output.CommandError(f"{error}{kept}", error.exit_code, **details) from error
    return recording.result()


def _part(options: argparse.Namespace) -> session.Part:
    """Return the part that the options define; options of another set are refused."""
    most = session.TILTED.get(options.set)
    if most is None and options.angle_deg:
        raise output.WrongInput(f"--set {options.set} takes no --angle-deg: the target is level")
    if most is not None and options.angle_deg is None:
        raise output.WrongInput(
            f"--set {options.set} needs --angle-deg, the angle of the target: from +x to +y is positive"
        )
    angle = options.angle_deg or 0.0
    if most is not None and abs(angle) > most:
        raise output.WrongInput(f"--angle-deg {angle:g} is outside {-most:g} to {most:g} of --set {options.set}")
    if options.offsets_mm is not None and options.set != "position":
        raise output.WrongInput(f"--set {options.set} takes no --offsets-mm")
    return session.Part(
        set=options.set,
        angle_deg=angle,
        repeat=options.repeat or session.REPEATS[options.set],
        seed=options.seed,
        x_mm=options.x_mm,
        y_mm=options.y_mm,
        z_mm=options.z_mm,
        offsets_mm=tuple(options.offsets_mm or session.OFFSETS_MM),
    )


class _Recording:
    """The recording of one part of a data set.

    Args:
        journal: of the data set.
        part: whose missing dockings are made.
        settings: of the data set.

    Attributes:
        count: dockings that this call added.
    """

    def __init__(self, journal: session.Journal, part: session.Part, settings: session.Settings) -> None:
        self._journal, self._part, self._settings = journal, part, settings
        self._poses = part.poses()
        self._began = time.monotonic()
        self.count = 0
        journal.check(part, settings)

    def left(self) -> list[int]:
        """Return the numbers of the missing dockings."""
        done = self._journal.done(self._part)
        return [number for number in range(len(self._poses)) if number not in done]

    def summary(self) -> dict[str, Any]:
        """Return the keys of the JSON object about the files."""
        settings = self._journal.settings
        return {
            "out": str(self._journal.out),
            "recorded": self.count,
            "remaining": len(self.left()),
            "dockings": self._journal.dockings,
            "simulated": None if settings is None else settings.simulated,
        }

    def result(self) -> output.Result:
        """Return the size of the data set."""
        journal = self._journal
        kind = "simulated " if journal.data is not None and journal.data.simulated else ""
        lines = [f"{journal.out}: {journal.dockings} {kind}dockings"]
        lines += [f"  {name:<12} {done} of {total}" for name, (done, total) in journal.parts().items()]
        return output.Result("\n".join(lines), self.summary())

    def record(self, options: argparse.Namespace) -> None:
        """Connect to the charger and make the missing dockings.

        Raises:
            CommandError: it ended early; the recorded dockings are stored.
        """
        prepare(options, look_around=True)
        with output.Interrupts() as interrupts, ros_context() as context:
            from deltacharger_bringup.records.arm_client import ArmError
            from deltacharger_bringup.records.charger import RecordingCharger

            charger = RecordingCharger(context, options.namespace, interrupts.event)
            try:
                with charger:
                    charger.wait_until_ready(DISCOVERY)
                    self._settings = dataclasses.replace(self._settings, simulated=charger.simulated())
                    self._journal.check(self._part, self._settings)
                    machine = self._machine(charger)
                    charger.claim()
                    self._announce()
                    self._run(charger, machine, options.tare_every, interrupts)
            except ArmError as error:
                raise output.CommandError(str(error), interrupts.failure) from error

    def _commands(self) -> list[Vector]:
        """Return the docking position of each pose: the position of the target minus the offset."""
        x, y, z = self._part.target
        return [(x - pose.horizontal, y - pose.vertical, z) for pose in self._poses]

    def _machine(self, charger: RecordingCharger) -> DockingMachine:
        """Return the machine with docking_node's settings, after a check that all positions are reachable."""
        from deltacharger_docking.machine import DockingMachine

        if not charger.has_docking_node:
            output.log_line("docking_node is not running: using its default parameters")
        machine = DockingMachine(*charger.settings())
        with output.wrong_input(codes.Rejected, codes.Unreachable):
            session.check_places(machine, self._commands())
        return machine

    def _announce(self) -> None:
        part, left, total = self._part, len(self.left()), len(self._poses)
        if left < total:
            output.log_line(
                f"{self._journal.out} contains {total - left} of {total} dockings already; recording the others"
            )
        turned = f", turned by {part.angle_deg:g}° (from +x to +y)" if part.set in session.TILTED else ", level"
        output.log_line(f"{left} dockings; target at ({part.x_mm:g}, {part.y_mm:g}, {part.z_mm:g}) mm{turned}")
        output.log_line("keep clear: the arm moves now")
        self._began = time.monotonic()

    def _report(self, docking: session.Docking) -> None:
        """Report a stored docking."""
        self.count += 1
        left, total = len(self.left()), len(self._poses)
        minutes = (time.monotonic() - self._began) / self.count * left / 60.0
        place = f"({1e3 * docking.pose.horizontal:+.1f}, {1e3 * docking.pose.vertical:+.1f}) mm"
        output.log_line(f"{total - left} of {total}  {place}  {docking.current:.3f} A  {minutes:.0f} min left")

    def _run(
        self, charger: RecordingCharger, machine: DockingMachine, size: int, interrupts: output.Interrupts
    ) -> None:
        """Run sessions of `size` dockings, each with its own tare; retry a failed docking in a new session.

        Raises:
            CommandError: interrupted, or too many failures.
        """
        failures = 0
        while numbers := self.left()[:size]:
            before = self.count
            outcome = self._session(charger, machine, numbers)
            what = outcome.message if outcome.code is codes.Code.INTERNAL else f"{outcome.code.name}: {outcome.message}"
            if interrupts.event.is_set():
                if machine.status.docked or outcome.code not in (codes.Code.NONE, codes.Code.CANCELED):
                    raise output.CommandError(f"interrupted; {what}", output.INTERRUPTED)  # the arm is not home
                break
            if outcome.success:
                continue
            failures = 1 if self.count > before else failures + 1
            if not outcome.retriable:
                raise output.CommandError(what, code=int(outcome.code))
            if failures == _TRIES:
                raise output.CommandError(f"a docking failed {_TRIES} times, {what}", code=int(outcome.code))
            output.log_line(f"docking failed, {what}; trying again")
            if interrupts.event.wait(_PAUSE):
                break
        if interrupts.event.is_set():
            raise output.CommandError("interrupted; repeat the command to resume", output.INTERRUPTED)

    def _session(
        self, charger: RecordingCharger, machine: DockingMachine, numbers: Sequence[int]
    ) -> observation.DockingOutcome:
        """Make the dockings of these numbers; all frames are stored when this returns."""
        from deltacharger_bringup.records.charger import SessionKeeper

        settings, commands = self._settings, self._commands()
        keeper = SessionKeeper(charger, self._journal, self._part, settings, numbers, self._report)
        places, holding = [commands[number] for number in numbers], settings.frames * _FRAME
        try:
            return charger.run(machine, session.TouchSession(places, _DWELL, holding, keeper))
        finally:
            try:
                keeper.close()
            except session.NotKept as error:
                raise output.CommandError(str(error)) from error
