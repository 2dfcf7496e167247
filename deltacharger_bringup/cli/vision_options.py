# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger vision`; what they do stands in cli_vision.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command

MODULE = "deltacharger_bringup.cli.vision"


def add_vision(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions of `vision`."""
    text = "find a terminal's electrodes in one image, in a folder of images or in a recording"
    detect = add_command(actions, "detect", (MODULE, "detect"), text)
    detect.add_argument(
        "path",
        nargs="?",
        metavar="FOLDER|REC.mcap",
        help="images NAME.color.png and NAME.depth.png (or color/NAME.png and depth/NAME.png), or a recording",
    )
    one = detect.add_argument_group("one image")
    one.add_argument("--color", metavar="A.png", help="PNG or JPEG")
    one.add_argument("--depth", metavar="A.png|A.npy", help="aligned to it: 16-bit mm, or float m (default: none)")
    one.add_argument("--picture", metavar="OUT.png", help="draw what was found into a copy of the image")
    many = detect.add_argument_group("a folder or a recording")
    many.add_argument("--pictures", metavar="DIR", help="the same for every image, into a folder")
    many.add_argument("--color-topic", default="", metavar="NAME", help="(the one that ends in color/image_raw)")
    many.add_argument("--depth-topic", default="", metavar="NAME", help="(depth/image_raw of the same camera)")
    many.add_argument("--info-topic", default="", metavar="NAME", help="(camera_info beside the colour)")
    detect.add_argument(
        "--camera-info",
        metavar="K.yaml",
        help="intrinsics of the colour image (folder: its camera_info.yaml; recording: its own)",
    )
    detect.add_argument("--terminal", metavar="T.yaml", help="size of the bars (default: 70 × 10 mm, 7.4 mm apart)")
    detect.add_argument("--mount", metavar="MOUNT.yaml", help="tell the pose in charger_base too")
