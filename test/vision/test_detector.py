# SPDX-License-Identifier: Apache-2.0
"""Laws of the electrode detector on simulated images: a right result, none, or one with a valid covariance."""

import dataclasses
import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_vision import images, terminal
from deltacharger_vision.detector.detector import ElectrodeDetector, annotated
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import RenderedScene, draw_scene

from ..marks import night, rest
from .views import DISTORTIONS, cover

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

Array = NDArray[np.float64]

CAMERA, DETECTOR = SimulatedCamera(), ElectrodeDetector()


def turned(axis: int, angle: float) -> Array:
    c, s = math.cos(angle), math.sin(angle)
    a, b = [(1, 2), (2, 0), (0, 1)][axis]
    result = np.eye(3)
    result[a, a], result[a, b], result[b, a], result[b, b] = c, -s, s, c
    return result


def pose_at(
    away: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0, x: float = 0.0, y: float = 0.0
) -> Array:
    """camera_T_terminal of a terminal in front of the camera: x and y as tangents of the line of sight."""
    pose = np.eye(4)
    pose[:3, :3] = turned(0, pitch) @ turned(1, yaw) @ turned(2, roll) @ np.diag([-1.0, -1.0, 1.0])
    pose[:3, 3] = away * np.array([x, y, 1.0]) / math.sqrt(1.0 + x * x + y * y)
    return pose


def random_view(random: np.random.Generator, nearest: float, farthest: float) -> tuple[RenderedScene, Array]:
    away = random.uniform(nearest, farthest)
    room = 0.3 if away > 0.22 else 0.15
    pose = pose_at(
        away,
        roll=random.uniform(-0.4, 0.4),
        pitch=random.uniform(-0.1, 0.5),
        yaw=random.normal(0.0, 0.12),
        x=random.uniform(-room, room),
        y=random.uniform(-0.5 * room, 0.5 * room),
    )
    light = (float(random.normal(0.0, 0.5)), float(random.uniform(0.0, 1.0)), float(-random.uniform(0.3, 1.0)))
    return RenderedScene(light=light), pose


class Look(NamedTuple):
    """What the detector found in an image of a terminal at a known pose."""

    found: terminal.Detection | None
    pose: Array
    image: images.RgbdImage

    @property
    def off(self) -> float:
        """Error of the position, m; NaN if nothing was found."""
        return math.nan if self.found is None else float(np.linalg.norm(error(self.found, self.pose)))


def look(pose: Array, seed: int = 5, scene: RenderedScene | None = None, camera: SimulatedCamera = CAMERA) -> Look:
    image = camera.render(scene or RenderedScene(), pose, np.random.default_rng(seed))
    return Look(DETECTOR.detect(image), pose, image)


def looks(
    seeds: Iterable[int],
    nearest: float,
    farthest: float,
    change: Callable[[RenderedScene, np.random.Generator], RenderedScene] = lambda scene, random: scene,
    camera: SimulatedCamera = CAMERA,
) -> Iterator[Look]:
    """Look at random views; `change` alters their scenes."""
    for seed in seeds:
        random = np.random.default_rng(seed)
        scene, pose = random_view(random, nearest, farthest)
        image = camera.render(change(scene, random), pose, random)
        yield Look(DETECTOR.detect(image), pose, image)


def seen_again(look: Look, **changed: Any) -> Look:
    """Detect again in the same image with other depth or intrinsics."""
    image = dataclasses.replace(look.image, **changed)
    return Look(DETECTOR.detect(image), look.pose, image)


def error(found: terminal.Detection, pose: Array) -> Array:
    return np.asarray(found.position - pose[:3, 3])


def roll_error(found: terminal.Detection, pose: Array) -> float:
    return math.remainder(found.roll - math.atan2(pose[1, 0], pose[0, 0]), math.pi)


@pytest.fixture(autouse=True)
def one_thread() -> None:
    cv2.setNumThreads(1)


def few_and(more: int, few: int = 2) -> Any:
    """Number of random views: few, and more for `make test-rest`."""
    return pytest.mark.parametrize("count", [few, rest(more)])


def sigmas(seen: Look) -> float:
    """Error of the position in standard deviations (Mahalanobis)."""
    off = error(seen.found, seen.pose)
    return math.sqrt(off @ np.linalg.solve(seen.found.covariance[:3, :3], off))


