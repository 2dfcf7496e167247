# SPDX-License-Identifier: Apache-2.0
"""Tactile perception: contact model, sensor, data sets, features and the pose estimator."""

from __future__ import annotations

from pathlib import Path

from deltacharger_tactile.estimate import Estimate
from deltacharger_tactile.estimator import PoseEstimator

__all__ = ["MODEL_PATH", "Estimate", "PoseEstimator", "default_model"]

MODEL_PATH = Path(__file__).parent / "models" / "pose.npz"
"""The packaged model."""


def default_model() -> PoseEstimator:
    """Load the packaged model; `python -m deltacharger_tactile.training` makes it."""
    return PoseEstimator.load(MODEL_PATH)
