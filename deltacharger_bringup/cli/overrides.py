# SPDX-License-Identifier: Apache-2.0
"""The options that change a scene for one run; what they do stands in scene_overrides.py."""

from __future__ import annotations

import argparse


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add them to a command that starts a scene; the values are judged with the scene."""
    parser.add_argument("--servo-port", default="", metavar="PORT", help="of the servos, instead of the scene's")
    parser.add_argument("--board-port", default="", metavar="PORT", help="of the board, instead of the scene's")
    text = "what finds electrodes, instead of the scene's: an OAK-D, a camera that others drive, or nothing"
    parser.add_argument("--camera", default="", metavar="oak|topics|none", help=text)
    parser.add_argument("--model", default="", metavar="FILE", help="pose model (npz) of misalignment_node")
