# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger campaign`; what they do stands in cli_campaign.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command
from deltacharger_bringup.cli.types import SEED, whole

MODULE = "deltacharger_bringup.cli.campaign"
APPROACHES = ("guarded", "paper")
DEFAULT_SCENES = "default"


def add_campaign(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `campaign` and its action `compare`."""
    text = "simulate many dockings in a row, faster than real time and without ROS; the same call goes on"
    parser = add_command(commands, "campaign", (MODULE, "campaign"), text)
    parser.add_argument("-n", type=whole(1, 10_000_000), metavar="N", help="dockings (default: 100, or the list's)")
    parser.add_argument("--seed", type=SEED, default=1, metavar="S", help="of all that is drawn (1)")
    scenes = f"packaged campaign or YAML file that says what is drawn ({DEFAULT_SCENES})"
    parser.add_argument("--scenes", default=DEFAULT_SCENES, metavar="NAME|FILE", help=scenes)
    parser.add_argument("--approach", choices=APPROACHES, default="guarded", help="step rule of docking (guarded)")
    parser.add_argument("--exact", action="store_true", help="compute every tick and frame as the nodes do; slower")
    parser.add_argument("--workers", type=whole(1, 1024), metavar="K", help="processes on this computer (1)")
    parser.add_argument("--scheduler", default="", metavar="tcp://…", help="of Dask, whose workers run the dockings")
    parser.add_argument("--batch", type=whole(1, 10_000), default=0, metavar="N", help="dockings written at once")
    parser.add_argument("--out", metavar="DIR", help="folder of Parquet files, made where it is missing")
    actions = parser.add_subparsers(title="actions", metavar="ACTION")
    text = "compare two campaigns of one seed, docking by docking"
    compare = add_command(actions, "compare", (MODULE, "compare"), text)
    compare.add_argument("a", metavar="A", help="folder of the first one")
    compare.add_argument("b", metavar="B", help="folder of the other one")
    compare.add_argument("--picture", metavar="FILE", help="draw the differences")
