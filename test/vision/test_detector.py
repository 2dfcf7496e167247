# SPDX-License-Identifier: Apache-2.0
"""Laws of the electrode detector on simulated images."""

from __future__ import annotations

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_vision.detector.detector import DetectorSettings, ElectrodeDetector
from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import RenderedScene
from deltacharger_vision.terminal import Terminal

from ..marks import rest
from .detector_scenes import (
    clutter,
    error,
    half_hidden,
    mirrored,
    pose_at,
    quarter_turn,
    random_view,
    render,
    roll_error,
    scaled,
    without_depth,
)

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

DETECTOR = ElectrodeDetector()


@pytest.fixture(autouse=True)
def one_thread() -> None:
    import cv2

    cv2.setNumThreads(1)


@pytest.mark.rest
def test_errors_match_the_covariance() -> None:
    squares, across, along, rolls = [], [], [], []
    frames = 200
    for seed in range(frames):
        random = np.random.default_rng(20_000 + seed)
        scene, pose = random_view(random, 0.15, 0.8)
        found = DETECTOR.detect(render(scene, pose, random))
        if found is None:
            continue
        off = error(found, pose)
        squares.append(off @ np.linalg.solve(found.covariance[:3, :3], off))
        across.append(math.hypot(off[0], off[1]))
        along.append(abs(off[2]))
        rolls.append(abs(roll_error(found, pose)))
        assert math.isclose(found.range, float(np.linalg.norm(found.position)))
        assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)
    assert len(squares) >= 0.98 * frames
    assert 2.0 < np.mean(squares) < 4.5
    assert np.percentile(across, 95) < 0.001
    assert np.percentile(along, 95) < 0.002
    assert np.percentile(rolls, 95) < math.radians(1.0)


def test_detection_is_deterministic_and_does_not_change_the_image() -> None:
    random = np.random.default_rng(1)
    image = render(*random_view(random, 0.25, 0.35), random)
    color, depth = image.color.copy(), image.depth.copy()
    first, second = DETECTOR.detect(image), ElectrodeDetector().detect(image)
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.position, second.position)
    np.testing.assert_array_equal(image.color, color)
    np.testing.assert_array_equal(image.depth, depth)


@pytest.mark.parametrize("seed", range(4))
def test_the_result_turns_and_mirrors_with_the_image(seed: int) -> None:
    random = np.random.default_rng(20_300 + seed)
    image = render(*random_view(random, 0.2, 0.5), random)
    plain, turned, flipped = (DETECTOR.detect(each) for each in (image, quarter_turn(image), mirrored(image)))
    assert plain is not None
    assert turned is not None
    assert flipped is not None
    x, y, z = plain.position
    tolerance = 1e-4 + 0.5 * np.sqrt(np.trace(plain.covariance[:3, :3]))
    np.testing.assert_allclose(turned.position, [y, -x, z], atol=tolerance)
    np.testing.assert_allclose(flipped.position, [-x, y, z], atol=tolerance)
    assert abs(math.remainder(turned.roll - plain.roll + math.pi / 2, math.pi)) < 2e-3
    assert abs(math.remainder(flipped.roll + plain.roll, math.pi)) < 2e-3


@pytest.mark.parametrize("roll", [-1.5, -0.8, 0.0, 0.8, 1.5])
def test_roll_of_any_size_is_found_with_its_sign(roll: float) -> None:
    random = np.random.default_rng(3)
    pose = pose_at(0.3, roll=roll)
    found = DETECTOR.detect(render(RenderedScene(), pose, random))
    assert found is not None
    assert -math.pi / 2 < found.roll <= math.pi / 2
    assert abs(math.remainder(found.roll - roll, math.pi)) < math.radians(1.0)


def test_a_known_normal_points_to_the_camera() -> None:
    random = np.random.default_rng(4)
    pose = pose_at(0.3, pitch=0.4, yaw=-0.2)
    found = DETECTOR.detect(render(RenderedScene(), pose, random))
    assert found is not None
    assert found.source == "fused"
    assert found.normal @ -pose[:3, 2] > math.cos(math.radians(2.0))
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)


