"""From two tactile frames to the pose of the target in end_effector, with honest standard deviations.

Features go through small networks, once for each mirror image of the frames, so that the estimate obeys the
device's symmetry exactly. Two experts: one for contacts that both pads feel, one for contacts that only one pad
feels (it may guide a correction but is never in range). Runs on numpy alone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_tactile import features
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.generator import ANGLE_CLASSES, ANGLE_LIMIT, POSITION_CLASSES, POSITION_LIMIT
from deltacharger_tactile.network import Network, Weights, fit
from deltacharger_tactile.parameters import CONTACT_THRESHOLD
from deltacharger_tactile.support import Support

Array = NDArray[np.float64]

FORMAT = 1
THRESHOLD = 0.25
"""Readings below it are noise, N: five times the offset that a contact leaves after a tare."""
_SCALE = np.array([0.005, 0.005, math.radians(6.0)])
_FLOOR = np.array([1e-4, 5e-5, math.radians(0.03)])
"""Smallest standard deviations ever reported."""
_SMALLEST_FACTOR = 0.85
"""Held-out rigs may shrink the networks' own standard deviations no further than this."""
_EXPERTS = ("both", "one")
_CLIP = 6.0


@dataclass(frozen=True)
class Limits:
    """When an estimate may be used.

    Attributes:
        pad_force: N, smallest load with which a pad holds its ridge.
        pad_active: smallest number of taxels above the threshold on each pad.
        pad_dead: most dead taxels of a pad.
        angle_stddev: rad, largest standard deviation that is sure.
        vertical_stddev: m, likewise.
        horizontal_stddev: m, likewise.
    """

    pad_force: float = 3.0
    pad_active: int = 4
    pad_dead: int = 3
    angle_stddev: float = math.radians(0.5)
    vertical_stddev: float = 0.8e-3
    horizontal_stddev: float = 3.0e-3


