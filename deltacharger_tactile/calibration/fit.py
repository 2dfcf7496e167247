# SPDX-License-Identifier: Apache-2.0
"""Calibrate one rig from dockings at known poses, and measure the benefit on other dockings.

Gains: least squares against the contact model at the estimated poses. The load of each pad in each docking is free; the
usual spread of gains is the prior. Commanded poses would not do: the jitter of a docking is nearly half a taxel and
would pass for gains. Load shift: the value that fits the commanded horizontal offsets best. Every result shrinks more,
the less it exceeds its standard error (positive-part shrinkage, James and Stein 1961).

Find faulty taxels of a rig from its dockings, and compare its tares.
Nothing here uses the contact model. A taxel is compared with its neighbours along the row, parallel to the ridge. The
commanded pose shows where the ridge cannot be.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_tactile import dataset, errors, estimator, parameters
from deltacharger_tactile.calibration.rig import AXES, SHIFT_LIMIT, TactileCalibration
from deltacharger_tactile.contact import ContactModel

_DEAD_SHARE = 0.05  # of the dockings in which the board reported a taxel dead; the estimator handles single glitches
_EVENTS = 3  # dockings that must show it
_SILENT_SHARE = 0.8  # of the dockings that pressed its neighbours
_SILENT = 0.1  # of what the neighbours read
_AWAY = 0.010  # m from the ridge's line: half its height, its spread in the skin, three jitters, half a taxel
_LOUD = 0.5  # N without pressure: ten times what a contact leaves behind
_NOISY = 0.25  # N, scatter of a docking's reading without pressure; the model uses readings from here on
_DRIFT = 0.25  # N between sessions; chosen like _NOISY
_BASELINE = 0.5  # N from the other taxels' baseline


@dataclass(frozen=True)
class KnownDockings:
    """Dockings of one rig at known poses, one row each.

    Attributes:
        frames: (N, 2, 10, 10) N, tared; NaN where dead.
        pose: (N, 3) m, m, rad: (horizontal, vertical, angle) as commanded.
        truth: (N, 3) m, m, rad in contact; NaN if the data lack it.
        tares: (S, 2, 10, 10) N, baseline of each session; NaN = unknown.
        rig: number of the rig.
        threshold: readings below it were recorded as 0, N.
    """

    frames: arrays.Array
    pose: arrays.Array
    truth: arrays.Array
    tares: arrays.Array
    rig: int
    threshold: float

    def __len__(self) -> int:
        return len(self.frames)

    def part(self, rows: NDArray[np.int64]) -> KnownDockings:
        """Return the given rows."""
        return KnownDockings(self.frames[rows], self.pose[rows], self.truth[rows], self.tares, self.rig, self.threshold)


@dataclass(frozen=True)
class PadFaults:
    """(2, 10, 10) masks of faulty taxels.

    Attributes:
        reported: dead according to the board.
        silent: reads almost nothing while its neighbours along the row read much.
        loud: reads something without pressure, or never changes.
        noisy: scatters without pressure.
    """

    reported: arrays.Mask
    silent: arrays.Mask
    loud: arrays.Mask
    noisy: arrays.Mask

    @property
    def dead(self) -> arrays.Mask:
        """All faulty taxels."""
        return self.reported | self.silent | self.loud | self.noisy


@dataclass(frozen=True)
class Tares:
    """Comparison of the sessions' baselines; NaN if the data do not show it.

    Attributes:
        sessions: number of sessions.
        drift: (2, 10, 10) N, largest less smallest baseline of a taxel.
        drifted: (2, 10, 10) taxels whose baseline moved by more than the pose model tolerates.
        outlying: (2, 10, 10) taxels whose baseline is far from the other taxels'.
    """

    sessions: int
    drift: arrays.Array
    drifted: arrays.Mask
    outlying: arrays.Mask


def select(data: dataset.Dataset, rig: int | None = None) -> KnownDockings:
    """Select the dockings of one rig; rows of the same docking are averaged.

    Args:
        data: with commanded poses.
        rig: its number; None = the only one.

    Raises:
        SensorCalibrationError: no such rig, or several and none selected.
    """
    rigs = np.unique(data.rig).tolist()
    if rig is None and len(rigs) > 1:
        raise errors.SensorCalibrationError("the data", f"they hold the rigs {_listed(rigs)}; pick one with --rig N")
    chosen = rigs[0] if rig is None else rig
    if chosen not in rigs:
        raise errors.SensorCalibrationError(f"rig {chosen}", f"not in the data, which hold {_listed(rigs)}")
    rows = np.flatnonzero(data.rig == chosen)
    _, first, docking = np.unique(data.attempt[rows], return_index=True, return_inverse=True)
    readings = np.stack([data.left[rows], data.right[rows]], axis=1).astype(float)
    readings[data.dead[rows]] = np.nan
    frames = np.zeros((len(first), *parameters.SHAPE))
    np.add.at(frames, docking, readings)
    frames /= np.bincount(docking)[:, None, None, None]
    once = rows[first]
    _, opening = np.unique(data.session[once], return_index=True)
    return KnownDockings(
        frames=frames,
        pose=np.column_stack([data.horizontal, data.vertical, data.angle])[once],
        truth=data.contact_pose[once],
        tares=data.tare[once][opening].astype(float),
        rig=int(chosen),
        threshold=float(np.nan_to_num(data.threshold)),
    )


def _listed(rigs: list[int]) -> str:
    return ", ".join(map(str, rigs[:8])) + (" …" if len(rigs) > 8 else "")


def find(dockings: KnownDockings) -> PadFaults:
    """Check every taxel."""
    frames = dockings.frames
    dead = ~np.isfinite(frames)
    marked = dead.mean(axis=0) >= _DEAD_SHARE
    away = _away(dockings.pose) & ~dead
    enough = away.sum(axis=0) >= _EVENTS
    quiet = np.where(away, frames, np.nan)
    quiet[:, ~enough] = 0.0
    middle, upper = np.nanquantile(quiet, (0.5, 0.84), axis=0)
    loud = middle > _LOUD
    scatter = upper - middle  # one standard deviation: of readings cut off at 0, only the upper side shows
    live = np.where(dead, 0.0, frames)
    # A taxel stuck at one value after the tare; one stuck at 0 is silent.
    stuck = (np.ptp(live, axis=0) < 1e-6) & (live[0] > 0.0) & (len(frames) > 1)
    return PadFaults(
        marked, _silent(frames, dockings.threshold) & ~marked, (loud | stuck) & ~marked, (scatter > _NOISY) & ~marked
    )


def _silent(frames: arrays.Array, threshold: float) -> arrays.Mask:
    """Return taxels that read nothing while their two nearest neighbours in the row read much."""
    live = np.where(np.isfinite(frames), frames, 0.0)
    beside = np.empty_like(live)
    beside[..., 1:-1] = np.minimum(live[..., :-2], live[..., 2:])
    beside[..., 0] = np.minimum(live[..., 1], live[..., 2])
    beside[..., -1] = np.minimum(live[..., -2], live[..., -3])
    pressed = beside >= max(machine.CONTACT_FORCE, 3.0 * threshold)
    nothing = pressed & (live < _SILENT * beside)
    count = pressed.sum(axis=0)
    return np.asarray((count >= _EVENTS) & (nothing.sum(axis=0) >= _SILENT_SHARE * count))


def _away(pose: arrays.Array) -> arrays.Mask:
    """Return (N, 2, 10, 10): taxels that the ridges cannot reach at the commanded poses (N, 3)."""
    contact = parameters.PadContactParameters()
    line = contact.pad_side * (0.5 - (np.arange(machine.ROWS) + 0.5) / machine.ROWS)
    v, u = np.meshgrid(line, line[: machine.COLUMNS], indexing="ij")
    x = np.stack([u + contact.pad_distance, u - contact.pad_distance])
    horizontal, vertical, angle = (pose[:, axis, None, None, None] for axis in range(3))
    return np.asarray(np.abs(np.cos(angle) * (v - vertical) - np.sin(angle) * (x - horizontal)) > _AWAY)


def compare_tares(dockings: KnownDockings, dead: arrays.Mask) -> Tares:
    """Compare the sessions' baselines without the taxels in `dead`."""
    tares = np.where(dead, np.nan, dockings.tares)
    known = np.isfinite(tares).all(axis=0)
    drift = np.where(known, np.ptp(np.where(known, tares, 0.0), axis=0), np.nan)
    middle = np.median(tares[:, known]) if known.any() else np.nan
    outlying = known & (np.abs(np.where(known, tares, 0.0).mean(axis=0) - middle) > _BASELINE)
    return Tares(len(tares), drift, known & (np.nan_to_num(drift) > _DRIFT), outlying)