def test_clutter_without_electrodes_is_no_terminal() -> None:
    for seed in range(40):
        random = np.random.default_rng(20_400 + seed)
        image = render(clutter(random), pose_at(random.uniform(0.2, 0.8)), random)
        assert DETECTOR.detect(image) is None


def test_nothing_is_found_in_an_empty_or_unlit_picture() -> None:
    shape = (OAK_D.height, OAK_D.width)
    for level in (0, 128, 255):
        color = np.full((*shape, 3), level, dtype=np.uint8)
        assert DETECTOR.detect(RgbdImage.make(color, np.full(shape, 0.3), OAK_D)) is None


@pytest.mark.parametrize("scale", [0.75, 1.3])
def test_bars_of_another_size_are_refused_by_depth(scale: float) -> None:
    refused = 0
    for seed in range(8):
        random = np.random.default_rng(20_500 + seed)
        scene, pose = random_view(random, 0.28, 0.6)
        other = dataclasses.replace(scene, terminal=scaled(Terminal(), scale))
        image = render(other, pose, random)
        assert DETECTOR.detect(image) is None
        # With the right size they are found, so only the size was refused.
        refused += ElectrodeDetector(scaled(Terminal(), scale)).detect(image) is not None
    assert refused >= 7


@pytest.mark.parametrize(("bar", "end"), [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
def test_half_of_a_bar_may_be_hidden(bar: float, end: float) -> None:
    found = 0
    for seed in range(5):
        random = np.random.default_rng(20_600 + seed)
        scene, pose = random_view(random, 0.25, 0.55)
        detection = DETECTOR.detect(render(half_hidden(scene, bar, end), pose, random))
        if detection is None:
            continue
        found += 1
        assert np.linalg.norm(error(detection, pose)) < 0.003
        assert detection.confidence < 0.95
    assert found >= 4


def test_below_the_stereo_range_the_image_alone_gives_the_pose() -> None:
    random = np.random.default_rng(5)
    pose = pose_at(0.15, roll=0.1, pitch=0.3)
    found = DETECTOR.detect(render(RenderedScene(), pose, random))
    assert found is not None
    assert found.source == "pnp"
    assert np.linalg.norm(error(found, pose)) < 0.002


def test_noisy_depth_below_the_stereo_range_is_ignored() -> None:
    random = np.random.default_rng(5)
    pose = pose_at(0.15, roll=0.1, pitch=0.3)
    image = render(RenderedScene(), pose, random)
    noise = random.uniform(0.174, 2.0, image.depth.shape).astype(np.float32)
    found = DETECTOR.detect(RgbdImage(image.color, noise, image.intrinsics))
    assert found is not None
    assert found.source == "pnp"
    assert np.linalg.norm(error(found, pose)) < 0.002


def test_a_plane_that_contradicts_the_image_is_refused_at_any_range() -> None:
    for away in (0.15, 0.3):
        random = np.random.default_rng(5)
        image = render(RenderedScene(), pose_at(away, roll=0.1, pitch=0.3), random)
        assert DETECTOR.detect(RgbdImage(image.color, np.full_like(image.depth, 0.9), image.intrinsics)) is None


def test_without_depth_the_covariance_grows_and_holds() -> None:
    squares = []
    for seed in range(30):
        random = np.random.default_rng(20_700 + seed)
        scene, pose = random_view(random, 0.2, 0.5)
        image = render(scene, pose, random)
        both, alone = DETECTOR.detect(image), DETECTOR.detect(without_depth(image))
        if both is None or alone is None:
            continue
        assert alone.source == "pnp"
        assert alone.covariance[2, 2] > both.covariance[2, 2]
        off = error(alone, pose)
        squares.append(off @ np.linalg.solve(alone.covariance[:3, :3], off))
    assert len(squares) >= 27
    assert np.median(squares) < 5.0


def test_lens_distortion_is_corrected() -> None:
    lens = Intrinsics(640, 400, 441.0, 441.0, 322.0, 197.0, (-0.25, 0.08, 0.001, -0.001, 0.0))
    camera = SimulatedCamera(lens)
    pose = pose_at(0.3, roll=0.2, x=0.35, y=0.15)
    random = np.random.default_rng(6)
    image = camera.render(RenderedScene(), pose, random)
    found = DETECTOR.detect(image)
    assert found is not None
    assert np.linalg.norm(error(found, pose)) < 0.001
    straight = dataclasses.replace(lens, distortion=())
    ignored = DETECTOR.detect(RgbdImage(image.color, image.depth, straight))
    assert ignored is None or np.linalg.norm(error(ignored, pose)) > 0.002


@pytest.mark.parametrize(
    "distortion",
    [
        (-0.3, 0.12, 0.001, -0.0005, -0.02),
        (-0.1, 0.01, 0.0, 0.0, 0.0),
        (6.5, -3.1, 0.0004, -0.0003, 0.9, 6.7, -2.4, 0.6),
    ],
)
def test_lens_distortion_hides_no_sides_of_the_bars(distortion: tuple[float, ...]) -> None:
    camera = SimulatedCamera(dataclasses.replace(OAK_D, distortion=distortion))
    for seed in range(12):
        random = np.random.default_rng(seed)
        scene, pose = random_view(random, 0.2, 0.35)
        found = DETECTOR.detect(render(scene, pose, random, camera))
        assert found is not None, seed
        assert np.linalg.norm(error(found, pose)) < 0.001


@pytest.mark.parametrize("percent", [-2.0, rest(-1.0), rest(1.0), 2.0])
def test_depth_corrects_a_slightly_wrong_focal_length(percent: float) -> None:
    factor = 1.0 + percent / 100.0
    wrong_lens = dataclasses.replace(OAK_D, fx=OAK_D.fx * factor, fy=OAK_D.fy * factor)
    errors = []
    for seed in range(12):
        random = np.random.default_rng(seed)
        scene, pose = random_view(random, 0.2, 0.35)
        image = render(scene, pose, random)
        found = DETECTOR.detect(RgbdImage(image.color, image.depth, wrong_lens))
        if found is not None:
            errors.append(float(np.linalg.norm(error(found, pose))))
    assert len(errors) >= 11
    assert np.median(errors) < 0.0005  # the image alone would be off by 1 % of the range: 2–3.5 mm
    assert max(errors) < 0.005


def test_wide_lens_may_show_the_terminal_at_the_border() -> None:
    lens = Intrinsics(640, 400, 400.0, 400.0, 319.5, 199.5, (-0.30, 0.12, 0.001, -0.0005, -0.02))
    camera = SimulatedCamera(lens)
    for seed in range(6):
        random = np.random.default_rng(20_900 + seed)
        pose = pose_at(0.25, roll=random.uniform(-0.5, 0.5), x=random.uniform(0.6, 0.9), y=random.uniform(-0.5, 0.5))
        found = DETECTOR.detect(camera.render(RenderedScene(), pose, random))
        assert found is None or np.linalg.norm(error(found, pose)) < 0.003


def test_a_lens_that_folds_the_image_is_refused() -> None:
    lens = Intrinsics(640, 400, 300.0, 300.0, 319.5, 199.5, (-2.0, 0.0, 0.0, 0.0, 0.0))
    color = np.zeros((400, 640, 3), dtype=np.uint8)
    with pytest.raises(CameraInfoError, match="calibrate"):
        DETECTOR.detect(RgbdImage.make(color, np.full((400, 640), 0.3), lens))


def test_a_terminal_partly_outside_the_image_is_right_or_none() -> None:
    for seed, x in enumerate(np.linspace(0.55, 0.8, 8)):
        random = np.random.default_rng(20_800 + seed)
        pose = pose_at(0.3, x=float(x))
        found = DETECTOR.detect(render(RenderedScene(), pose, random))
        assert found is None or np.linalg.norm(error(found, pose)) < 0.003


def test_settings_out_of_bounds_are_refused_by_name() -> None:
    with pytest.raises(ParameterError, match="smoothing"):
        DetectorSettings(smoothing=-1.0)


def test_importing_the_detector_does_not_load_opencv() -> None:
    script = (
        "import sys, deltacharger_vision, deltacharger_vision.detector.detector, deltacharger_vision.detector.annotate;"
        "sys.exit('cv2' in sys.modules or 'rclpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
