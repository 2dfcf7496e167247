# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics --plan … --measure …`: move to each pose, ask for its measurement, record it."""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import re
import select
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from deltacharger_bringup.cli.calibration import encoder_of, refusing
from deltacharger_bringup.cli.charger import DISCOVERY, prepare, ros_context
from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    INTERRUPTED,
    WRONG_INPUT,
    CommandError,
    Interrupts,
    log_line,
    write_json,
)
from deltacharger_kinematics.calibration.data import TICK, Encoder
from deltacharger_kinematics.calibration.plan import PlannedPose, read_plan
from deltacharger_kinematics.calibration.recording import PoseRecording
from deltacharger_kinematics.calibration.table import MILLIMETRE
from deltacharger_kinematics.geometry import DeltaGeometry, Vector

if TYPE_CHECKING:
    from deltacharger_records.datasets.arm_client import ArmClient

_STOPPED = 0.010  # m from the pose; a larger distance means an obstacle
_DOUBTFUL = 0.020  # m between measured and predicted position; more is a typing error rather than a badly built arm
_POLL = 0.1  # s between checks of the arm during input


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


def measure(options: argparse.Namespace, geometry: DeltaGeometry) -> int:
    """Measure the poses of a plan with the running charger."""
    with refusing(options.plan):
        poses = read_plan(options.plan)
    prepare(options, look_around=True)
    counts = {"measured": 0, "skipped": 0}
    with Interrupts() as interrupts, ros_context() as context:
        from deltacharger_records.datasets.arm_client import ArmClient
        from deltacharger_records.datasets.arm_guest import ArmError

        try:
            with ArmClient(context, geometry, options.namespace, interrupts.event) as arm:
                arm.wait_until_ready(DISCOVERY)
                with refusing(options.measure):
                    recording = PoseRecording(options.measure, _encoder(encoder_of(options), arm.encoder()))
                    left = [pose for pose in poses if pose.number not in recording.done]
                    _announce(options.measure, poses, left)
                    complete = not left or _visit(arm, left, recording, counts)
        except ArmError as error:
            code = INTERRUPTED if interrupts.event.is_set() else FAILED
            kept = f"; {options.measure} contains the measured poses" if counts["measured"] else ""
            raise CommandError(f"{error}{kept}", code, **counts) from error
    remaining = len(poses) - len(recording.done)
    log_line(f"{options.measure} contains {len(recording.done)} of {len(poses)} poses; the torque is off")
    if options.json:
        write_json({"success": complete, "written": options.measure, **counts, "remaining": remaining})
    return DONE if complete else FAILED


def _encoder(stated: Encoder | None, reported: Encoder | None) -> Encoder:
    """Return the encoder: as servo_node reports it. The options must not differ from it."""
    if reported is None:
        used = stated or Encoder()
        log_line(f"servo_node does not report zero_ticks and direction; using {used.zero_ticks} and {used.direction}")
        return used
    if stated is not None and stated != reported:
        raise CommandError(
            f"servo_node has zero_ticks {reported.zero_ticks} and direction {reported.direction}: leave out "
            "options that differ",
            WRONG_INPUT,
        )
    return reported


def _announce(path: str, poses: Sequence[PlannedPose], left: Sequence[PlannedPose]) -> None:
    if len(left) < len(poses):
        log_line(f"{path} contains {len(poses) - len(left)} of {len(poses)} poses already; continuing with the others")
    log_line("keep clear: the arm moves now, and after each answer")


def _visit(arm: ArmClient, poses: Sequence[PlannedPose], recording: PoseRecording, counts: dict[str, int]) -> bool:
    """Move to the poses one by one and record the answers; return False if the input ended early."""
    answers = Answers()
    arm.start()
    for number, pose in enumerate(poses, start=1):
        log_line(f"pose {pose.number}, {number} of {len(poses)}: going to {_place(pose.position)} mm")
        arm.move(pose.position)
        if math.dist(arm.position(), pose.position) > _STOPPED:
            log_line(f"  the arm stopped at {_place(arm.position())} mm: is there an obstacle?")
        log_line("  measured x y z in mm, s = skip, q = quit:")
        word = _record(arm, pose, recording, answers)
        if word in ("end", "quit"):
            log_line("the input has ended" if word == "end" else "quitting; repeat the command to resume")
            arm.go_home()
            return word == "quit"
        counts[word] += 1
    arm.go_home()
    return True


def _record(arm: ArmClient, pose: PlannedPose, recording: PoseRecording, answers: Answers) -> str:
    """Ask until there is an answer. Return "measured" (recorded), "skipped", "quit" or "end" of the input."""
    from deltacharger_records.datasets.arm_client import STILL

    asked, doubted = arm.angles(), ""
    while True:
        text = answers.next(arm.check)
        if text is None or text in ("q", "s"):
            return "end" if text is None else {"q": "quit", "s": "skipped"}[text]
        position = position_of(text)
        if position is None:
            log_line(f"  '{text}' is not three numbers; x y z in mm, s = skip, q = quit:")
            continue
        arm.rest()
        away = math.dist(position, arm.position())
        if away > _DOUBTFUL and text != doubted:
            doubted = text
            log_line(f"  that is {away / MILLIMETRE:.0f} mm from the expected position; repeat it if correct:")
            continue
        angles = arm.angles()
        moved = float(np.abs(np.subtract(angles, asked)).max())
        if moved > STILL:
            asked = angles
            log_line(f"  the arm moved by {moved / TICK:.0f} ticks since; measure again, x y z in mm:")
            continue
        first, second, third = recording.encoder.ticks(np.array(angles))
        recording.append(pose, (float(first), float(second), float(third)), position)
        return "measured"


def position_of(text: str) -> Vector | None:
    """Return the position (m) of a text with three numbers in mm; None for any other text.

    Separators are spaces, commas or semicolons. If spaces separate, a comma may be the decimal point.
    """
    words = text.replace(";", " ").split()
    words = [word.replace(",", ".") for word in words] if len(words) == 3 else re.split(r"[\s,;]+", text)
    try:
        x, y, z = (float(word) * MILLIMETRE for word in words)
    except ValueError:
        return None
    return (x, y, z) if all(map(math.isfinite, (x, y, z))) else None


def _place(position: Vector) -> str:
    return "(" + ", ".join(f"{value / MILLIMETRE:.1f}" for value in position) + ")"
