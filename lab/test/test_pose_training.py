# SPDX-License-Identifier: Apache-2.0
"""Training of the pose estimator: what it needs, and its files."""

import math
from pathlib import Path

import numpy as np
import pytest

from deltacharger_lab.training.estimator import TrainablePoseEstimator
from deltacharger_lab.training.pose import train
from deltacharger_sim.pads import generate_continuous
from deltacharger_tactile import PoseEstimator
from deltacharger_tactile.errors import ModelError


@pytest.mark.rest
def test_training_needs_different_dockings_in_range_on_both_pads_and_on_one() -> None:
    random = np.random.default_rng(0)
    frames = 3.0 + random.random((1200, 2, 10, 10))
    poses = random.uniform(-0.01, 0.01, (1200, 3))
    for useless, pose, found in (
        (0.0 * frames, poses, "0 different dockings on both pads"),
        (np.repeat(frames[:1], 1200, axis=0), poses, "1 different dockings on both pads"),
        (frames, poses + 0.03, "0 different dockings on both pads, in range"),
        (frames, poses, "0 different dockings on one pad"),
    ):
        with pytest.raises(ModelError, match=f"{found}.* at least 512"):
            TrainablePoseEstimator().fit(useless, pose, (useless, pose))


def test_training_saving_and_loading(tmp_path: Path) -> None:
    model = train(range(600, 606), range(610, 613), 200, 5, 2)
    model.save(tmp_path / "model.npz")
    loaded = PoseEstimator.load(tmp_path / "model.npz")
    data = generate_continuous(None, (360,), 50, 2, 12, 0.0, 0.004, math.radians(8.0))
    left, right = data.robot_frames()
    before, after = model.predict(left, right), loaded.predict(left, right)
    for name, value in vars(before).items():
        assert np.allclose(value, getattr(after, name), equal_nan=True), name
    assert loaded.about == model.about
    TrainablePoseEstimator.load(tmp_path / "model.npz").save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "model.npz").read_bytes()