FEWEST = 5
"""Fewest dockings in range for a calibration."""
JITTER = np.array(
    [
        parameters.PadDockingParameters().position_jitter,
        parameters.PadDockingParameters().position_jitter,
        parameters.PadDockingParameters().angle_jitter,
    ]
)
"""Standard deviation of (horizontal, vertical, angle) of a docking about its commanded pose: m, m, rad."""
MISFIT_LIMIT = 0.19
"""Share of the readings (rms) that contact model and gains may leave unexplained. Simulated rigs leave at most 0.16,
0.19 if gains spread by 25 % (ten dockings), and at least 0.20 if the ridge is 8 instead of 6 mm."""
_PRIOR = parameters.SensorParameters().gain_spread
_FLOOR = 0.12  # N, constant part of a reading's error: offsets of a contact, noise
_MODEL_ERROR = 0.2  # of a reading: errors of pose, ridge and elastomer
_ROUNDS = 4
_GAINS = (0.3, 3.0)
_LEAST_LOAD = 3.0  # N; a lighter pad does not show gains
_STEP = 3.0  # N, of the search for the load shift
_OUTLIER = 9.0  # cap of a squared deviation, in variances
_SHIFT_DOUBT = 2.0  # squared standard errors below which a load shift counts as none
_BIAS_DOUBT = 4.0  # same for a constant error, which moves every estimate
_FOLDS = 5


