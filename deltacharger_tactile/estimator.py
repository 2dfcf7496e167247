# SPDX-License-Identifier: Apache-2.0
"""Estimates the pose of the target in end_effector from two tactile frames, with reliable standard deviations.

The networks estimate a seat (N, 3): offset along the bars (m), offset across the bars (m), angle (rad). The first is
the offset that would give the same loads without a lean. A lean falsifies it, but not the second. (Models for ridges
with holes are trained on the true offset along the bars.)

Each network runs once per mirror image of the frames, so that the estimate obeys the device's symmetry exactly. One
expert covers contacts on both pads, another contacts on one pad only. The latter may guide a correction but is never in
range. Estimation needs only numpy.

What the pose estimator has learnt: experts for the pose, and whether frames look as in training.
Small regression networks estimate their own uncertainty.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import LARGEST_MODEL, Array, Mask, NpzError, read_npz
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, ROWS
from deltacharger_tactile import errors, features, parameters


@dataclass(frozen=True)
class Limits:
    """When an estimate may be used.

    Attributes:
        pad_force: N, smallest load of a pad that holds its ridge.
        pad_active: smallest number of taxels above the threshold on each pad.
        pad_dead: largest number of dead taxels of a pad.
        angle_stddev: rad, largest standard deviation of a sure estimate.
        across_stddev: m, same. (The horizontal position has no limit: safety does not depend on it.)
    """

    pad_force: float = 3.0
    pad_active: int = 4
    pad_dead: int = 3
    angle_stddev: float = math.radians(0.5)
    across_stddev: float = 0.8e-3


@dataclass(frozen=True)
class Estimate:
    """Pose of the target in end_effector, measured by touch; floats for one frame pair, arrays (...) for a batch.

    NaN = unknown (no contact). Standard deviations are errors against the pose in contact, on rigs unseen in training.

    In one contact, a residual lean along the bars looks like a horizontal offset: 0.01° like 1 mm. `horizontal` counts
    all of it as an offset, and `vertical` follows from `across` and `horizontal`. A lean does not affect `across`.

    Attributes:
        angle: rad about +z, from +x to +y.
        angle_stddev: rad.
        vertical: m along y.
        vertical_stddev: m.
        horizontal: m along x.
        horizontal_stddev: m.
        in_range: both pads hold the ridge, frames look as in training, and the pose is within the limits.
        contact: a live taxel reads 1 N or more.
        sure: in range and precise.
        angle_probability: (..., 6) classes of |angle| 0–5°, the last one open.
        vertical_probability: (..., 5) classes −10…10 mm, both ends open.
        horizontal_probability: (..., 5) classes −10…10 mm, both ends open.
        left_force: N, load of the pad at +x.
        right_force: N, load of the pad at −x.
        across: m, offset across the target's bars: vertical · cos(angle) − horizontal · sin(angle).
        across_stddev: m.
    """

    angle: Any
    angle_stddev: Any
    vertical: Any
    vertical_stddev: Any
    horizontal: Any
    horizontal_stddev: Any
    in_range: Any
    contact: Any
    sure: Any
    angle_probability: Any
    vertical_probability: Any
    horizontal_probability: Any
    left_force: Any
    right_force: Any
    across: Any
    across_stddev: Any


_ROOT = math.sqrt(2.0)
_HALVES = np.append(np.radians(np.arange(parameters.ANGLE_CLASSES - 1) + 0.5), np.inf)
_ANGLE_EDGES = np.concatenate([_HALVES, -_HALVES])
_MIDDLES = np.array(parameters.POSITION_CLASSES)
_POSITION_EDGES = np.concatenate([[-np.inf], 0.5 * (_MIDDLES[1:] + _MIDDLES[:-1]), [np.inf]])


def angle_classes(angle: Array, stddev: Array) -> Array:
    """Probabilities (N, 6) that |angle| rounds to 0, 1, … 5°; the last class includes larger angles."""
    upper, lower = np.split(_normal((_ANGLE_EDGES - angle[:, None]) / stddev[:, None]), 2, axis=1)
    below = upper - lower
    return np.concatenate([below[:, :1], below[:, 1:] - below[:, :-1]], axis=1)


def position_classes(position: Array, stddev: Array) -> Array:
    """Probabilities (N, 5) of the classes −10, −5, 0, 5, 10 mm; the outer two are open."""
    below = _normal((_POSITION_EDGES - position[:, None]) / stddev[:, None])
    return below[:, 1:] - below[:, :-1]


def _normal(value: Array) -> Array:
    return np.asarray([0.5 * math.erfc(-x / _ROOT) for x in value.ravel().tolist()]).reshape(value.shape)


def shaped(column: NDArray[Any], shape: tuple[int, ...]) -> Any:
    """Return (N, …) values in the input's shape; a single one as a plain number."""
    result = column.reshape((*shape, *column.shape[1:]))
    return result if result.ndim else result.item()


