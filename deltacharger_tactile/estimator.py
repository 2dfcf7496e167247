# SPDX-License-Identifier: Apache-2.0
"""Estimates the pose of the target in end_effector from two tactile frames, with reliable standard deviations.

The networks estimate a seat (N, 3): offset along the bars (m), offset across the bars (m), angle (rad). The first is
the offset that would give the same loads without a lean. A lean falsifies it, but not the second. (Models for ridges
with holes are trained on the true offset along the bars.)

Each network runs once per mirror image of the frames, so that the estimate obeys the device's symmetry exactly. One
expert covers contacts on both pads, another contacts on one pad only. The latter may guide a correction but is never in
range. Estimation needs only numpy.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, PADS, ROWS
from deltacharger_tactile import features, npz
from deltacharger_tactile.dataset import ANGLE_LIMIT, POSITION_LIMIT
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.estimate import Estimate, Limits, angle_classes, position_classes, shaped
from deltacharger_tactile.expert import Expert
from deltacharger_tactile.network import Network
from deltacharger_tactile.support import Support

FORMAT = 3
THRESHOLD = 0.25
"""Lower readings are noise, N: five times the offset that a contact leaves after a tare."""
NOMINAL = 0.95
"""Share of errors within `PoseEstimator.interval` standard deviations, on rigs unseen in training."""
_EXPERTS = ("both", "one")
_FORCES = [features.names().index(f"{side}_force_N") for side in ("left", "right")]
_FEWEST = 512  # dockings to fit an expert: one batch of the networks
_FEWEST_HELD_OUT = 50
_SEAT_LIMIT = np.array([0.035, POSITION_LIMIT, ANGLE_LIMIT])
"""Limits of a seat in range, m, m, rad. Lean and offset together reach 35 mm before a pad is unloaded."""


class PoseEstimator:
    """Estimates (horizontal, vertical, angle) from tared, unthresholded frames.

    Args:
        name: name and version in messages.
        threshold: readings below it count as 0, N.
        hidden: widths of the hidden layers of each network.
        members: networks per expert.
        epochs: passes over the training data.

    Attributes:
        limits: when an estimate may be used.
        interval: (3,) standard deviations of (horizontal, vertical, angle) that contain the nominal share of errors,
            split-conformal on rigs unseen in training; inf before `fit`.
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
        self.interval = np.full(3, math.inf)
        self._experts: dict[str, Expert] = {}
        self._support: Support | None = None
        self._about: dict[str, Any] = {}

    @property
    def about(self) -> dict[str, Any]:
        """Origin of the model (parameters' digest, seeds)."""
        return dict(self._about)

    def fit(
        self,
        frames: ArrayLike,
        pose: ArrayLike,
        held_out: tuple[ArrayLike, ArrayLike],
        seed: int = 0,
        progress: Callable[[float, str], None] = lambda share, text: None,
    ) -> PoseEstimator:
        """Learn from dockings, then scale the standard deviations on other rigs.

        Args:
            frames: (N, 2, 10, 10) N, tared, averaged, not thresholded; NaN where dead.
            pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact.
            held_out: frames and poses of other rigs.
            seed: initial weights.
            progress: called with the share done and the current step.

        Raises:
            ModelError: too few different dockings on both pads or on one, in the training or held-out data.
        """
        random = np.random.default_rng([0xF17, seed])
        readings, seats = np.asarray(frames, dtype=float), to_seat(np.asarray(pose, dtype=float))
        inputs, holds, touched = self._prepare(readings)
        within, single = holds & _within(seats), touched & ~holds
        self._require(readings, within, single, _FEWEST, "dockings")
        for index, (name, rows) in enumerate(zip(_EXPERTS, (holds, single), strict=True)):
            progress(index / 3.0, f"{self.name}: {np.count_nonzero(rows)} dockings in contact with {name} pad(s)")
            self._experts[name] = Expert.learn(
                inputs[:, rows], seats[rows], self.hidden, self.members, self.epochs, random
            )
        progress(2.0 / 3.0, f"{self.name}: typical frames")
        usual = inputs[:, within]
        seen = np.concatenate([self._experts["both"].predict(usual)[0] * sign for sign in features.MIRROR_SIGNS])
        self._support = Support.learn(usual.reshape(-1, usual.shape[-1]), seen, self.epochs, random)
        self._calibrate(np.asarray(held_out[0], dtype=float), to_seat(np.asarray(held_out[1], dtype=float)))
        progress(1.0, f"{self.name}: done")
        return self

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
        inputs, holds, contact, mean, spread = self._estimate(frames)
        limits = self.limits
        in_range = contact & holds & _within(mean)
        if in_range.any():
            in_range[in_range] = self._learnt.contains(inputs[0, in_range], mean[in_range])
        precise = spread[:, 1:] <= [limits.across_stddev, limits.angle_stddev]
        sure = in_range & precise.all(axis=1)
        force = inputs[0][:, _FORCES]
        pose, stddev = to_pose(mean), _pose_stddev(mean, spread)
        columns: list[NDArray[Any]] = [column[:, axis] for axis in (2, 1, 0) for column in (pose, stddev)]
        columns += [in_range, contact, sure]
        columns += [angle_classes(pose[:, 2], stddev[:, 2])]
        columns += [position_classes(pose[:, axis], stddev[:, axis]) for axis in (1, 0)]
        columns += [force[:, 0], force[:, 1], mean[:, 1], spread[:, 1]]
        return Estimate(*(shaped(column, shape) for column in columns))

    def pose(self, frames: Array) -> tuple[Array, Array]:
        """Return features (N, F) of `features.extract` at `threshold`, and the estimated pose.

        Args:
            frames: (N, 2, 10, 10) N, both pads as in `predict`.

        Returns:
            features, and (N, 3) m, m, rad, NaN without contact; half the work of `predict`.
        """
        inputs, _, _, mean, _ = self._estimate(frames)
        return inputs[0, :, :-PADS], to_pose(mean)  # without the counts of filled taxels

    def _estimate(self, frames: Array) -> tuple[Array, Mask, Mask, Array, Array]:
        """Return inputs of the mirror images, whether both pads hold the ridge, contact, seat and its spread (N, 3)."""
        inputs, holds, touched = self._prepare(frames)
        contact = np.asarray(np.any(frames >= CONTACT_FORCE, axis=(1, 2, 3)))  # NaN is not
        mean, spread = np.full((len(frames), 3), np.nan), np.full((len(frames), 3), np.nan)
        for name, rows in zip(_EXPERTS, (holds & contact, touched & contact & ~holds), strict=True):
            if rows.any():
                mean[rows], spread[rows] = self._experts[name].predict(inputs[:, rows])
        return inputs, holds, contact, mean, spread

    def distance(self, left: ArrayLike, right: ArrayLike) -> Array:
        """Mahalanobis distance (N,) of frames from the training data: how far a device has drifted."""
        return self._learnt.distance(self._prepare(features.stack(left, right))[0][0])

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
            raise ModelError(self.name, "it is not trained")
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

    def _require(self, frames: Array, within: Mask, single: Mask, needed: int, what: str) -> None:
        for rows, where in ((within, "on both pads, in range"), (single, "on one pad")):
            found = len(features.distinct(frames[rows], self.threshold))
            if found < needed:
                raise ModelError(self.name, f"{found} different {what} {where}, at least {needed} are needed")

    def _calibrate(self, frames: Array, seat: Array) -> None:
        inputs, holds, touched = self._prepare(frames)
        within, single = holds & _within(seat), touched & ~holds
        self._require(frames, within, single, _FEWEST_HELD_OUT, "held-out dockings")
        for name, rows in zip(_EXPERTS, (holds, single), strict=True):
            self._experts[name] = self._experts[name].scaled(inputs[:, rows], seat[rows])
        usual = inputs[:, within]
        mean, spread = self._experts["both"].predict(usual)
        self._support = self._learnt.limited(usual[0], mean)
        error = to_pose(mean) - to_pose(seat[within])
        ratio = np.sort(np.abs(error) / _pose_stddev(mean, spread), axis=0)
        self.interval = ratio[min(math.ceil((len(ratio) + 1) * NOMINAL), len(ratio)) - 1]

    def describe(self, about: dict[str, Any]) -> None:
        """Set the model's origin, saved with it."""
        self._about = dict(about)

    def save(self, path: str | Path) -> None:
        """Write one npz file that loads without pickle."""
        support = self._learnt
        arrays: dict[str, Any] = {
            "support_centre": support.centre,
            "support_whitening": support.whitening.astype(np.float32),
            "support_shown_centre": support.shown_centre,
            "support_shown_spread": support.shown_spread,
        } | support.picture.arrays("picture")
        for name, expert in self._experts.items():
            arrays |= expert.arrays(name)
        header = {
            "format": FORMAT,
            "name": self.name,
            "threshold": self.threshold,
            "hidden": self.hidden,
            "members": self.members,
            "epochs": self.epochs,
            "interval": self.interval.tolist(),
            "support": [support.distance_limit, support.picture_limit],
            "features": features.names(),
            "about": self._about,
        }
        np.savez_compressed(path, meta=np.array(json.dumps(header, sort_keys=True)), **arrays)

    @staticmethod
    def load(path: str | Path) -> PoseEstimator:
        """Read a file written by `save`.

        Raises:
            FileNotFoundError: no such file.
            ModelError: the file is not a model of this format.
        """
        try:
            header, arrays = npz.read(path, "meta", npz.LARGEST_MODEL)
        except npz.NpzError as error:
            raise ModelError(str(path), str(error)) from error
        if header.get("format") != FORMAT or header.get("features") != features.names():
            made = f"format {header.get('format')!r}, and this version reads {FORMAT}"
            raise ModelError(str(path), f"made by another version of this package ({made}), or no pose model")
        if not all(np.issubdtype(array.dtype, np.number) and np.all(np.isfinite(array)) for array in arrays.values()):
            raise ModelError(str(path), "an array holds NaN, infinity or no numbers")
        try:
            model = _restore(header, arrays)
            _try(model)
        except Exception as error:  # arrays of a foreign file may raise anything
            raise ModelError(str(path), "its arrays and description do not fit together") from error
        return model


