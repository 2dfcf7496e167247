"""The options of `deltacharger tactile`; what they do stands in cli_tactile.py."""

from __future__ import annotations

import argparse

from deltacharger_bringup.cli_parser import add_command
from deltacharger_bringup.cli_types import SEED, whole

MODULE = "deltacharger_bringup.cli_tactile"
MODELS = ("logistic", "svm", "knn", "tree", "gbdt", "forest", "xgboost", "nn", "cnn", "lda")
TARGETS = ("angle", "vertical", "horizontal")


def add_tactile(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the actions of `tactile`."""
    generate = add_command(actions, "generate", (MODULE, "generate"), "write a simulated data set")
    generate.add_argument(
        "--protocol", choices=("paper", "continuous"), default="paper", help="the paper's two sets, or signed poses"
    )
    generate.add_argument("--rigs", type=whole(1, 1000), default=5, metavar="N", help="simulated devices (5)")
    generate.add_argument("--seed", type=SEED, default=0, metavar="N", help="of the dockings (0)")
    generate.add_argument("--out", required=True, metavar="F.npz", help="where to write it")
    continuous = generate.add_argument_group("of the continuous protocol")
    continuous.add_argument("--dockings", type=whole(1, 100_000), default=400, metavar="N", help="on each device (400)")
    continuous.add_argument("--frames", type=whole(1, 240), default=1, metavar="N", help="averaged in each docking (1)")
    train = add_command(actions, "train", (MODULE, "train"), "train a classifier")
    train.add_argument("--data", required=True, metavar="F.npz", help="of `generate`")
    train.add_argument("--model", required=True, choices=MODELS, help="what to train")
    train.add_argument("--target", required=True, choices=TARGETS, help="what it shall tell")
    train.add_argument("--out", required=True, metavar="M.npz", help="where to write it")
    train.add_argument("--seed", type=SEED, default=0, metavar="N", help="of whatever is random (0)")
    evaluate = add_command(actions, "evaluate", (MODULE, "evaluate"), "judge a trained classifier")
    evaluate.add_argument("--data", required=True, metavar="F.npz", help="that it was not trained with")
    evaluate.add_argument("--model", required=True, metavar="M.npz", help="of `train`")
