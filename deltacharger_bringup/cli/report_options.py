# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger report`; what it does stands in cli_report.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command
from deltacharger_bringup.cli.tactile_options import add_comparison
from deltacharger_bringup.cli.types import SEED, whole

_MODULE = "deltacharger_bringup.cli.report"


def add_reports(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command with a report of each part."""
    parser = commands.add_parser("report", help="measure a part and write a page", description="Measure and report.")
    actions = parser.add_subparsers(title="actions", metavar="ACTION", required=True)
    text = "error against run time of inverse and forward kinematics, extremes, and pictures of the workspace"
    _add_kinematics(add_command(actions, "kinematics", (_MODULE, "kinematics"), text))
    text = "compare the classifiers of misalignment on simulated data: accuracy, run time, splits, shifts, confidence"
    add_comparison(add_command(actions, "tactile", (_MODULE, "tactile"), text))
    text = "the electrode detector on simulated images: what it finds, errors, run time, false alarms, both renderers"
    _add_vision(add_command(actions, "vision", (_MODULE, "vision"), text))
    text = "error against run time, stability, energy and extremes of the simulated charger's mechanics"
    _add_simulation(add_command(actions, "simulation", (_MODULE, "simulation"), text))
    text = "thousands of simulated dockings: what is charged, refused and never happens; the same call goes on"
    _add_docking(add_command(actions, "docking", (_MODULE, "docking"), text))
    text = "what each scene costs a computer: processes, start-up, memory, CPU at rest and docking, libraries (Linux)"
    _add_footprint(add_command(actions, "footprint", (_MODULE, "footprint"), text))


def _add_kinematics(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser, "report-kinematics")
    points = "per set, 50 to 100000 (default: 5000, with --quick 200)"
    parser.add_argument("--points", type=whole(50, 100_000), metavar="N", help=points)
    parser.add_argument("--seed", type=SEED, default=1, metavar="S", help="of every set (default: 1)")
    parser.add_argument("--quick", action="store_true", help="fewer points and shorter timings, for a first look")


def _add_vision(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser, "report-vision")
    images = "of a usual row, 2 to 1000 (default: 150, with --quick 15); rows of targets have more"
    parser.add_argument("--images", type=whole(2, 1000), metavar="N", help=images)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="shifts the seeds of all images (default: 0)")
    parser.add_argument("--quick", action="store_true", help="a tenth of the images, for a first look")


def _add_simulation(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser, "report-simulation")
    parser.add_argument("--quick", action="store_true", help="few steps and stiffnesses, for a first look")


def _add_docking(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser, "report-docking")
    parser.add_argument(
        "--only", action="append", default=[], metavar="NAME", help="run this campaign; may be repeated"
    )
    count = "dockings of each campaign that is run (default: as planned, 200 to 20000)"
    parser.add_argument("-n", "--n", type=whole(1, 10_000_000), metavar="N", help=count)
    parser.add_argument("--seed", type=SEED, default=8, metavar="S", help="of all campaigns (default: 8)")
    parser.add_argument("--workers", type=whole(1, 1024), default=1, metavar="K", help="processes on this computer (1)")
    parser.add_argument("--quick", action="store_true", help="a hundredth of the dockings, for a first look")


def _add_footprint(parser: argparse.ArgumentParser) -> None:
    _add_folder(parser, "report-footprint")
    text = "measure this one; may be repeated (default: every packaged scene)"
    parser.add_argument("--scene", action="append", default=[], metavar="NAME|FILE", help=text)
    repeats = "of each scene and way of starting, 1 to 100 (default: 3, with --quick 1)"
    parser.add_argument("--repeats", type=whole(1, 100), metavar="N", help=repeats)
    parser.add_argument("--quick", action="store_true", help="once and shorter, for a first look")


def _add_folder(parser: argparse.ArgumentParser, default: str) -> None:
    parser.add_argument(
        "--out", default=default, metavar="DIR", help=f"folder, made where missing (default: {default})"
    )
