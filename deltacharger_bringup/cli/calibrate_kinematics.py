# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics`: measure poses, or fit the geometry to them."""

from __future__ import annotations

import argparse
import contextlib
import datetime
import math
import os
import re
import select
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from deltacharger_bringup.cli import arguments, charger, output
from deltacharger_core.files import sha256
from deltacharger_kinematics.calibration import calibrate, data
from deltacharger_kinematics.calibration.calibrate import numbers
from deltacharger_kinematics.geometry import (
    LIMB_COUNT,
    DeltaGeometry,
    Vector,
    geometry_to_mapping,
    load_geometry,
    save_geometry,
)

if TYPE_CHECKING:
    from deltacharger_bringup.records.arm_client import ArmClient

_WORST = 5  # rows to name
_UNEXPLAINED = 2.0  # scatter; below it the stated uncertainties are plausible
_SUSPICIOUS = 3.0  # tolerances; a well-built arm hardly ever differs more
_STOPPED = 0.010  # m from the pose; a larger distance means an obstacle
_DOUBTFUL = 0.020  # m between measured and predicted position; more is a typing error rather than a badly built arm
_POLL = 0.1  # s between checks of the arm during input


def refusing(path: str) -> contextlib.AbstractContextManager[None]:
    """Report an invalid file of measurements with exit code 2 and its lines."""
    return output.wrong_input(data.CalibrationError, before=f"{path}: ", file=path)


def geometry_of(path: str | None) -> DeltaGeometry:
    """Return the arm's geometry from a file, or the built-in one.

    Raises:
        CommandError: the file is refused; exit code 2.
    """
    with output.wrong_input(ValueError, file=path):
        return DeltaGeometry() if path is None else load_geometry(path)


