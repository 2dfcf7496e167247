# SPDX-License-Identifier: Apache-2.0
"""Calibration of one rig: gains and dead taxels of its pads, load shift by tilt, constant errors.

`apply` corrects frames before the pose model, `correct` its estimates. `fit` makes a calibration. Using one needs only
numpy; its file needs PyYAML.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_core import arrays, files, machine, yaml_file
from deltacharger_tactile import errors, estimator, parameters
from deltacharger_tactile.parameters import SHAPE

VERSION = 1
AXES = ("horizontal", "vertical", "angle")
SIDES = ("left", "right")
GAIN_LOW, GAIN_HIGH = 0.2, 5.0
SHIFT_LIMIT = 30.0
"""Largest load shift, N: about 0.15° of tilt on the simulated pads."""
_BIAS_LIMIT = {"horizontal": 0.02, "vertical": 0.02, "angle": 0.2}
_LOADED = 0.25
"""Readings below it are noise and do not count as load, N; as in the pose model."""
_SHARE = 0.3
"""Largest scaling of a pad's readings: beyond it, a light pad's noise would pass for its ridge."""


@dataclass(frozen=True)
class TactileCalibration:
    """Calibration of one rig for one pose model; the default changes nothing.

    Attributes:
        gain: (2, 10, 10) relative gain of each taxel, mean 1 on each pad.
        dead: (2, 10, 10) taxels to ignore.
        load_shift: N that a constant tilt moves from the right pad to the left.
        bias: (3,) m, m, rad: constant error of (horizontal, vertical, angle) in end_effector.
        bias_stddev: (3,) uncertainty of `bias`, added to the estimate's standard deviations.
        rig: number of the rig, as in the data.
        sensor: name of its pads in the data; empty = unknown.
        model: name of the pose model that it was made for.
        date: when it was made, ISO 8601.
        dockings: number of dockings that it was made from.
        data: SHA-256 of the data set.
        simulated: whether the data are simulated.

    Raises:
        SensorCalibrationError: a value is out of bounds or has the wrong shape.
    """

    gain: arrays.Array = field(default_factory=lambda: np.ones(SHAPE))
    dead: arrays.Mask = field(default_factory=lambda: np.zeros(SHAPE, dtype=bool))
    load_shift: float = 0.0
    bias: arrays.Array = field(default_factory=lambda: np.zeros(3))
    bias_stddev: arrays.Array = field(default_factory=lambda: np.zeros(3))
    rig: int = 0
    sensor: str = ""
    model: str = ""
    date: str = ""
    dockings: int = 0
    data: str = ""
    simulated: bool = False

    def __post_init__(self) -> None:
        if self.gain.shape != SHAPE or self.dead.shape != SHAPE:
            raise errors.SensorCalibrationError("gain", f"gain and dead must have the shape {SHAPE}")
        if self.bias.shape != (3,) or self.bias_stddev.shape != (3,):
            raise errors.SensorCalibrationError("bias", "bias and bias_stddev must have three values")
        _bound("gain", self.gain, GAIN_LOW, GAIN_HIGH)
        _bound("load_shift", self.load_shift, -SHIFT_LIMIT, SHIFT_LIMIT)
        for axis, value, stddev in zip(AXES, self.bias, self.bias_stddev, strict=True):
            limit = _BIAS_LIMIT[axis]
            _bound(f"bias.{axis}", value, -limit, limit)
            _bound(f"bias_stddev.{axis}", stddev, 0.0, limit)

    def apply(self, left: ArrayLike, right: ArrayLike) -> tuple[arrays.Array, arrays.Array]:
        """Return both pads as a rig without these faults would read them.

        Args:
            left: (..., 10, 10) N, the pad at +x, tared, not thresholded; NaN = dead.
            right: (..., 10, 10) N, the pad at −x.

        Raises:
            FrameError: wrong shape.
        """
        pads = [np.asarray(pad, dtype=float) for pad in (left, right)]
        if pads[0].shape != pads[1].shape or pads[0].shape[-2:] != SHAPE[1:]:
            raise errors.FrameError(pads[0].shape, pads[1].shape)
        for index in range(machine.PADS):
            pads[index] = np.where(self.dead[index], np.nan, pads[index] / self.gain[index])
        if self.load_shift == 0.0:
            return pads[0], pads[1]
        loads = [np.where(pad >= _LOADED, pad, 0.0).sum(axis=(-2, -1)) for pad in pads]
        lighter = np.minimum(*loads)
        most = np.where(lighter >= estimator.Limits().pad_force, _SHARE * lighter, 0.0)
        moved = np.clip(0.5 * self.load_shift, -most, most)
        factors = [
            1.0 + sign * moved / np.maximum(load, _LOADED) for sign, load in zip((-1.0, 1.0), loads, strict=True)
        ]
        return pads[0] * factors[0][..., None, None], pads[1] * factors[1][..., None, None]

    def correct(self, estimate: estimator.Estimate, limits: estimator.Limits | None = None) -> estimator.Estimate:
        """Subtract the constant error from an estimate made from the output of `apply`.

        Standard deviations grow by the error's uncertainty. Classes and `in_range` follow the corrected pose. An
        estimate that was not in range or not sure does not become so.

        Args:
            estimate: floats of one frame pair, or arrays (...).
            limits: of the pose model; None = the defaults.
        """
        if not self.bias.any() and not self.bias_stddev.any():
            return estimate
        allowed = limits or estimator.Limits()
        shape = np.shape(estimate.angle)
        given = {item.name: np.asarray(getattr(estimate, item.name)) for item in dataclasses.fields(estimator.Estimate)}
        pose = {axis: given[axis].ravel() - bias for axis, bias in zip(AXES, self.bias, strict=True)}
        spread = {
            axis: np.hypot(given[f"{axis}_stddev"].ravel(), stddev)
            for axis, stddev in zip(AXES, self.bias_stddev, strict=True)
        }
        turn = given["angle"].ravel()
        by_x, by_y = -np.sin(turn), np.cos(turn)  # share of a correction along x and y that is across the bars
        across = given["across"].ravel() - by_x * self.bias[0] - by_y * self.bias[1]
        doubt = np.hypot(by_x * self.bias_stddev[0], by_y * self.bias_stddev[1])
        across_spread = np.hypot(given["across_stddev"].ravel(), doubt)
        within = (np.abs(across) <= parameters.POSITION_LIMIT) & (np.abs(pose["angle"]) <= parameters.ANGLE_LIMIT)
        precise = (across_spread <= allowed.across_stddev) & (spread["angle"] <= allowed.angle_stddev)
        in_range = given["in_range"].ravel() & within
        changed: dict[str, NDArray[Any]] = {"in_range": in_range, "sure": given["sure"].ravel() & in_range & precise}
        changed |= {"across": across, "across_stddev": across_spread}
        for axis in AXES:
            classes = estimator.angle_classes if axis == "angle" else estimator.position_classes
            changed |= {axis: pose[axis], f"{axis}_stddev": spread[axis]}
            changed[f"{axis}_probability"] = classes(pose[axis], spread[axis])
        return dataclasses.replace(
            estimate, **{name: estimator.shaped(value, shape) for name, value in changed.items()}
        )

    def save(self, path: str | Path, comment: str = "") -> None:
        """Write the calibration as YAML, with `comment` above it.

        Raises:
            OSError: the file cannot be written.
        """
        yaml_file.write_yaml(path, _as_mapping(self), comment)

    @staticmethod
    def load(path: str | Path) -> TactileCalibration:
        """Read a file written by `save`.

        Raises:
            FileNotFoundError: no such file.
            SensorCalibrationError: a key is unknown, missing or invalid; names file and key.
        """
        source = str(path)
        try:
            content = yaml_file.read_yaml(path)
        except yaml_file.YamlError as error:
            raise errors.SensorCalibrationError(
                source, f"{error.problem}; make it again with `calibrate tactile`"
            ) from error
        try:
            return _from_mapping(content)
        except errors.SensorCalibrationError as error:
            raise errors.SensorCalibrationError(source, str(error)) from error


def _bound(name: str, value: ArrayLike, low: float, high: float) -> None:
    values = np.asarray(value, dtype=float)
    if not np.all((values >= low) & (values <= high)):  # NaN is neither
        raise errors.SensorCalibrationError(name, f"outside {low:g} to {high:g}; calibrate again")


def _as_mapping(calibration: TactileCalibration) -> dict[str, Any]:
    return {
        "version": VERSION,
        **{name: getattr(calibration, name) for name in _PLAIN},
        "bias": dict(zip(AXES, calibration.bias.tolist(), strict=True)),
        "bias_stddev": dict(zip(AXES, calibration.bias_stddev.tolist(), strict=True)),
        "dead": np.argwhere(calibration.dead).tolist(),
        "gain": {side: np.round(calibration.gain[pad], 4).tolist() for pad, side in enumerate(SIDES)},
    }


_PLAIN: dict[str, type] = {
    "load_shift": float,
    "rig": int,
    "sensor": str,
    "model": str,
    "date": str,
    "dockings": int,
    "data": str,
    "simulated": bool,
}


def _from_mapping(content: Any) -> TactileCalibration:
    keys = ("version", *_PLAIN, "bias", "bias_stddev", "dead", "gain")
    if not isinstance(content, dict) or set(content) != set(keys):
        raise errors.SensorCalibrationError(
            "the file", f"must be a mapping of exactly {', '.join(keys)}; calibrate again"
        )
    if content["version"] != VERSION:
        raise errors.SensorCalibrationError(
            "version", f"{files.brief(content['version'])} is not {VERSION}; calibrate again"
        )
    for name, kind in _PLAIN.items():
        if type(content[name]) is not kind:
            raise errors.SensorCalibrationError(name, f"{files.brief(content[name])} is not of type {kind.__name__}")
    return TactileCalibration(
        gain=_numbers("gain", content, SIDES),
        dead=_taxels(content["dead"]),
        bias=_numbers("bias", content, AXES),
        bias_stddev=_numbers("bias_stddev", content, AXES),
        **{name: content[name] for name in _PLAIN},
    )


def _numbers(where: str, content: dict[str, Any], names: tuple[str, ...]) -> arrays.Array:
    """Return the numbers of `names` in the mapping `where`, one row each; `TactileCalibration` checks their bounds."""
    try:
        return np.array([content[where][name] for name in names], dtype=float)
    except (TypeError, ValueError, KeyError, OverflowError, RecursionError) as error:
        raise errors.SensorCalibrationError(
            where, f"must have numbers for {', '.join(names)}; calibrate again"
        ) from error


def _taxels(value: Any) -> arrays.Mask:
    dead = np.zeros(SHAPE, dtype=bool)
    for place in value if isinstance(value, list) else [value]:
        whole = isinstance(place, list) and len(place) == len(SHAPE) and all(type(part) is int for part in place)
        if not whole or not all(0 <= part < size for part, size in zip(place, SHAPE, strict=True)):
            raise errors.SensorCalibrationError("dead", f"{files.brief(place)} is not [pad 0–1, row 0–9, column 0–9]")
        dead[tuple(place)] = True
    return dead
