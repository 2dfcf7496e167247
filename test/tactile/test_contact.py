# SPDX-License-Identifier: Apache-2.0
"""Laws of the contact model: no force is lost, symmetry, signs, misses."""

from __future__ import annotations

import numpy as np
import pytest

from deltacharger_tactile.contact import ContactModel, Waviness
from deltacharger_tactile.parameters import PadContactParameters

MODEL = ContactModel()
V = 1.2e-3 * (9 - 2 * np.arange(10))  # taxel centres, row 0 at +y
U = V  # column 0 at +x


def poses(count: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    return random.uniform([-0.012, -0.012, -0.35], [0.012, 0.012, 0.35], (count, 3))


def centre(pad: np.ndarray, axis: int) -> float:
    line = pad.sum(axis=1 - axis)
    return float(line @ V / line.sum())


def test_the_pads_carry_the_entire_force() -> None:
    force = np.linspace(5.0, 120.0, 200)
    contact = MODEL.solve(poses(200), force, (0.001, 0.002))
    assert np.array_equal(contact.touching, contact.taxels.sum(axis=(1, 2, 3)) > 0)
    assert np.allclose(contact.taxels.sum(axis=(1, 2, 3))[contact.touching], force[contact.touching], rtol=1e-6)
    assert contact.touching.mean() > 0.8
    assert contact.taxels.min() >= 0.0


def test_a_batch_equals_its_single_contacts() -> None:
    many = poses(20, 3)
    ridges = Waviness.draw(PadContactParameters(), np.random.default_rng(1))
    batch = MODEL.solve(many, 60.0, (0.0005, -0.001), ridges)
    for index, pose in enumerate(many):
        one = MODEL.solve(pose, 60.0, (0.0005, -0.001), ridges)
        assert np.allclose(batch.taxels[index], one.taxels[0], atol=1e-9)


def test_mirroring_the_pose_mirrors_the_pads() -> None:
    many, tilt = poses(50, 1), np.array([0.0007, -0.0011])
    straight = MODEL.solve(many, 60.0, tilt).taxels
    over_y = MODEL.solve(many * [1, -1, -1], 60.0, tilt * [-1, 1]).taxels
    assert np.allclose(over_y, straight[:, :, ::-1, :], atol=1e-9)
    over_x = MODEL.solve(many * [-1, 1, -1], 60.0, tilt * [1, -1]).taxels
    assert np.allclose(over_x, straight[:, ::-1, :, ::-1], atol=1e-9)


def test_signs_follow_the_target() -> None:
    """The pads read pressure where trigonometry puts the ridge's points."""
    up = MODEL.solve((0.0, 0.005, 0.0), 60.0).taxels[0]
    assert [centre(pad, 0) for pad in up] == pytest.approx([0.005] * 2, abs=4e-4)  # higher on both pads
    angle = np.radians(6.0)
    turned = MODEL.solve((0.0, 0.0, angle), 60.0).taxels[0]
    # A turn from +x to +y lifts the target's ridge at +x (left pad) and lowers the one at −x (right pad).
    rise = 0.048 * np.tan(angle)
    assert [centre(pad, 0) for pad in turned] == pytest.approx([rise, -rise], abs=5e-4)
    # Within a pad the ridge rises toward +x, which is toward column 0.
    assert centre(turned[0][:, :3], 0) > centre(turned[0][:, 7:], 0) + 1e-3
    # A target far to +x leaves the −x end of the left pad.
    assert centre(MODEL.solve((0.016, 0.0, 0.0), 60.0).taxels[0, 0], 1) > 1e-3
    # Tilts press the sides that the docstring states.
    tilted = MODEL.solve((0.0, 0.0, 0.0), 60.0, (0.0, 0.001)).taxels[0]
    assert tilted[0].sum() > tilted[1].sum() + 5.0
    assert centre(MODEL.solve((0.0, 0.0, 0.0), 60.0, (0.005, 0.0)).taxels[0, 0], 0) > 1e-5


def test_a_missed_ridge_exerts_no_force() -> None:
    both = MODEL.solve((0.0, 0.020, 0.0), 60.0)
    assert not both.touching[0]
    assert not both.taxels.any()
    assert np.isnan(both.approach[0])
    one = MODEL.solve((0.0, 0.012, np.radians(12.0)), 60.0).taxels[0]
    assert not one[0].any()
    assert one[1].sum() == pytest.approx(60.0)
    assert not MODEL.solve((0.0, 0.0, 0.0), 0.0).taxels.any()
