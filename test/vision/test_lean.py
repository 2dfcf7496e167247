# SPDX-License-Identifier: Apache-2.0
"""Laws of the detector's lean of the plate: errors match their uncertainty, and steps of depth do not bias it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.detector.plane import Plane, PlaneSettings, Region, fit_plane
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.scene import RenderedScene

from .detector_scenes import pose_at, random_view, render, without_depth

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

DETECTOR = ElectrodeDetector()


def lean_errors(seeds: range, nearest: float, farthest: float) -> np.ndarray:
    """Errors of yaw and pitch (N, 2) in charger_base over their standard deviations, with an exact mount."""
    mount = Mount(Mount.default().pose, np.zeros((6, 6)))
    found = []
    for seed in seeds:
        random = np.random.default_rng(seed)
        scene, pose = random_view(random, nearest, farthest)
        detection = DETECTOR.detect(render(scene, pose, random))
        if detection is None or detection.source != "fused":
            continue
        lean, (x, y, z) = mount.place(detection).lean(), mount.pose[:3, :3] @ pose[:3, 2]
        yaw, pitch = lean.yaw - math.atan2(x, z), lean.pitch - math.atan2(-y, z)
        found.append([yaw / lean.yaw_stddev, pitch / lean.pitch_stddev])
    return np.array(found)


@pytest.mark.rest
@pytest.mark.parametrize(("nearest", "farthest"), [(0.18, 0.22), (0.22, 0.28), (0.28, 0.35), (0.35, 0.7)])
def test_errors_of_the_lean_match_its_uncertainty(nearest: float, farthest: float) -> None:
    sigmas = lean_errors(range(21_000, 21_200), nearest, farthest)
    assert len(sigmas) >= 150
    assert np.all(np.sqrt(np.mean(sigmas**2, axis=0)) > 0.7)
    assert np.all(np.sqrt(np.mean(sigmas**2, axis=0)) < 1.25)
    assert np.all(np.mean(np.abs(sigmas) < 1.96, axis=0) > 0.9)


def test_errors_of_a_few_leans_stay_within_their_uncertainty() -> None:
    sigmas = lean_errors(range(21_200, 21_230), 0.2, 0.35)
    assert len(sigmas) >= 27
    assert np.abs(sigmas).max() < 4.0
    assert np.all(np.sqrt(np.mean(sigmas**2, axis=0)) > 0.5)


def test_without_expected_depth_no_normal_is_reported() -> None:
    random = np.random.default_rng(4)
    image = render(RenderedScene(), pose_at(0.3, pitch=0.4, yaw=-0.2), random)
    found = DETECTOR.detect(without_depth(image))
    assert found is not None
    assert np.isnan(found.normal).all()
    near = DETECTOR.detect(render(RenderedScene(), pose_at(0.15, pitch=0.3), random))
    assert near is not None
    assert near.source == "pnp"
    assert np.isfinite(near.normal).all(), "stereo has no depth there"


def fitted(away: float, lean: float, seed: int) -> Plane:
    """Plane of a plate 9 cm wide, yawed in front of a camera whose depth has 0.2 mm of noise and whole millimetres."""
    random = np.random.default_rng(seed)
    ray = np.ones((1500, 3))
    ray[:, :2] = random.uniform(-0.045 / away, 0.045 / away, size=(1500, 2))
    normal = np.array([math.sin(lean), 0.0, math.cos(lean)])
    depth = (away + random.uniform(-5e-4, 5e-4)) * normal[2] / (ray @ normal) + random.normal(scale=2e-4, size=1500)
    region = Region(ray, 1.0 / (1e-3 * np.round(1e3 * depth)), np.arange(1500) // 64, 1.0)
    plane = fit_plane(region, PlaneSettings(), random)
    assert plane is not None
    return plane


@pytest.mark.parametrize("lean", [0.002, 0.006, 0.012, 0.02, 0.03])
@pytest.mark.parametrize("away", [0.18, 0.23, 0.35])
def test_rounded_depth_does_not_pull_the_plane_onto_one_step(away: float, lean: float) -> None:
    for seed in range(10):
        plane = fitted(away, lean, seed)
        slope = plane.coefficients[:2] * away - [lean, 0.0]
        stddev = away * np.sqrt(np.diag(np.linalg.inv(plane.precision))[:2])
        assert np.all(np.abs(slope) < 3.0 * stddev)
        # Below about two steps of depth over the plate the lean is hardly visible.
        assert np.abs(slope).max() < (0.003 if lean >= 0.02 else 0.010)