def add_kinematics(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate kinematics`."""
    add = parser.add_argument
    add("data", nargs="?", metavar="DATA.csv", help="measured poses, see docs/calibration.md")
    add("--out", metavar="FILE", help="write the fitted geometry, for the parameter geometry_file")
    add("--nominal", metavar="FILE", help="geometry to start from (default: the built-in one)")
    add("--measure", metavar="FILE", help="move the running charger to 36 poses; ask for and record their positions")
    add("--force", action="store_true", help="overwrite files, and write a doubtful geometry")
    add = parser.add_argument_group("prior knowledge, as standard deviations").add_argument
    add(
        "--measurement-mm",
        type=arguments.between(1e-6, 10.0),
        default=0.05,
        metavar="MM",
        help="of a coordinate (0.05)",
    )
    add("--tolerance-mm", type=arguments.between(1e-6, 20.0), default=0.5, metavar="MM", help="of lengths (0.5)")
    add("--tolerance-deg", type=arguments.between(1e-6, 30.0), default=1.0, metavar="DEG", help="of angles (1)")
    arguments.namespace_option(parser)


def kinematics(options: argparse.Namespace) -> output.Result:
    """Fit or measure, according to the options."""
    if (options.data is None) == (options.measure is None):
        raise output.WrongInput("give DATA.csv to fit, or --measure FILE to record it")
    return _fit(options) if options.measure is None else measure(options, geometry_of(options.nominal))


def _fit(options: argparse.Namespace) -> output.Result:
    if options.out is not None:
        arguments.file_to_write("--out", options.out, overwrite=options.force)
    nominal = geometry_of(options.nominal)
    uncertainty = calibrate.Uncertainty(
        options.measurement_mm * data.MILLIMETRE,
        options.tolerance_mm * data.MILLIMETRE,
        math.radians(options.tolerance_deg),
    )
    with refusing(options.data):
        found = calibrate.calibrate(data.read_measurements(options.data), nominal, uncertainty)
    doubts, text = _doubts(found), _as_text(found)

    def save(path: str) -> None:
        save_geometry(found.fit.geometry, path, _header(options, found, [*text.splitlines(), *doubts]))

    before, after = found.held_out_rms
    value = {
        "rows": len(found.measurements),
        "rms": {"before": calibrate.rms(found.before), "after": calibrate.rms(found.fit.residuals)},
        "held_out": {"lines": _lines(found, np.flatnonzero(found.held_out)), "before": before, "after": after},
        "scatter": found.fit.scatter,
        "outliers": _lines(found, np.flatnonzero(found.outliers)),
        "geometry": geometry_to_mapping(found.fit.geometry),
        "doubts": doubts,
    }
    return output.conclude(options, bool(doubts), save, text, value, doubts)


def _doubts(found: calibrate.GeometryCalibration) -> list[str]:
    """Return reasons not to use the geometry."""
    doubts = []
    if not found.improves:
        before, after = found.held_out_rms
        doubts.append(
            f"the fit does not improve held-out rows: error {_mm(before)} mm before, {_mm(after)} mm "
            "after; the nominal geometry is equally good, or the measurements contradict each other"
        )
    if found.outliers.any():
        lines = _lines(found, np.flatnonzero(found.outliers))
        doubts.append(
            f"{calibrate.named(tuple(lines))}: the other rows contradict this; measure again, or delete the row"
        )
    return doubts


def _lines(found: calibrate.GeometryCalibration, rows: Any) -> list[int]:
    return [found.measurements.lines[row] for row in rows]


def _mm(value: float) -> str:
    return f"{value / data.MILLIMETRE:.3f}"


def _header(options: argparse.Namespace, found: calibrate.GeometryCalibration, lines: Sequence[str]) -> str:
    """Return the comment with the origin of a geometry file: what was printed about it."""
    encoder = found.measurements.encoder
    mounted = f" with {', '.join(encoder.statement.replace('# ', '').splitlines())}" if encoder else ""
    return "\n".join(
        [
            "Geometry of one arm, fitted by `deltacharger calibrate kinematics`.",
            f"date: {datetime.datetime.now(datetime.timezone.utc):%Y-%m-%d %H:%M} UTC",
            f"measurements: {Path(options.data).name}, SHA-256 {sha256(options.data)}",
            f"angles as servo_node reports them{mounted}",
            *lines,
        ]
    )


def _as_text(found: calibrate.GeometryCalibration) -> str:
    count, kept = len(found.measurements), int(found.held_out.sum())
    before, after = found.held_out_rms
    lengths = np.linalg.norm(found.fit.residuals, axis=1)
    worst = ", ".join(
        f"line {found.measurements.lines[row]} {_mm(lengths[row])}" for row in np.argsort(-lengths)[:_WORST]
    )
    hint = "" if found.fit.scatter < _UNEXPLAINED else ": do the joints have play, or is the measurement coarser?"
    all_before, all_after = calibrate.rms(found.before), calibrate.rms(found.fit.residuals)
    rows = [
        ("all rows", f"{count}: rms {_mm(all_before)} mm before, {_mm(all_after)} mm after"),
        ("held out", f"{kept} of them: rms {_mm(before)} mm before, {_mm(after)} mm after a fit to the others"),
        ("scatter", f"{found.fit.scatter:.2f} of what measurement and encoder explain{hint}"),
        ("residuals", f"largest, mm: {worst}"),
    ]
    return "\n".join([*_table(found), "", *(f"{name:<10} {text}" for name, text in rows)])


def _table(found: calibrate.GeometryCalibration) -> list[str]:
    """Return nominal value, fitted value and its standard deviation of each number, limbs side by side."""
    shape = (LIMB_COUNT, len(calibrate.NAMES))
    nominal, fitted = numbers(found.nominal), numbers(found.fit.geometry)
    far = (np.abs(fitted - nominal) > _SUSPICIOUS * found.uncertainty.tolerances).reshape(shape)
    columns = [values.reshape(shape) for values in (nominal, fitted, found.standard_deviations)]
    lines = [
        " " * 22 + "".join(f"{f'limb {limb}':^30}" for limb in range(LIMB_COUNT)),
        " " * 22 + f"{'nominal':>9}{'fitted':>10}{'±':>8}   " * LIMB_COUNT,
    ]
    for index, name in enumerate(calibrate.NAMES):
        unit, scale = ("deg", math.radians(1.0)) if name == "angle_offset" else ("mm", data.MILLIMETRE)
        cells = ""
        for limb in range(LIMB_COUNT):
            start, end, spread = (column[limb, index] / scale for column in columns)
            cells += f"{start:>9.3f}{end:>10.3f}{spread:>8.3f} {'!' if far[limb, index] else ' '} "
        lines.append(f"{name:<17} {unit:<4}{cells}")
    if far.any():
        lines.append(f"! more than {_SUSPICIOUS:g} tolerances from nominal")
    return [line.rstrip() for line in lines]


class Answers:
    """Lines from standard input, with checks of the arm while waiting.

    `input()` would keep waiting after a signal, and would not check the arm.
    """

    def __init__(self) -> None:
        self._left = b""
        self._ended = sys.stdin is None

    def next(self, check: Callable[[], None]) -> str | None:
        """Return the next line, or None at the end of the input; `check` is called while waiting."""
        while b"\n" not in self._left and not self._ended:
            check()
            if select.select([sys.stdin], [], [], _POLL)[0]:
                chunk = b""
                with contextlib.suppress(OSError):  # a closed terminal
                    chunk = os.read(sys.stdin.fileno(), 4096)
                self._ended = not chunk
                self._left += chunk
        if not self._left:
            return None
        line, _, self._left = self._left.partition(b"\n")
        return line.decode("utf-8", "replace").strip()


def measure(options: argparse.Namespace, geometry: DeltaGeometry) -> output.Result:
    """Measure the planned poses with the running charger."""
    poses = data.plan(geometry)
    charger.prepare(options, look_around=True)
    counts = {"measured": 0, "skipped": 0}
    with output.Interrupts() as interrupts, charger.ros_context() as context:
        from deltacharger_bringup.records.arm_client import ArmClient, ArmError

        try:
            with ArmClient(context, geometry, options.namespace, interrupts.event) as arm:
                arm.wait_until_ready(charger.DISCOVERY)
                with refusing(options.measure):
                    recording = data.PoseRecording(options.measure, arm.encoder() or data.Encoder())
                    left = [pose for pose in poses if pose.number not in recording.done]
                    complete = not left or _visit(arm, left, recording, counts)
        except ArmError as error:
            kept = f"; {options.measure} contains the measured poses" if counts["measured"] else ""
            raise output.CommandError(f"{error}{kept}", interrupts.failure, **counts) from error
    remaining = len(poses) - len(recording.done)
    remark = f"{options.measure} contains {len(recording.done)} of {len(poses)} poses; the torque is off"
    details = {"written": options.measure, **counts, "remaining": remaining}
    return output.Result("", details, output.DONE if complete else output.FAILED, [remark])


def _visit(
    arm: ArmClient, poses: Sequence[data.PlannedPose], recording: data.PoseRecording, counts: dict[str, int]
) -> bool:
    """Move to the poses one by one and record the answers; return False if the input ended early."""
    answers = Answers()
    output.log_line("keep clear: the arm moves now, and after each answer")
    arm.start()
    for number, pose in enumerate(poses, start=1):
        output.log_line(f"pose {pose.number}, {number} of {len(poses)}: going to {_place(pose.position)} mm")
        arm.move(pose.position)
        if math.dist(arm.position(), pose.position) > _STOPPED:
            output.log_line(f"  the arm stopped at {_place(arm.position())} mm: is there an obstacle?")
        output.log_line("  measured x y z in mm, s = skip, q = quit:")
        word = _record(arm, pose, recording, answers)
        if word in ("end", "quit"):
            output.log_line("the input has ended" if word == "end" else "quitting; repeat the command to resume")
            arm.go_home()
            return word == "quit"
        counts[word] += 1
    arm.go_home()
    return True


def _record(arm: ArmClient, pose: data.PlannedPose, recording: data.PoseRecording, answers: Answers) -> str:
    """Ask until there is an answer. Return "measured" (recorded), "skipped", "quit" or "end" of the input."""
    from deltacharger_bringup.records.arm_client import STILL

    asked, doubted = arm.angles(), ""
    while True:
        text = answers.next(arm.check)
        if text is None or text in ("q", "s"):
            return "end" if text is None else {"q": "quit", "s": "skipped"}[text]
        position = position_of(text)
        if position is None:
            output.log_line(f"  '{text}' is not three numbers; x y z in mm, s = skip, q = quit:")
            continue
        arm.rest()
        away = math.dist(position, arm.position())
        if away > _DOUBTFUL and text != doubted:
            doubted = text
            output.log_line(
                f"  that is {away / data.MILLIMETRE:.0f} mm from the expected position; repeat it if correct:"
            )
            continue
        angles = arm.angles()
        moved = float(np.abs(np.subtract(angles, asked)).max())
        if moved > STILL:
            asked = angles
            output.log_line(f"  the arm moved by {moved / data.TICK:.0f} ticks since; measure again, x y z in mm:")
            continue
        first, second, third = recording.encoder.ticks(np.array(angles))
        recording.append(pose, (float(first), float(second), float(third)), position)
        return "measured"


def position_of(text: str) -> Vector | None:
    """Return the position (m) of three numbers in mm, separated by spaces, commas or semicolons; else None."""
    try:
        x, y, z = (float(word) * data.MILLIMETRE for word in re.split(r"[\s,;]+", text))
    except ValueError:
        return None
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else None


def _place(position: Vector) -> str:
    return "(" + ", ".join(f"{value / data.MILLIMETRE:.1f}" for value in position) + ")"
