"""Options of `deltacharger report vision`."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli_types import SEED, whole

DEFAULT_REPORT = "report-vision"


def add_vision(parser: argparse.ArgumentParser) -> None:
    """Add the options of the report of the electrode detector."""
    parser.add_argument(
        "--out", default=DEFAULT_REPORT, metavar="DIR", help=f"folder, made where missing (default: {DEFAULT_REPORT})"
    )
    images = "of a usual row, 2 to 1000 (default: 150, with --quick 15); rows of targets have more"
    parser.add_argument("--images", type=whole(2, 1000), metavar="N", help=images)
    parser.add_argument("--seed", type=SEED, default=0, metavar="N", help="shifts the seeds of all images (default: 0)")
    parser.add_argument("--quick", action="store_true", help="a tenth of the images, for a first look")