@pytest.mark.parametrize("count", [3, night(200)])
def test_errors_match_the_covariance(count: int) -> None:
    good = [each for each in looks(range(20_000, 20_000 + count), 0.15, 0.8) if each.found is not None]
    assert len(good) >= 0.98 * count
    assert (1.0 if count > 100 else 0.0) < np.mean([sigmas(each) ** 2 for each in good]) < 4.5
    errors = np.array([[*error(each.found, each.pose), roll_error(each.found, each.pose)] for each in good])
    assert np.percentile(np.hypot(errors[:, 0], errors[:, 1]), 95) < 0.001
    assert np.percentile(np.abs(errors[:, 2]), 95) < 0.005
    assert np.percentile(np.abs(errors[:, 3]), 95) < math.radians(1.0)
    for found in (each.found for each in good):
        assert math.isclose(found.range, float(np.linalg.norm(found.position)))
        assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)


@pytest.mark.parametrize(
    ("nearest", "farthest", "count"),
    [(0.2, 0.35, 3), rest(0.2, 0.35, 30), *(night(*each, 200) for each in ((0.18, 0.22), (0.22, 0.28), (0.28, 0.7)))],
)
def test_errors_of_the_lean_match_its_uncertainty(nearest: float, farthest: float, count: int) -> None:
    off = []
    for found, pose, _ in looks(range(21_000, 21_000 + count), nearest, farthest):
        if found is None or found.source != "both":
            continue
        about, turned = pose[:3, :2].T, np.cross(-pose[:3, 2], found.normal)
        off.append(about @ turned / np.sqrt(np.diag(about @ found.covariance[3:, 3:] @ about.T)))
    assert len(off) >= 0.75 * count
    assert np.abs(off).max() < 5.0
    if count >= 30:
        spread = np.sqrt(np.mean(np.square(off), axis=0))
        assert np.all(spread > 0.2)
        assert np.all(spread < 1.25)


def test_detection_is_repeatable_annotated_and_does_not_change_the_image() -> None:
    first = look(pose_at(0.3, roll=0.2, pitch=0.4, yaw=-0.2))
    found, image = first.found, first.image
    color, depth = image.color.copy(), image.depth.copy()
    second = ElectrodeDetector().detect(image)
    np.testing.assert_array_equal(found.position, second.position)
    assert found.source == "both"
    assert found.normal @ -first.pose[:3, 2] > math.cos(math.radians(2.0)), "the normal points to the camera"
    assert np.linalg.norm(found.normal) == pytest.approx(1.0)
    assert np.any(annotated(image, found) != color)
    np.testing.assert_array_equal(image.color, color)
    np.testing.assert_array_equal(image.depth, depth)


@pytest.mark.parametrize("roll", [-1.5, rest(-0.8), rest(0.0), 0.8, rest(1.5)])
def test_roll_of_any_size_is_found_with_its_sign(roll: float) -> None:
    found = look(pose_at(0.3, roll=roll)).found
    assert -math.pi / 2 < found.roll <= math.pi / 2
    assert abs(math.remainder(found.roll - roll, math.pi)) < math.radians(1.0)


@few_and(40)
def test_clutter_without_electrodes_is_no_terminal(count: int) -> None:
    for seed in range(20_400, 20_400 + count):
        random = np.random.default_rng(seed)
        scene, pose = draw_scene(random, clutter=14, target=False), pose_at(random.uniform(0.2, 0.8))
        assert DETECTOR.detect(SimulatedCamera().render(scene, pose, random)) is None


@few_and(8, 1)
@pytest.mark.parametrize("scale", [0.75, 1.3])
def test_bars_of_another_size_are_refused_by_depth(scale: float, count: int) -> None:
    other = terminal.Terminal(**{name: scale * length for name, length in vars(terminal.Terminal()).items()})
    seen = list(
        looks(range(20_500, 20_500 + count), 0.28, 0.6, lambda scene, _: dataclasses.replace(scene, terminal=other))
    )
    assert all(each.found is None for each in seen)
    # With the right size they are found, so only the size was refused.
    assert sum(ElectrodeDetector(other).detect(each.image) is not None for each in seen) >= 0.85 * count


@few_and(5, 1)
@pytest.mark.parametrize(("bar", "end"), [*itertools.product((terminal.UPPER, terminal.LOWER), (1, -1))])
def test_half_of_a_bar_may_be_hidden(bar: int, end: int, count: int) -> None:
    hidden = (cover(0.5, bar, end),)
    seen = looks(
        range(20_600, 20_600 + count), 0.25, 0.55, lambda scene, _: dataclasses.replace(scene, foreground=hidden)
    )
    found = [each for each in seen if each.found is not None]
    assert len(found) >= 0.8 * count
    for each in found:
        assert each.off < 0.003
        assert each.found.confidence < 0.95