@dataclass(frozen=True)
class PadFit:
    """A calibration and its evidence.

    Attributes:
        calibration: to be used.
        in_range: dockings in range of the pose model.
        misfit: share of the readings (rms) that contact model and gains leave unexplained.
        load_shift: N, before shrinking.
        load_shift_error: its standard error.
        bias: (3,) m, m, rad, before shrinking.
        bias_error: (3,) its standard error, including the jitter of dockings.
    """

    calibration: TactileCalibration
    in_range: int
    misfit: float
    load_shift: float
    load_shift_error: float
    bias: arrays.Array
    bias_error: arrays.Array


@dataclass(frozen=True)
class Worth:
    """Rms errors with and without the calibration, on dockings that it was not made from and that are in range.

    Attributes:
        before: (3,) m, m, rad without.
        after: (3,) with.
        count: dockings compared.
        in_range: shares of all dockings in range, without and with.
        known: whether errors are against the pose in contact; otherwise both include the jitter of dockings.
        worse: (3,) whether the calibration is worse by a fifth and by three standard errors.
    """

    before: arrays.Array
    after: arrays.Array
    count: int
    in_range: tuple[float, float]
    known: bool
    worse: arrays.Mask


def predict(
    model: estimator.PoseEstimator, calibration: TactileCalibration, frames: arrays.Array
) -> tuple[arrays.Array, arrays.Array, arrays.Mask]:
    """Return calibrated poses (N, 3), standard deviations (N, 3) and in_range (N,) of frames (N, 2, 10, 10) N."""
    pads = calibration.apply(frames[:, 0], frames[:, 1])
    estimate = calibration.correct(model.predict(*pads), model.limits)
    pose = np.column_stack([getattr(estimate, axis) for axis in AXES])
    spread = np.column_stack([getattr(estimate, f"{axis}_stddev") for axis in AXES])
    return pose, spread, np.asarray(estimate.in_range)


