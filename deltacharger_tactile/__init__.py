# SPDX-License-Identifier: Apache-2.0
"""Tactile perception: contact model, sensor, data sets, features and the pose estimator."""

from __future__ import annotations

from pathlib import Path

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_tactile.estimate import Estimate
from deltacharger_tactile.estimator import THRESHOLD, PoseEstimator

__all__ = ["MODELS", "MODEL_PATH", "MODEL_PATHS", "Estimate", "PoseEstimator", "default_model", "model_path"]

MODELS = Path(__file__).parent / "models"
"""Folder of everything packaged that was trained."""
MODEL_PATHS = {THRESHOLD: MODELS / "pose.npz", CONTACT_FORCE: MODELS / "pose_1N.npz"}
"""The packaged models by the least reading that they see, N; the second is for a sensor as the paper's."""
MODEL_PATH = MODEL_PATHS[THRESHOLD]
"""The packaged model that the robot uses."""


def default_model(threshold: float = THRESHOLD) -> PoseEstimator:
    """Load the packaged model for readings from `threshold` (N) on; `deltacharger_tactile.training` makes it."""
    return PoseEstimator.load(model_path(threshold))


def model_path(threshold: float) -> Path:
    """Return the file of the packaged model for readings from `threshold` (N) on."""
    return MODEL_PATHS[CONTACT_FORCE if threshold >= CONTACT_FORCE else THRESHOLD]
