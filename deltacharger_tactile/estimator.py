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

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, PADS, ROWS
from deltacharger_tactile import features, npz
from deltacharger_tactile.dataset import ANGLE_LIMIT, POSITION_LIMIT
from deltacharger_tactile.errors import ModelError
from deltacharger_tactile.estimate import Estimate, Limits, angle_classes, position_classes, shaped
from deltacharger_tactile.networks import Expert, Network, Support

Self = TypeVar("Self", bound="PoseEstimator")

FORMAT = 3
THRESHOLD = 0.25
"""Lower readings are noise, N: five times the offset that a contact leaves after a tare."""
EXPERTS = ("both", "one")
"""Networks by the pads that a contact touches."""
_FORCES = [features.names().index(f"{side}_force_N") for side in ("left", "right")]
_SEAT_LIMIT = np.array([0.035, POSITION_LIMIT, ANGLE_LIMIT])
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
        inputs, holds, contact, mean, spread = self._estimate(frames)
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
        for name, rows in zip(EXPERTS, (holds & contact, touched & contact & ~holds), strict=True):
            if rows.any():
                mean[rows], spread[rows] = self._experts[name].predict(inputs[:, rows])
        return inputs, holds, contact, mean, spread

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

    @classmethod
    def load(cls: type[Self], path: str | Path) -> Self:
        """Read the npz file of a trained model.

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
            model = cls(header["name"], header["threshold"])
            model._restore(header, arrays)
            model._try()
        except Exception as error:  # arrays of a foreign file may raise anything
            raise ModelError(str(path), "its arrays and description do not fit together") from error
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


def to_seat(pose: Array) -> Array:
    """Convert poses (N, 3) m, m, rad (horizontal, vertical, angle) to seats (N, 3): along, across, angle."""
    x, y, angle = pose.T
    return np.column_stack([x, y * np.cos(angle) - x * np.sin(angle), angle])


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
