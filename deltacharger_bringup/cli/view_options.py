# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger view`; what they do stands in cli_view.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command
from deltacharger_bringup.cli.types import POSITIVE


def add_view(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> argparse.ArgumentParser:
    """Add the command `view` and return its parser."""
    text = "show a running charger or a recording of one: mechanism, camera, pads, currents, states, decisions"
    parser = add_command(commands, "view", ("deltacharger_bringup.cli.view", "view"), text)
    parser.add_argument("--recording", metavar="FILE.mcap", help="show this instead of a running charger")
    parser.add_argument(
        "--scene", metavar="NAME|FILE", help="whose geometry and camera mount are drawn (default: the usual ones)"
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--save", metavar="FILE.rrd", help="write a file for later instead of opening a window")
    where.add_argument("--connect", metavar="URL", help="show it in a viewer that runs, rerun+http://HOST:9876/proxy")
    parser.add_argument("--camera", action="store_true", help="the camera's image too, at 5 Hz; it is taken for it")
    parser.add_argument(
        "--stop-after-s", type=POSITIVE, default=0.0, metavar="S", help="of a running charger (default: at Ctrl-C)"
    )
    return parser
