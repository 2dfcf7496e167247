# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger replay`, `--record` and `--recording`.

What they do stands in cli_replay.py, scene_recorder.py and scene_overrides.py.
"""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command


def add_replay(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> argparse.ArgumentParser:
    """Add `replay` and return its parser."""
    text = "say why a recorded docking ended as it did, and draw it; or list the records in a folder"
    parser = add_command(commands, "replay", ("deltacharger_bringup.cli.replay", "replay"), text)
    parser.add_argument("path", metavar="FILE|DIR", help="record, also one that was cut short, or folder of records")
    parser.add_argument("--picture", metavar="FILE", help="draw it: .png, .pdf, .svg or .jpg")
    return parser


def add_record(parser: argparse.ArgumentParser) -> None:
    """Add `--record` to a command that starts a charger."""
    text = "keep a record of each docking in this folder (without DIR: where docking_recorder_node keeps them)"
    parser.add_argument("--record", nargs="?", const="true", metavar="DIR", help=text)


def add_recording(parser: argparse.ArgumentParser) -> None:
    """Add `--recording` to a command that starts a scene."""
    parser.add_argument(
        "--recording", metavar="FILE", help="record that the scene plays (without --scene: that of scene replay)"
    )