def fit(dockings: KnownDockings, model: estimator.PoseEstimator) -> PadFit:
    """Learn from dockings of one rig.

    Args:
        dockings: at least FEWEST in range.
        model: pose model to calibrate for.

    Raises:
        SensorCalibrationError: too few dockings are in range, or the data lack readings that the robot uses.
    """
    if dockings.threshold > model.threshold:
        raise errors.SensorCalibrationError(
            f"rig {dockings.rig}",
            f"the data lack readings below {dockings.threshold:g} N, the robot needs {model.threshold:g} N and up; "
            f"generate with --threshold {model.threshold:g}",
        )
    made = TactileCalibration(dead=find(dockings).dead, rig=dockings.rig, model=model.name, dockings=len(dockings))
    pose, _, usable = predict(model, made, dockings.frames)
    count = int(usable.sum())
    if count < FEWEST:
        raise errors.SensorCalibrationError(
            f"rig {dockings.rig}",
            f"{count} of {len(dockings)} dockings are in range of the pose model, at least {FEWEST} must be; "
            "dock within ±8 mm and ±10°, or check the pads",
        )
    frames = np.where(made.dead, np.nan, dockings.frames)[usable]
    gain, misfit = _gains(frames, pose[usable], dockings.threshold)
    if misfit <= MISFIT_LIMIT:
        made = dataclasses.replace(made, gain=gain)
    shift, shift_error, per_newton = _load_shift(dockings, model, made)
    kept = _kept(shift, shift_error, _SHIFT_DOUBT) if misfit <= MISFIT_LIMIT else 0.0
    made = dataclasses.replace(made, load_shift=kept * shift)
    bias, error = _bias(dockings, model, made)
    share = np.array([_kept(*pair, _BIAS_DOUBT) for pair in zip(bias, error, strict=True)])
    variance = np.where(share > 0.0, share * error, 0.0) * np.where(share > 0.0, error, 0.0)
    if kept:
        variance[0] += kept * (per_newton * shift_error) ** 2
    made = dataclasses.replace(made, bias=share * bias, bias_stddev=np.sqrt(variance))
    return PadFit(made, count, misfit, shift, shift_error, bias, error)


def judge(dockings: KnownDockings, model: estimator.PoseEstimator) -> Worth:
    """Calibrate with four fifths of the dockings and test on the rest, five times."""
    order = np.random.default_rng(0).permutation(len(dockings))
    neutral = TactileCalibration(dead=find(dockings).dead)
    known = bool(np.isfinite(dockings.truth).all())
    truth = dockings.truth if known else dockings.pose
    without, _, had = predict(model, neutral, dockings.frames)
    with_it, has = np.empty_like(without), np.empty_like(had)
    for fold in range(_FOLDS):
        others, held_out = np.delete(order, np.s_[fold::_FOLDS]), order[fold::_FOLDS]
        try:
            made = fit(dockings.part(others), model).calibration
        except errors.SensorCalibrationError:  # too few of the others are in range for a calibration
            made = neutral
        with_it[held_out], _, has[held_out] = predict(model, made, dockings.frames[held_out])
    both = had & has
    before, after = (with_or[both] - truth[both] for with_or in (without, with_it))
    change = after**2 - before**2
    error = change.std(axis=0) / np.sqrt(max(len(change), 1))
    rms_before, rms_after = (np.sqrt(np.mean(part**2, axis=0)) for part in (before, after))
    return Worth(
        before=rms_before,
        after=rms_after,
        count=int(both.sum()),
        in_range=(float(had.mean()), float(has.mean())),
        known=known,
        worse=np.asarray((change.mean(axis=0) > 3.0 * error) & (rms_after > 1.2 * rms_before)),
    )


def _kept(value: float, error: float, doubt: float) -> float:
    """Return the share of a value to keep: 0 below √doubt standard errors, nearly 1 far above."""
    return max(0.0, 1.0 - doubt * (error / value) ** 2) if value else 0.0


def _gains(frames: arrays.Array, pose: arrays.Array, threshold: float) -> tuple[arrays.Array, float]:
    """Return gains (2, 10, 10), mean 1 on each pad, and the misfit, of frames (N, 2, 10, 10) N at poses (N, 3)."""
    docking = parameters.PadDockingParameters()
    tilt = pose[:, 1::-1] * [docking.tilt_per_y, docking.tilt_per_x]
    live = np.isfinite(frames)
    readings = np.where(live, frames, 0.0)
    model = ContactModel().solve(pose, readings.sum(axis=(1, 2, 3)), tilt) * live
    gain = np.ones(parameters.SHAPE)
    for _ in range(_ROUNDS):
        expected = _loaded(model, readings, gain)
        # Readings that the recording's threshold cut to 0 would pass for a low gain.
        weight = (live & (expected >= 1.5 * threshold)) / (_FLOOR**2 + (_MODEL_ERROR * expected) ** 2)
        information = np.sum(weight * expected**2, axis=0) + _PRIOR**-2
        gain = (np.sum(weight * expected * readings, axis=0) + _PRIOR**-2) / information
        gain /= (np.sum(gain * information, axis=(1, 2)) / np.sum(information, axis=(1, 2)))[:, None, None]
        gain = np.clip(gain, *_GAINS)
    left_over = readings - gain * _loaded(model, readings, gain)
    counted = live & (readings >= threshold)
    return gain, float(np.sqrt(np.sum((left_over * counted) ** 2) / np.sum((readings * counted) ** 2)))


