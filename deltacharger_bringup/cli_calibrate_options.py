"""The options of `deltacharger calibrate`; what they do stands in cli_calibrate*.py and cli_measure.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli_types import SEED, between, whole


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
