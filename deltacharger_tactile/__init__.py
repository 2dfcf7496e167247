# SPDX-License-Identifier: Apache-2.0
"""Taxels to misalignment: the pose estimator, the nine classifiers of the paper, calibration of the pads."""

from pathlib import Path

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_tactile.estimator import THRESHOLD, Estimate, PoseEstimator

__all__ = ["MODELS", "MODEL_PATH", "MODEL_PATHS", "Estimate", "PoseEstimator", "default_model", "model_path"]

MODELS = Path(__file__).parent / "models"
"""Folder of the packaged trained models."""
MODEL_PATHS = {THRESHOLD: MODELS / "pose.npz", CONTACT_FORCE: MODELS / "pose_1N.npz"}
"""Packaged models by threshold, N; the second suits a sensor like the paper's."""
MODEL_PATH = MODEL_PATHS[THRESHOLD]
"""Packaged model that the robot uses."""


def default_model(threshold: float = THRESHOLD) -> PoseEstimator:
    """Load the packaged model for readings of at least `threshold` N, made by `deltacharger_lab.training.pose`."""
    return PoseEstimator.load(model_path(threshold))


def model_path(threshold: float) -> Path:
    """Return the file of the packaged model for readings of at least `threshold` N."""
    return MODEL_PATHS[CONTACT_FORCE if threshold >= CONTACT_FORCE else THRESHOLD]