def _loaded(model: arrays.Array, readings: arrays.Array, gain: arrays.Array) -> arrays.Array:
    """Return the model's readings scaled to the load of each pad in each docking; 0 if the load is too small."""
    seen = model * gain
    scale = np.sum(readings * seen, axis=(2, 3)) / np.maximum(np.sum(seen * seen, axis=(2, 3)), 1e-9)
    return np.asarray(model * np.where(seen.sum(axis=(2, 3)) >= _LEAST_LOAD, scale, 0.0)[:, :, None, None])


def _load_shift(
    dockings: KnownDockings, model: estimator.PoseEstimator, made: TactileCalibration
) -> tuple[float, float, float]:
    """Return the load shift that fits the commanded horizontal offsets best, its error (both N), and m per N."""
    tried = np.arange(-SHIFT_LIMIT, SHIFT_LIMIT + 0.5 * _STEP, _STEP)
    found, variance = np.empty((2, len(tried), len(dockings)))
    for index, shift in enumerate(tried):
        pose, spread, _ = predict(model, dataclasses.replace(made, load_shift=float(shift)), dockings.frames)
        found[index], variance[index] = pose[:, 0], spread[:, 0] ** 2 + JITTER[0] ** 2
    squared = (found - dockings.pose[:, 0]) ** 2 / variance
    costs = np.minimum(np.where(np.isfinite(squared), squared, _OUTLIER), _OUTLIER).sum(axis=1)
    best = int(np.clip(costs.argmin(), 1, len(tried) - 2))
    before, here, after = costs[best - 1 : best + 2]
    curvature = before - 2.0 * here + after
    move = np.clip(0.5 * (before - after) / curvature, -1.0, 1.0) if curvature > 0.0 else 0.0
    shift = float(np.clip(tried[best] + move * _STEP, -SHIFT_LIMIT, SHIFT_LIMIT))
    # The gain in cost over no shift gives the error; for a small shift, the curvature does.
    gained = costs[len(tried) // 2] - here + 0.25 * move * (before - after)
    excess = max(1.0, here / len(dockings))
    if gained > 1.0:
        error = abs(shift) * math.sqrt(excess / gained)
    else:
        error = _STEP * math.sqrt(2.0 * excess / curvature) if curvature > 0.0 else SHIFT_LIMIT
    slope = (found[best + 1] - found[best - 1]) / (2.0 * _STEP)
    return shift, error, float(np.abs(np.mean(slope[np.isfinite(slope)]))) if np.isfinite(slope).any() else 0.0


def _bias(
    dockings: KnownDockings, model: estimator.PoseEstimator, made: TactileCalibration
) -> tuple[arrays.Array, arrays.Array]:
    """Return the mean error (3,) against the commanded poses and its standard error, jitter included."""
    found, spread, usable = predict(model, made, dockings.frames)
    if usable.sum() < FEWEST:
        return np.zeros(3), np.full(3, np.inf)
    error, variance = (found - dockings.pose)[usable], spread[usable] ** 2 + JITTER**2
    weight = 1.0 / variance
    weight /= weight.sum(axis=0)
    bias = np.sum(weight * error, axis=0)
    stated = np.sqrt(np.sum(weight**2 * variance, axis=0))
    effective = 1.0 / np.sum(weight**2, axis=0)
    seen = np.sqrt(np.sum(weight * (error - bias) ** 2, axis=0) / (effective - 1.0))
    return bias, np.maximum(stated, seen)
