# SPDX-License-Identifier: Apache-2.0
"""`deltacharger undock`: the running charger releases the target and retracts its arm."""

from __future__ import annotations

import argparse
import math

from deltacharger_bringup.cli.charger import prepare, require_docking, ros_context
from deltacharger_bringup.cli.output import DONE, FAILED, INTERRUPTED, CommandError, Interrupts
from deltacharger_bringup.cli.parser import namespace_option, scene_option
from deltacharger_bringup.cli.phases import PhasePrinter, report
from deltacharger_bringup.cli.types import deadline


def add_undock(parser: argparse.ArgumentParser) -> None:
    """Add the options of `undock`."""
    scene_option(parser)
    namespace_option(parser)
    parser.add_argument("--deadline-s", type=deadline, default=math.inf, metavar="S", help="cancel after this time")
    parser.add_argument("--request-id", default="", metavar="ID", help="is returned in docking_state")


def undock(options: argparse.Namespace) -> int:
    """Undock the running charger."""
    require_docking(prepare(options, look_around=True))
    with Interrupts() as interrupts, ros_context() as context:
        from deltacharger_ros.client import ChargerClient, ClientError

        with ChargerClient(options.namespace, context) as client:
            if not client.wait_until_it_answers(options.discovery, interrupts.event):
                if interrupts.event.is_set():
                    raise CommandError("interrupted", INTERRUPTED)
                raise CommandError(
                    f"no charger answers in ROS domain {options.searched}: start one with `deltacharger up`"
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