def test_below_the_stereo_range_the_image_alone_gives_the_pose() -> None:
    seen = look(pose_at(0.15, roll=0.1, pitch=0.3))
    noise = np.random.default_rng(5).uniform(0.174, 2.0, seen.image.depth.shape).astype(np.float32)
    for each in (seen, seen_again(seen, depth=noise)):
        assert each.found.source == "image"
        assert np.isfinite(each.found.normal).all()
        assert each.off < 0.002


@pytest.mark.parametrize("away", [0.15, 0.3])
def test_a_plane_that_contradicts_the_image_is_refused_at_any_range(away: float) -> None:
    seen = look(pose_at(away, roll=0.1, pitch=0.3))
    assert seen_again(seen, depth=np.full_like(seen.image.depth, 0.9)).found is None


@few_and(30)
def test_without_depth_the_covariance_grows_and_holds(count: int) -> None:
    squares = []
    for both in looks(range(20_700, 20_700 + count), 0.2, 0.5):
        alone = seen_again(both, depth=np.full_like(both.image.depth, np.nan))
        if both.found is None or alone.found is None:
            continue
        assert alone.found.source == "image"
        assert np.isnan(alone.found.normal).all(), "where depth was to be expected"
        turned = [np.trace(each.found.covariance[3:5, 3:5]) for each in (both, alone)]
        assert turned[1] > turned[0]
        squares.append(sigmas(alone) ** 2)
    assert len(squares) >= 0.9 * count
    assert np.median(squares) < 5.0


@few_and(12, 1)
@pytest.mark.parametrize("distortion", [*DISTORTIONS[1:], rest((-0.1, 0.01, 0.0, 0.0, 0.0))])
def test_lens_distortion_hides_no_sides_of_the_bars(distortion: tuple[float, ...], count: int) -> None:
    camera = SimulatedCamera(dataclasses.replace(OAK_D, distortion=distortion))
    assert all(each.off < 0.002 for each in looks(range(count), 0.2, 0.35, camera=camera))


@few_and(12)
@pytest.mark.parametrize("percent", [-2.0, 2.0])
def test_a_slightly_wrong_focal_length_or_biased_depth_is_within_the_covariance(percent: float, count: int) -> None:
    factor = 1.0 + percent / 100.0
    wrong = dataclasses.replace(OAK_D, fx=OAK_D.fx * factor, fy=OAK_D.fy * factor)
    column, row = np.meshgrid(np.arange(OAK_D.width), np.arange(OAK_D.height))
    sloping = factor + 0.01 * ((column - OAK_D.cx) / OAK_D.fx - (row - OAK_D.cy) / OAK_D.fy)
    for right in looks(range(count), 0.2, 0.8):
        biased = (right.image.depth * sloping).astype(np.float32)
        for each in (seen_again(right, intrinsics=wrong), seen_again(right, depth=biased)):
            assert each.found is not None
            assert sigmas(each) < 5.0


def test_the_time_of_a_large_picture_full_of_bars_is_bounded() -> None:
    size = (1536, 2048)
    grey = np.full(size, 20, dtype=np.uint8)
    for row, column in itertools.product(range(1, size[0] - 8, 12), range(2, size[1] - 40, 45)):
        grey[row : row + 5, column : column + 32] = 60 + (7 * row + 3 * column) % 190
    image = images.RgbdImage.make(grey, np.full(size, np.nan), OAK_D.scaled(*size[::-1]))
    began = time.process_time()
    assert DETECTOR.detect(image) is None
    assert time.process_time() - began < 1.0


def test_a_large_image_gives_the_same_pose_with_corners_in_its_own_pixels() -> None:
    seen = look(pose_at(0.3, roll=0.2, pitch=0.4, yaw=-0.2))
    large = images.RgbdImage(
        *(np.repeat(np.repeat(each, 3, 0), 3, 1) for each in (seen.image.color, seen.image.depth)),
        OAK_D.scaled(1920, 1200),
    )
    found = DETECTOR.detect(large)
    assert np.linalg.norm(error(found, seen.pose)) < 0.002
    np.testing.assert_allclose(found.bars, 3.0 * (seen.found.bars + 0.5) - 0.5, atol=1.0)
