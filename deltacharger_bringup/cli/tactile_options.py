# SPDX-License-Identifier: Apache-2.0
"""The options of `deltacharger tactile`; what they do stands in cli_tactile.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli.parser import add_command
from deltacharger_bringup.cli.types import MILLIMETRES, SEED, between, namespace, whole

MODULE = "deltacharger_bringup.cli.tactile"
MODELS = ("logistic", "svm", "knn", "tree", "gbdt", "forest", "xgboost", "nn", "cnn", "lda", "pose")
TARGETS = ("angle", "vertical", "horizontal", "pose")
SETS = ("position", "angle", "reference", "sweep")
DEFAULT_COMPARISON = "report-tactile"


def add_tactile(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions of `tactile`."""
    generate = add_command(actions, "generate", (MODULE, "generate"), "write a simulated data set")
    generate.add_argument(
        "--protocol", choices=("paper", "continuous"), default="paper", help="the paper's two sets, or signed poses"
    )
    generate.add_argument("--rigs", type=whole(1, 1000), default=5, metavar="N", help="simulated devices (5)")
    generate.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the dockings (0)")
    generate.add_argument("--out", required=True, metavar="F.npz", help="where to write it")
    generate.add_argument("--first-rig", type=whole(0, 10**9), default=0, metavar="N", help="seed of the first one (0)")
    generate.add_argument("--frames", type=whole(1, 240), default=1, metavar="N", help="averaged in each row (1)")
    generate.add_argument("--rows", type=whole(1, 240), default=1, metavar="N", help="of each docking (1)")
    generate.add_argument(
        "--threshold", type=between(0.0, 9.0), metavar="N", help="less counts as 0 (paper 1 as there, continuous 0.25)"
    )
    generate.add_argument(
        "--dockings", type=whole(1, 100_000), metavar="N", help="of the continuous protocol on each device (400)"
    )
    _add_record(actions)
    train = add_command(actions, "train", (MODULE, "train"), "train a classifier")
    train.add_argument("--data", required=True, metavar="F.npz", help="of `generate`")
    train.add_argument("--model", required=True, choices=MODELS, help="what to train")
    train.add_argument("--target", required=True, choices=TARGETS, help="what it shall tell")
    train.add_argument("--out", required=True, metavar="M.npz", help="where to write it")
    train.add_argument("--seed", type=SEED, default=0, metavar="N", help="of whatever is random (0)")
    train.add_argument(
        "--reference", metavar="R.npz", help="dockings that show what one device constantly does (lda, pose)"
    )
    evaluate = add_command(actions, "evaluate", (MODULE, "evaluate"), "judge a trained classifier")
    evaluate.add_argument("--data", required=True, metavar="F.npz", help="that it was not trained with")
    evaluate.add_argument("--model", required=True, metavar="M.npz", help="of `train`")
    text = "compare all models on simulated data, the same as `report tactile`"
    add_comparison(add_command(actions, "compare", ("deltacharger_bringup.cli.report", "tactile"), text))


def add_comparison(parser: argparse.ArgumentParser) -> None:
    """Add the options of the comparison of all models."""
    parser.add_argument("--out", default=DEFAULT_COMPARISON, metavar="DIR", help=f"folder ({DEFAULT_COMPARISON})")
    parser.add_argument("--seed", type=SEED, default=1, metavar="N", help="of the dockings (1)")
    parser.add_argument("--quick", action="store_true", help="one rig and few models, for a first look")


def _add_record(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    text = "dock the running charger at known offsets and record what the pads feel; the same call goes on"
    record = add_command(actions, "record", ("deltacharger_bringup.cli.tactile_record", "record"), text)
    record.add_argument("--out", required=True, metavar="F.npz", help="data set, made from the folder F.recording")
    record.add_argument("--set", choices=SETS, help="the paper's two, dockings at zero, or random offsets up to 12 mm")
    record.add_argument("--angle-deg", type=between(-20.0, 20.0), metavar="DEG", help="of the target (angle and sweep)")
    record.add_argument(
        "--repeat",
        type=whole(1, 10_000),
        metavar="N",
        help="at each offset (position: 20), in all (angle: 100, reference: 10, sweep: 100)",
    )
    record.add_argument(
        "--offsets-mm",
        type=between(-20.0, 20.0),
        nargs="+",
        metavar="MM",
        help="of position (-10 -5 0 5 10)",
    )
    record.add_argument("--seed", type=SEED, default=0, metavar="N", help="of order and random offsets (0)")
    record.add_argument("--compose", action="store_true", help="only write F.npz from what was recorded")
    record.add_argument("--namespace", type=namespace, default="", metavar="NAME", help="of the charger (none)")
    target = record.add_argument_group("where the target's electrodes stand, in charger_base")
    for axis, default in (("x", 0.0), ("y", 0.0), ("z", 80.0)):
        target.add_argument(f"--{axis}-mm", type=MILLIMETRES, default=default, metavar="MM", help=f"({default:g})")
    felt = record.add_argument_group("of the whole file")
    felt.add_argument("--rig", type=whole(0, 2**31 - 1), default=0, metavar="N", help="number of this charger (0)")
    felt.add_argument("--sensor", default="", metavar="ID", help="of its pads, for the record")
    felt.add_argument("--frames", type=whole(1, 240), default=1, metavar="N", help="averaged in each row (1)")
    felt.add_argument("--rows", type=whole(1, 240), default=1, metavar="N", help="of each docking (1)")
    felt.add_argument("--threshold", type=between(0.0, 9.0), default=0.25, metavar="N", help="less counts as 0 (0.25)")
    felt.add_argument("--dwell-s", type=between(0.0, 60.0), default=0.5, metavar="S", help="rest before them (0.5)")
    record.add_argument(
        "--tare-every",
        type=whole(1, 10_000),
        default=25,
        metavar="N",
        help="dockings after a tare, a session (25)",
    )