Weights = NDArray[np.float32]

LOG_SPREAD = (-6.0, 3.0)
"""Bounds of the log of a predicted standard deviation (targets are scaled to about 1)."""
POSE_SCALE = np.array([0.005, 0.005, math.radians(6.0)])
"""Size of a pose in networks: m, m, rad."""
CLIP = 6.0
"""Largest scaled input of a network."""
PARTS = ("centre", "spread", "factor")
"""Arrays of an expert beside its networks."""
_NAMES = features.names()
_SHOWN = ("u_mm", "v_mm", "uu_mm2", "uv_mm2", "vv_mm2", "slope", "active", "peak_N")
SHOWN = [_NAMES.index(f"{side}_{name}") for side in ("left", "right") for name in _SHOWN]
"""Columns of the features that `Support.picture` predicts."""
_LOADS = [_NAMES.index("left_force_N"), _NAMES.index("right_force_N")]
_LOAD_SCALE = 20.0
_FLOOR = np.array([1e-4, 5e-5, math.radians(0.03)])
"""Smallest reported standard deviations, m, m, rad."""


@dataclass(frozen=True)
class Network:
    """Fully connected layers with ReLU; the last returns K means and K logarithms of standard deviations.

    Attributes:
        weights: (inputs, outputs) of each layer, float32.
        biases: (outputs,) of each layer, float32.
    """

    weights: tuple[Weights, ...]
    biases: tuple[Weights, ...]

    def predict(self, inputs: Weights) -> tuple[Weights, Weights]:
        """Return mean and standard deviation (N, K) of scaled inputs (N, F)."""
        layer = self.forward(inputs)[-1]
        outputs = layer.shape[1] // 2
        spread = np.exp(np.clip(layer[:, outputs:], *LOG_SPREAD))
        return layer[:, :outputs], np.asarray(spread)

    def forward(self, inputs: Weights) -> list[Weights]:
        """Return the inputs and the outputs of every layer."""
        layers = [inputs]
        last = len(self.weights) - 1
        for index, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            value = layers[-1] @ weight + bias
            layers.append(value if index == last else np.maximum(value, 0.0))
        return layers

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any]) -> Network:
        """Restore from a file's arrays `<prefix>_weight<i>` and `<prefix>_bias<i>`."""
        count = sum(name.startswith(f"{prefix}_weight") for name in arrays)
        weights = tuple(arrays[f"{prefix}_weight{layer}"] for layer in range(count))
        return Network(weights, tuple(arrays[f"{prefix}_bias{layer}"] for layer in range(count)))


