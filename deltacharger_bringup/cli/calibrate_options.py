# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger calibrate`; what they do stands in cli_calibrate*.py, cli_measure, cli_take_views."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.types import SEED, between, whole


def add_kinematics(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate kinematics`."""
    parser.add_argument("data", nargs="?", metavar="DATA.csv", help="measured poses, see docs/calibration.md")
    parser.add_argument("--out", metavar="FILE", help="write the fitted geometry, for the parameter geometry_file")
    parser.add_argument("--nominal", metavar="FILE", help="geometry to start from (default: the built-in one)")
    parser.add_argument("--plan", metavar="FILE", help="write the poses to measure; with --measure, read them")
    parser.add_argument("--measure", metavar="FILE", help="go to the poses of --plan, ask what was measured, record it")
    parser.add_argument("--force", action="store_true", help="overwrite files, and write a doubtful geometry")
    known = parser.add_argument_group("what is known beforehand, as standard deviations")
    known.add_argument(
        "--measurement-mm", type=between(1e-6, 10.0), default=0.05, metavar="MM", help="of a coordinate (0.05)"
    )
    known.add_argument("--tolerance-mm", type=between(1e-6, 20.0), default=0.5, metavar="MM", help="of lengths (0.5)")
    known.add_argument("--tolerance-deg", type=between(1e-6, 30.0), default=1.0, metavar="DEG", help="of angles (1)")
    judged = parser.add_argument_group("rows that the fit does not see, where the file has no column held_out")
    judged.add_argument(
        "--held-out", type=between(0.01, 0.9), default=0.25, metavar="SHARE", help="share of the rows (0.25)"
    )
    judged.add_argument("--seed", type=SEED, default=0, metavar="N", help="of their draw (0)")
    encoder = parser.add_argument_group("angle = direction · (ticks − zero_ticks) · 2π/4096, as in servo_node")
    most = 1_048_575
    encoder.add_argument(
        "--zero-ticks", type=whole(-most, most), nargs=3, metavar="N", help="per limb (as the file says, or 2048)"
    )
    encoder.add_argument("--direction", type=whole(-1, 1), nargs=3, metavar="N", help="per limb (1)")


def add_tactile_calibration(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate tactile`."""
    parser.add_argument("--data", required=True, metavar="F.npz", help="dockings at known poses, of `tactile record`")
    parser.add_argument("--out", required=True, metavar="FILE", help="where to write it, for misalignment_node")
    parser.add_argument("--rig", type=whole(0, 2**31 - 1), metavar="N", help="which, where the data hold several")
    parser.add_argument("--model", metavar="M.npz", help="pose model that it is for (default: the packaged one)")
    parser.add_argument("--force", action="store_true", help="overwrite FILE, and write what makes estimates worse")


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate camera`."""
    parser.add_argument("--views", metavar="FOLDER", help="images and views.csv, see docs/camera-calibration.md")
    parser.add_argument("--print", metavar="FILE.svg", help="only draw the board in true size, for a printer")
    parser.add_argument("--out", metavar="FILE", help="write the mount, for the parameter mount_file")
    parser.add_argument("--camera-info", metavar="K.yaml", help="intrinsics (FOLDER/camera_info.yaml)")
    parser.add_argument("--geometry", metavar="FILE", help="of the arm, as calibrated (default: the built-in one)")
    text = "believed so far, to compare with and to know where the camera sees the board (the usual one)"
    parser.add_argument("--mount", metavar="FILE", help=text)
    parser.add_argument("--force", action="store_true", help="overwrite FILE, and write a doubtful mount")
    board = parser.add_argument_group("the board on the platform")
    text = "apriltag:FAMILY:NUMBER or charuco:DICTIONARY:COLUMNSxROWS (apriltag:36h11:0)"
    board.add_argument("--board", default="apriltag:36h11:0", metavar="NAME", help=text)
    text = "side of the tag's black square, or of a chessboard square (40)"
    board.add_argument("--size-mm", type=between(2.0, 1000.0), default=40.0, metavar="MM", help=text)
    text = "side of a marker on a ChArUco board (three quarters of a square)"
    board.add_argument("--marker-mm", type=between(1.0, 1000.0), metavar="MM", help=text)
    for axis in "xyz":
        text = f"its centre along {axis} of end_effector, measured"
        board.add_argument(f"--board-{axis}-mm", type=between(-500.0, 500.0), metavar="MM", help=text)
    known = parser.add_argument_group("what is known beforehand, as standard deviations")
    text = "of the board's measured centre, each direction (0.5)"
    known.add_argument("--board-stddev-mm", type=between(0.0, 50.0), default=0.5, metavar="MM", help=text)
    text = "of each arm angle's constant error (0.1)"
    known.add_argument("--joint-stddev-deg", type=between(0.0, 10.0), default=0.1, metavar="DEG", help=text)
    text = "scatter of the platform's position, corrected by the images (0.1)"
    known.add_argument("--arm-stddev-mm", type=between(0.001, 50.0), default=0.1, metavar="MM", help=text)
    text = "every so many-th image judges a fit to the others (5)"
    parser.add_argument("--held-out-every", type=whole(2, 1000), default=5, metavar="N", help=text)
    live = parser.add_argument_group("with a running charger")
    live.add_argument("--take", type=whole(5, 500), metavar="N", help="first fill FOLDER up to N views; 20 are good")
    text = "how far the platform goes toward the target's place (60)"
    live.add_argument("--z-max-mm", type=between(5.0, 110.0), default=60.0, metavar="MM", help=text)
    text = "of the camera; camera_info stands beside it (color/image_raw)"
    live.add_argument("--color-topic", default="color/image_raw", metavar="NAME", help=text)
