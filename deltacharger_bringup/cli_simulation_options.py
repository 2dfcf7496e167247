"""The options of `deltacharger report simulation`; what it does stands in cli_report.py."""

from __future__ import annotations

import argparse

DEFAULT_SIMULATION_REPORT = "report-simulation"


def add_simulation_report(parser: argparse.ArgumentParser) -> None:
    """Add the options of the simulation's report."""
    parser.add_argument(
        "--out",
        default=DEFAULT_SIMULATION_REPORT,
        metavar="DIR",
        help=f"folder, made where missing (default: {DEFAULT_SIMULATION_REPORT})",
    )
    parser.add_argument("--quick", action="store_true", help="few steps and stiffnesses, for a first look")