def _restore(header: dict[str, Any], arrays: dict[str, Any]) -> PoseEstimator:
    model = PoseEstimator(header["name"], header["threshold"], header["hidden"], header["members"], header["epochs"])
    model.describe(header["about"])
    model.interval = np.array(header["interval"], dtype=float).reshape(3)
    model._support = Support(
        arrays["support_centre"],
        arrays["support_whitening"].astype(float),
        arrays["support_shown_centre"],
        arrays["support_shown_spread"],
        Network.restore("picture", arrays),
        *header["support"],
    )
    for name in _EXPERTS:
        model._experts[name] = Expert.restore(name, arrays, model.members)
    return model


def _try(model: PoseEstimator) -> None:
    """Estimate a contact on both pads and one on a single pad; raises if the arrays do not fit together."""
    pads = np.ones((2, 2, ROWS, COLUMNS))
    pads[1, 1] = 0.0
    model.predict(*pads)
    model.drifted(*pads)
    rows, columns = model._learnt.whitening.shape
    if rows != columns:
        raise ValueError("whitening")


def to_seat(pose: Array) -> Array:
    """Convert poses (N, 3) m, m, rad (horizontal, vertical, angle) to seats (N, 3): along, across, angle."""
    x, y, angle = pose.T
    return np.column_stack([x, y * np.cos(angle) - x * np.sin(angle), angle])


def to_pose(seat: Array) -> Array:
    """Convert seats (N, 3) to poses (N, 3)."""
    x, across, angle = seat.T
    return np.column_stack([x, (across + x * np.sin(angle)) / np.cos(angle), angle])


def _pose_stddev(seat: Array, spread: Array) -> Array:
    """Return standard deviations (N, 3) of poses: with roll, the error along the bars enters the vertical."""
    angle = seat[:, 2]
    vertical = np.hypot(spread[:, 1], spread[:, 0] * np.sin(angle)) / np.cos(angle)
    return np.column_stack([spread[:, 0], vertical, spread[:, 2]])


def _within(seat: Array) -> Mask:
    """Whether seats (N, 3) are within the usable range; False for NaN."""
    return np.asarray(np.all(np.abs(seat) <= _SEAT_LIMIT, axis=1))