@dataclass(frozen=True)
class Expert:
    """Ensemble of networks for one kind of contact; their mean is the estimate.

    Attributes:
        centre: (F,) mean of the features.
        spread: (F,) their standard deviation.
        networks: each estimates a pose and standard deviations from features.
        factor: (3,) correction of the standard deviations, from held-out rigs.
    """

    centre: Weights
    spread: Weights
    networks: tuple[Network, ...]
    factor: Array

    def predict(self, inputs: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation (N, 3) in m, m, rad of mirrored inputs (4, N, F)."""
        flat = inputs.reshape(-1, inputs.shape[-1]).astype(np.float32)
        scaled = ((flat - self.centre) / self.spread).clip(-CLIP, CLIP)
        outputs = [network.predict(scaled) for network in self.networks]
        shape = (len(outputs), *inputs.shape[:2], -1)
        means, spreads = (np.concatenate(each).reshape(shape) for each in zip(*outputs, strict=True))
        every = (means * features.MIRROR_SIGNS[:, None]).reshape(-1, *means.shape[2:])
        mean = every.mean(axis=0)
        variance = (spreads**2).reshape(every.shape).mean(axis=0) + ((every - mean) ** 2).mean(axis=0)
        return mean * POSE_SCALE, np.maximum(np.sqrt(variance) * POSE_SCALE * self.factor, _FLOOR)

    @staticmethod
    def restore(prefix: str, arrays: Mapping[str, Any], members: int) -> Expert:
        """Restore from a file's arrays with this prefix."""
        centre, spread, factor = (arrays[f"{prefix}_{part}"] for part in PARTS)
        networks = tuple(Network.restore(f"{prefix}_{member}", arrays) for member in range(members))
        return Expert(centre, spread, networks, factor)


@dataclass(frozen=True)
class Support:
    """Statistics of training frames, for two checks.

    The Mahalanobis distance of the features finds frames far from all training frames. The second check predicts the
    appearance of both pads (centres, moments, active taxels) at the estimated pose and load, and compares. A drifted
    row, for example, shifts the estimate but contradicts the other features.

    Attributes:
        centre: (F,) mean features.
        whitening: (F, F) features to uncorrelated unit ones.
        shown_centre: (16,) mean of the predicted features.
        shown_spread: (16,) their spread.
        picture: network from pose and loads to the predicted features.
        distance_limit: largest Mahalanobis distance (per root of a feature).
        picture_limit: largest root mean square deviation from the prediction, in standard deviations.
    """

    centre: Array
    whitening: Array
    shown_centre: Array
    shown_spread: Array
    picture: Network
    distance_limit: float = math.inf
    picture_limit: float = math.inf

    def distance(self, inputs: Array) -> Array:
        """Mahalanobis distance (N,) from the training features, per root of a feature."""
        white = (inputs - self.centre) @ self.whitening
        return np.asarray(np.sqrt(np.mean(white * white, axis=1)))

    def deviation(self, inputs: Array, pose: Array) -> Array:
        """Root mean square deviation (N,) of the shown features from the prediction at `pose` (N, 3)."""
        mean, spread = self.picture.predict(picture_inputs(inputs, pose))
        shown = (inputs[:, SHOWN] - self.shown_centre) / self.shown_spread
        return np.asarray(np.sqrt(np.mean(((shown - mean) / spread) ** 2, axis=1)))

    def contains(self, inputs: Array, pose: Array) -> Mask:
        """Whether features (N, F) and the poses estimated from them (N, 3) look like training."""
        near = self.distance(inputs) <= self.distance_limit
        return np.asarray(near & (self.deviation(inputs, pose) <= self.picture_limit))


def picture_inputs(inputs: Array, pose: Array) -> Weights:
    """Return the inputs (N, 5) of `Support.picture`: poses (N, 3) and the loads in features (N, F), scaled."""
    scaled = np.concatenate([pose / POSE_SCALE, inputs[:, _LOADS] / _LOAD_SCALE], axis=1)
    return np.asarray(np.clip(np.nan_to_num(scaled), -CLIP, CLIP), dtype=np.float32)


Self = TypeVar("Self", bound="PoseEstimator")

FORMAT = 3
THRESHOLD = 0.25
"""Lower readings are noise, N: five times the offset that a contact leaves after a tare."""
EXPERTS = ("both", "one")
"""Networks by the pads that a contact touches."""
_FORCES = [features.names().index(f"{side}_force_N") for side in ("left", "right")]
_SEAT_LIMIT = np.array([0.035, parameters.POSITION_LIMIT, parameters.ANGLE_LIMIT])
"""Limits of a seat in range, m, m, rad. Lean and offset together reach 35 mm before a pad is unloaded."""


class PoseEstimator:
    """Estimates (horizontal, vertical, angle) from tared, unthresholded frames; `load` reads a trained one.

    Args:
        name: name and version in messages.
        threshold: readings below it count as 0, N.

    Attributes:
        limits: when an estimate may be used.
        about: origin of the model (parameters' digest, seeds).
    """

    def __init__(self, name: str = "pose", threshold: float = THRESHOLD) -> None:
        self.name = name
        self.threshold = threshold
        self.limits = Limits()
        self.about: dict[str, Any] = {}
        self._experts: dict[str, Expert] = {}
        self._support: Support | None = None

    def predict(self, left: ArrayLike, right: ArrayLike) -> Estimate:
        """Estimate the pose.

        Args:
            left: (..., 10, 10) N, the pad at +x, tared, not thresholded, averaged over frames; NaN = dead.
            right: (..., 10, 10) N, the pad at −x.

        Raises:
            FrameError: wrong shape.
        """
        frames = features.stack(left, right)
        shape = np.asarray(left).shape[:-2]
        inputs, holds, touched = self._prepare(frames)
        contact = np.asarray(np.any(frames >= CONTACT_FORCE, axis=(1, 2, 3)))  # NaN is not
        mean, spread = np.full((len(frames), 3), np.nan), np.full((len(frames), 3), np.nan)
        for name, rows in zip(EXPERTS, (holds & contact, touched & contact & ~holds), strict=True):
            if rows.any():
                mean[rows], spread[rows] = self._experts[name].predict(inputs[:, rows])
        limits = self.limits
        in_range = contact & holds & within(mean)
        if in_range.any():
            in_range[in_range] = self._learnt.contains(inputs[0, in_range], mean[in_range])
        precise = spread[:, 1:] <= [limits.across_stddev, limits.angle_stddev]
        sure = in_range & precise.all(axis=1)
        force = inputs[0][:, _FORCES]
        pose, stddev = to_pose(mean), pose_stddev(mean, spread)
        columns: list[NDArray[Any]] = [column[:, axis] for axis in (2, 1, 0) for column in (pose, stddev)]
        columns += [in_range, contact, sure]
        columns += [angle_classes(pose[:, 2], stddev[:, 2])]
        columns += [position_classes(pose[:, axis], stddev[:, axis]) for axis in (1, 0)]
        columns += [force[:, 0], force[:, 1], mean[:, 1], spread[:, 1]]
        return Estimate(*(shaped(column, shape) for column in columns))

    def drifted(self, left: ArrayLike, right: ArrayLike) -> Mask:
        """Return which frames (N,) look unlike training though both pads hold the ridge."""
        inputs, holds, _ = self._prepare(features.stack(left, right))
        strange = np.zeros(len(holds), dtype=bool)
        if holds.any():
            mean, _ = self._experts["both"].predict(inputs[:, holds])
            strange[holds] = ~self._learnt.contains(inputs[0, holds], mean)
        return strange

    @property
    def _learnt(self) -> Support:
        if self._support is None:
            raise errors.ModelError(self.name, "it is not trained")
        return self._support

    def _prepare(self, frames: Array) -> tuple[Array, Mask, Mask]:
        """Return inputs (4, N, F) of the mirror images, whether both pads hold the ridge, whether one is touched."""
        dead = ~np.isfinite(frames)
        live = features.fill_dead(frames)
        # A filled taxel inside the contact carries less information, so the network gets their number.
        filled = (dead & (live >= self.threshold)).sum(axis=(2, 3)).astype(float)
        found = features.extract(live, self.threshold)
        counts = np.stack([filled, filled, filled[:, ::-1], filled[:, ::-1]])
        inputs = np.concatenate([features.mirrored(found.values), counts], axis=2)
        force, active = found.force, found.active
        usable = dead.sum(axis=(2, 3)) <= self.limits.pad_dead
        holding = (force >= self.limits.pad_force) & (active >= self.limits.pad_active) & usable
        return inputs, holding.all(axis=1), force.sum(axis=1) > 0.0

    @classmethod
    def load(cls: type[Self], path: str | Path) -> Self:
        """Read the npz file of a trained model.

        Raises:
            FileNotFoundError: no such file.
            ModelError: the file is not a model of this format.
        """
        try:
            header, arrays = read_npz(path, "meta", LARGEST_MODEL)
        except NpzError as error:
            raise errors.ModelError(str(path), str(error)) from error
        if header.get("format") != FORMAT or header.get("features") != features.names():
            made = f"format {header.get('format')!r}, and this version reads {FORMAT}"
            raise errors.ModelError(str(path), f"made by another version of this package ({made}), or no pose model")
        if not all(np.issubdtype(array.dtype, np.number) and np.all(np.isfinite(array)) for array in arrays.values()):
            raise errors.ModelError(str(path), "an array holds NaN, infinity or no numbers")
        try:
            model = cls(header["name"], header["threshold"])
            model._restore(header, arrays)
            model._try()
        except Exception as error:  # arrays of a foreign file may raise anything
            raise errors.ModelError(str(path), "its arrays and description do not fit together") from error
        return model

    def _restore(self, header: dict[str, Any], arrays: dict[str, Any]) -> None:
        """Take what a file holds."""
        self.about = dict(header["about"])
        self._support = Support(
            arrays["support_centre"],
            arrays["support_whitening"].astype(float),
            arrays["support_shown_centre"],
            arrays["support_shown_spread"],
            Network.restore("picture", arrays),
            *header["support"],
        )
        for name in EXPERTS:
            self._experts[name] = Expert.restore(name, arrays, header["members"])

    def _try(self) -> None:
        """Estimate a contact on both pads and one on a single pad; raises if the arrays do not fit together."""
        pads = np.ones((2, 2, ROWS, COLUMNS))
        pads[1, 1] = 0.0
        self.predict(*pads)
        self.drifted(*pads)
        rows, columns = self._learnt.whitening.shape
        if rows != columns:
            raise ValueError("whitening")


def to_pose(seat: Array) -> Array:
    """Convert seats (N, 3) to poses (N, 3)."""
    x, across, angle = seat.T
    return np.column_stack([x, (across + x * np.sin(angle)) / np.cos(angle), angle])


def pose_stddev(seat: Array, spread: Array) -> Array:
    """Return standard deviations (N, 3) of poses: with roll, the error along the bars enters the vertical."""
    angle = seat[:, 2]
    vertical = np.hypot(spread[:, 1], spread[:, 0] * np.sin(angle)) / np.cos(angle)
    return np.column_stack([spread[:, 0], vertical, spread[:, 2]])


def within(seat: Array) -> Mask:
    """Return whether seats (N, 3) are within the usable range; False for NaN."""
    return np.asarray(np.all(np.abs(seat) <= _SEAT_LIMIT, axis=1))
