# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger simulate`, `fault` and `doctor`; what they do stands in the module of each."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.types import POSITIVE, between, whole


def add_simulate(parser: argparse.ArgumentParser) -> None:
    """Add the options of `simulate`."""
    parser.add_argument(
        "--directory", required=True, metavar="DIR", help="where the ports appear, as DIR/servo and DIR/board"
    )
    parser.add_argument("--record", metavar="FILE", help="at the end, write what really happened in the world as JSON")
    text = "end with 0 on Ctrl-C too, as nodes do, for what starts it beside them"
    parser.add_argument("--as-node", action="store_true", help=text)


def add_fault(parser: argparse.ArgumentParser) -> None:
    """Add the options of `fault`."""
    parser.add_argument("kind", nargs="?", metavar="KIND", help="what; --list names them all")
    parser.add_argument("--for-s", type=POSITIVE, default=0.0, metavar="S", help="how long (default: until --clear)")
    parser.add_argument("--amount", type=between(-1e9, 1e9), metavar="A", help="how much, in the unit of its kind")
    parser.add_argument("--servo", type=whole(1, 3), default=0, metavar="N", help="id, where it concerns one servo")
    parser.add_argument("--list", action="store_true", help="name every kind, and what goes wrong at present")
    parser.add_argument("--clear", action="store_true", help="end everything that lasts")
    parser.add_argument("--directory", metavar="DIR", help="of the ports (default: the charger of the ROS domain)")


def add_doctor(parser: argparse.ArgumentParser) -> None:
    """Add the options of `doctor`."""
    parser.add_argument("--servo-port", metavar="PORT", help="of the servos, instead of the scene's")
    parser.add_argument("--board-port", metavar="PORT", help="of the board, instead of the scene's")
    speeds = (9600, 57600, 115200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
    text = "write this speed (bit/s) to servos that speak another one, torque off; needs --servo-port"
    parser.add_argument("--set-baud", type=int, choices=speeds, metavar="BAUD", help=text)
    parser.add_argument("--ids", type=whole(0, 252), nargs="+", metavar="ID", help="of --set-baud (default: all)")