@dataclass(frozen=True)
class Estimate:
    """Pose of the target in end_effector as felt; floats for one frame pair, arrays (...) for a batch.

    NaN = unknown (no contact). Standard deviations are errors against the pose in contact on rigs that training
    did not see.

    Attributes:
        angle: rad about +z, from +x to +y.
        angle_stddev: rad.
        vertical: m along y.
        vertical_stddev: m.
        horizontal: m along x.
        horizontal_stddev: m.
        in_range: both pads hold the ridge, the frames look like those of training, and the pose lies within the limits.
        contact: some live taxel feels 1 N or more.
        sure: in range and precise.
        angle_probability: (..., 6) classes of |angle| 0–5°, the last one open.
        vertical_probability: (..., 5) classes −10…10 mm, both ends open.
        horizontal_probability: (..., 5) classes −10…10 mm, both ends open.
        left_force: N, load of the pad at +x.
        right_force: N, load of the pad at −x.
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


@dataclass(frozen=True)
class _Expert:
    centre: Weights
    spread: Weights
    networks: tuple[Network, ...]
    factor: Array

    def predict(self, inputs: Array) -> tuple[Array, Array]:
        """Return mean and standard deviation (4, N, 3) in m, m, rad of mirrored inputs (4, N, F)."""
        flat = inputs.reshape(-1, inputs.shape[-1]).astype(np.float32)
        scaled = np.clip((flat - self.centre) / self.spread, -_CLIP, _CLIP)
        means, variances = [], []
        for network in self.networks:
            mean, spread = network.predict(scaled)
            means.append(mean.reshape(*inputs.shape[:2], -1) * features.MIRROR_SIGNS[:, None])
            variances.append(spread.reshape(*inputs.shape[:2], -1) ** 2)
        every = np.concatenate(means)
        mean = every.mean(axis=0)
        variance = np.concatenate(variances).mean(axis=0) + every.var(axis=0)
        return mean * _SCALE, np.maximum(np.sqrt(variance) * _SCALE * self.factor, _FLOOR)


class PoseEstimator:
    """Estimates (horizontal, vertical, angle) from tared, unthresholded frames.

    Args:
        name: name and version that messages carry.
        threshold: readings below it count as 0, N.
        hidden: widths of the hidden layers of each network.
        members: networks per expert.
        epochs: passes over the training data.
    """

    def __init__(
        self,
        name: str = "pose",
        threshold: float = THRESHOLD,
        hidden: Sequence[int] = (64, 48),
        members: int = 2,
        epochs: int = 12,
    ) -> None:
        self.name = name
        self.threshold = threshold
        self.hidden = tuple(hidden)
        self.members = members
        self.epochs = epochs
        self.limits = Limits()
        self._experts: dict[str, _Expert] = {}
        self._support: Support | None = None
        self._about: dict[str, Any] = {}

    @property
    def about(self) -> dict[str, Any]:
        """What the model was made from (parameters' digest, seeds)."""
        return dict(self._about)

    def fit(
        self, frames: ArrayLike, pose: ArrayLike, held_out: tuple[ArrayLike, ArrayLike], seed: int = 0
    ) -> PoseEstimator:
        """Learn from dockings, then scale the standard deviations on rigs that are not among them.

        Args:
            frames: (N, 2, 10, 10) N, tared, averaged, not thresholded; NaN where dead.
            pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact.
            held_out: frames and poses of other rigs.
            seed: initial weights.
        """
        random = np.random.default_rng([0xF17, seed])
        inputs, holds, touched = self._prepare(np.asarray(frames, dtype=float))
        poses = np.asarray(pose, dtype=float)
        signed = (poses / _SCALE)[None] * features.MIRROR_SIGNS[:, None]
        for name, rows in zip(_EXPERTS, (holds, touched & ~holds), strict=True):
            chosen = inputs[:, rows].reshape(-1, inputs.shape[-1])
            targets = signed[:, rows].reshape(-1, 3).astype(np.float32)
            centre, spread = chosen.mean(axis=0), chosen.std(axis=0) + 1e-3
            scaled = np.clip((chosen - centre) / spread, -_CLIP, _CLIP).astype(np.float32)
            networks = [fit(scaled, targets, self.hidden, self.epochs, random) for _ in range(self.members)]
            self._experts[name] = _Expert(
                centre.astype(np.float32), spread.astype(np.float32), tuple(networks), np.ones(3)
            )
        usual = inputs[:, holds & _within(poses)]
        felt = np.concatenate([self._experts["both"].predict(usual)[0] * sign for sign in features.MIRROR_SIGNS])
        self._support = Support.learn(usual.reshape(-1, usual.shape[-1]), felt, self.epochs, random)
        self._calibrate(np.asarray(held_out[0], dtype=float), np.asarray(held_out[1], dtype=float))
        return self

    def predict(self, left: ArrayLike, right: ArrayLike) -> Estimate:
        """Estimate the pose.

        Args:
            left: (..., 10, 10) N, the pad at +x, tared, not thresholded, averaged over frames by the caller;
                NaN = dead.
            right: the same for the pad at −x.

        Raises:
            FrameError: the arrays are not of that shape.
        """
        frames = features.stack(left, right)
        shape = np.asarray(left).shape[:-2]
        inputs, holds, touched = self._prepare(frames)
        contact = np.nan_to_num(frames, nan=0.0).max(axis=(1, 2, 3)) >= CONTACT_THRESHOLD
        mean, spread = np.full((len(frames), 3), np.nan), np.full((len(frames), 3), np.nan)
        for name, rows in zip(_EXPERTS, (holds & contact, touched & contact & ~holds), strict=True):
            if rows.any():
                mean[rows], spread[rows] = self._experts[name].predict(inputs[:, rows])
        limits = self.limits
        in_range = contact & holds & _within(mean)
        if in_range.any():
            in_range[in_range] = self._learnt.contains(inputs[0, in_range], mean[in_range])
        precise = spread <= [limits.horizontal_stddev, limits.vertical_stddev, limits.angle_stddev]
        sure = in_range & precise.all(axis=1)
        force = np.where(np.isfinite(frames) & (frames >= self.threshold), frames, 0.0).sum(axis=(2, 3))
        columns = [column[:, axis] for axis in (2, 1, 0) for column in (mean, spread)]
        columns += [in_range, contact, sure]
        columns += [angle_classes(mean[:, 2], spread[:, 2])]
        columns += [position_classes(mean[:, axis], spread[:, axis]) for axis in (1, 0)]
        columns += [force[:, 0], force[:, 1]]
        return Estimate(*(_shaped(column, shape) for column in columns))

    def distance(self, left: ArrayLike, right: ArrayLike) -> Array:
        """Mahalanobis distance (N,) of frames from the training data: how far a device has drifted."""
        return self._learnt.distance(self._prepare(features.stack(left, right))[0][0])

    @property
    def _learnt(self) -> Support:
        if self._support is None:
            raise ModelError(self.name, "it has not been fitted")
        return self._support

    def _prepare(self, frames: Array) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return inputs (4, N, F) of the mirror images, whether both pads hold the ridge, whether any is touched."""
        dead = ~np.isfinite(frames)
        live = features.fill_dead(frames)
        # A filled taxel inside the contact carries less information: the network is told how many there are.
        filled = (dead & (live >= self.threshold)).sum(axis=(2, 3)).astype(float)
        images = features.mirrors(live)
        found = features.extract(images.reshape(-1, *live.shape[1:]), self.threshold)
        counts = np.stack([filled, filled, filled[:, ::-1], filled[:, ::-1]])
        inputs = np.concatenate([found.values.reshape(4, len(frames), -1), counts], axis=2)
        force, active = found.force[: len(frames)], found.active[: len(frames)]
        usable = dead.sum(axis=(2, 3)) <= self.limits.pad_dead
        holding = (force >= self.limits.pad_force) & (active >= self.limits.pad_active) & usable
        return inputs, holding.all(axis=1), force.sum(axis=1) > 0.0

    def _calibrate(self, frames: Array, pose: Array) -> None:
        inputs, holds, touched = self._prepare(frames)
        for name, rows in zip(_EXPERTS, (holds, touched & ~holds), strict=True):
            expert = self._experts[name]
            mean, spread = expert.predict(inputs[:, rows])
            ratio = np.abs(mean - pose[rows]) / spread
            # Three standard deviations must cover 99.73 %, tails included, not only the bulk one.
            factor = np.maximum(np.sqrt(np.mean(ratio**2, axis=0)), np.quantile(ratio, 0.9973, axis=0) / 3.0)
            factor = np.maximum(factor, _SMALLEST_FACTOR)
            self._experts[name] = _Expert(expert.centre, expert.spread, expert.networks, factor)
        usual = inputs[:, holds & _within(pose)]
        self._support = self._learnt.limited(usual[0], self._experts["both"].predict(usual)[0])

    def describe(self, about: dict[str, Any]) -> None:
        """Store what the model was made from; it is saved with the model."""
        self._about = dict(about)

    def save(self, path: str | Path) -> None:
        """Write one npz file that loads without pickle."""
        support = self._learnt
        arrays: dict[str, Any] = {
            "support_centre": support.centre,
            "support_whitening": support.whitening.astype(np.float32),
            "support_shown_centre": support.shown_centre,
            "support_shown_spread": support.shown_spread,
        } | _layers("picture", support.picture)
        for name, expert in self._experts.items():
            for part in ("centre", "spread", "factor"):
                arrays[f"{name}_{part}"] = getattr(expert, part)
            for member, network in enumerate(expert.networks):
                arrays |= _layers(f"{name}_{member}", network)
        header = {
            "format": FORMAT,
            "name": self.name,
            "threshold": self.threshold,
            "hidden": self.hidden,
            "members": self.members,
            "epochs": self.epochs,
            "support": [support.distance_limit, support.picture_limit],
            "features": features.names(),
            "about": self._about,
        }
        np.savez_compressed(path, meta=np.array(json.dumps(header, sort_keys=True)), **arrays)

    @staticmethod
    def load(path: str | Path) -> PoseEstimator:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            ModelError: the file is not a model of this format.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                header = json.loads(str(file["meta"]))
                if header.get("format") != FORMAT or header.get("features") != features.names():
                    raise ModelError(str(path), "made by another version of this package")
                return _restore(header, {name: file[name] for name in file.files})
        except (KeyError, ValueError, OSError) as error:
            if isinstance(error, ModelError | FileNotFoundError):
                raise
            raise ModelError(str(path), str(error)) from error


def _restore(header: dict[str, Any], arrays: dict[str, Any]) -> PoseEstimator:
    model = PoseEstimator(header["name"], header["threshold"], header["hidden"], header["members"], header["epochs"])
    model.describe(header["about"])
    model._support = Support(
        arrays["support_centre"],
        arrays["support_whitening"].astype(float),
        arrays["support_shown_centre"],
        arrays["support_shown_spread"],
        _network("picture", arrays),
        *header["support"],
    )
    for name in _EXPERTS:
        networks = tuple(_network(f"{name}_{member}", arrays) for member in range(model.members))
        centre, spread = arrays[f"{name}_centre"], arrays[f"{name}_spread"]
        model._experts[name] = _Expert(centre, spread, networks, arrays[f"{name}_factor"])
    return model


def _layers(prefix: str, network: Network) -> dict[str, Weights]:
    named = {f"{prefix}_weight{layer}": weight for layer, weight in enumerate(network.weights)}
    return named | {f"{prefix}_bias{layer}": bias for layer, bias in enumerate(network.biases)}


def _network(prefix: str, arrays: dict[str, Any]) -> Network:
    count = sum(name.startswith(f"{prefix}_weight") for name in arrays)
    weights = tuple(arrays[f"{prefix}_weight{layer}"] for layer in range(count))
    return Network(weights, tuple(arrays[f"{prefix}_bias{layer}"] for layer in range(count)))


def _within(pose: Array) -> NDArray[np.bool_]:
    """Whether poses (N, 3) lie within the range that estimates may be used in; NaN does not."""
    return np.asarray(np.all(np.abs(pose) <= [POSITION_LIMIT, POSITION_LIMIT, ANGLE_LIMIT], axis=1))


def angle_classes(angle: Array, stddev: Array) -> Array:
    """Probabilities (N, 6) that |angle| rounds to 0, 1, … 5°; the last class takes everything above."""
    edges = np.append(np.radians(np.arange(ANGLE_CLASSES - 1) + 0.5), np.inf)
    below = _normal((edges - angle[:, None]) / stddev[:, None]) - _normal((-edges - angle[:, None]) / stddev[:, None])
    return np.diff(below, axis=1, prepend=0.0)


def position_classes(position: Array, stddev: Array) -> Array:
    """Probabilities (N, 5) of the classes −10, −5, 0, 5, 10 mm; the outer two are open."""
    middle = np.array(POSITION_CLASSES)
    edges = np.concatenate([[-np.inf], 0.5 * (middle[1:] + middle[:-1]), [np.inf]])
    return np.diff(_normal((edges - position[:, None]) / stddev[:, None]), axis=1)


def _normal(value: Array) -> Array:
    return np.asarray([0.5 * math.erfc(-x / math.sqrt(2.0)) for x in value.ravel()]).reshape(value.shape)


def _shaped(column: NDArray[Any], shape: tuple[int, ...]) -> Any:
    shaped = column.reshape((*shape, *column.shape[1:]))
    return shaped if shaped.ndim else shaped.item()
