# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate tactile`: calibrate a rig's pads from dockings at known poses, and judge the result."""

import argparse
import dataclasses
import datetime
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_bringup.cli import arguments, output
from deltacharger_core.files import sha256
from deltacharger_tactile import MODEL_PATH, dataset, errors, estimator
from deltacharger_tactile.calibration import fit as pad_fit
from deltacharger_tactile.calibration.fit import JITTER, MISFIT_LIMIT, KnownDockings, PadFaults, PadFit, Tares, Worth
from deltacharger_tactile.calibration.rig import AXES, SHIFT_LIMIT, SIDES, TactileCalibration

_FEW = 30  # dockings; with fewer, most gains stay near 1
_JITTERS = 3.0  # docking jitters; limit of the errors of a well-mounted rig
_DEGREE = math.radians(1.0)
_UNITS = {"horizontal": ("mm", 1e-3), "vertical": ("mm", 1e-3), "angle": ("°", _DEGREE)}


def add_tactile(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate tactile`."""
    add = parser.add_argument
    add("--data", required=True, metavar="F.npz", help="dockings at known poses, of `tactile record`")
    add("--out", required=True, metavar="FILE", help="file to write, for misalignment_node")
    add("--rig", type=arguments.integer(0, 2**31 - 1), metavar="N", help="rig, if the data contain several")
    add("--model", metavar="M.npz", help="pose model (default: the packaged one)")
    add("--force", action="store_true", help="overwrite FILE, also if estimates get worse")


@dataclass(frozen=True)
class _Found:
    faults: PadFaults
    tares: Tares
    fit: PadFit
    worth: Worth
    doubts: list[str]


def tactile(options: argparse.Namespace) -> output.Result:
    """Calibrate, judge, and write the calibration unless it makes estimates worse."""
    arguments.file_to_write("--out", options.out, overwrite=options.force)
    with output.wrong_input(errors.TactileError, file=options.data):
        data, model = _read(options)
        found = _calibrate(data, model, options)

    def save(path: str) -> None:
        found.fit.calibration.save(path, _header(options, found))

    refused = bool(found.worth.worse.any())
    return output.conclude(options, refused, save, _as_text(found), _as_mapping(found), found.doubts)


def _read(options: argparse.Namespace) -> tuple[dataset.Dataset, estimator.PoseEstimator]:
    model = MODEL_PATH if options.model is None else arguments.file_to_read("--model", options.model)
    return dataset.Dataset.load(arguments.file_to_read("--data", options.data)), estimator.PoseEstimator.load(model)


def _calibrate(data: dataset.Dataset, model: estimator.PoseEstimator, options: argparse.Namespace) -> _Found:
    dockings = pad_fit.select(data, options.rig)
    faults = pad_fit.find(dockings)
    tares = pad_fit.compare_tares(dockings, faults.dead)
    pads = _doubts_of_pads(faults, tares, model)
    try:
        fit = pad_fit.fit(dockings, model)
    except errors.SensorCalibrationError as error:
        raise output.WrongInput("; ".join([str(error), *pads]), file=options.data) from error
    worth = pad_fit.judge(dockings, model)
    stamped = dataclasses.replace(
        fit.calibration,
        sensor=str(data.meta.get("sensor", "")),
        date=f"{datetime.datetime.now(datetime.timezone.utc):%Y-%m-%dT%H:%MZ}",
        data=sha256(options.data),
        simulated=data.simulated,
    )
    fit = dataclasses.replace(fit, calibration=stamped)
    return _Found(faults, tares, fit, worth, [*pads, *_doubts_of_fit(dockings, fit, worth)])


def _doubts_of_pads(faults: PadFaults, tares: Tares, model: estimator.PoseEstimator) -> list[str]:
    doubts = []
    most = int(faults.dead.sum(axis=(1, 2)).max())
    if most > model.limits.pad_dead:
        doubts.append(f"{most} dead taxels on one pad; estimates need at most {model.limits.pad_dead}: replace the pad")
    if tares.drifted.any():
        doubts.append(f"the tare of {_places(tares.drifted)} moved between sessions: tare again before each docking")
    if tares.outlying.any():
        doubts.append(f"the baseline of {_places(tares.outlying)} differs from the others': check the skin there")
    return doubts


def _doubts_of_fit(dockings: KnownDockings, fit: PadFit, worth: Worth) -> list[str]:
    doubts = []
    if len(dockings) < _FEW:
        doubts.append(f"{len(dockings)} dockings are too few: most gains stay near 1; dock {_FEW} times or more")
    if fit.misfit > MISFIT_LIMIT:
        doubts.append(
            f"{100 * fit.misfit:.0f} % of the pads' readings do not fit this ridge (at most "
            f"{100 * MISFIT_LIMIT:.0f} %): another target? Gains and load shift are unchanged; the pose model may be "
            "wrong for this target"
        )
    if abs(fit.calibration.load_shift) > 0.8 * SHIFT_LIMIT:
        doubts.append("the load shift is at the end of its range: is the end effector level, and both pads fixed?")
    for axis, bias, jitter in zip(AXES, fit.bias, JITTER, strict=True):
        unit, scale = _UNITS[axis]
        if abs(bias) > _JITTERS * jitter:
            doubts.append(
                f"the {axis} error of {bias / scale:+.2f} {unit} is over {_JITTERS:g} times the docking jitter: "
                "are the pads mounted askew, or are the poses not those of the target in end_effector?"
            )
    for axis, worse in zip(AXES, worth.worse, strict=True):
        if worse:
            doubts.append(f"on held-out dockings the {axis} gets worse: record more dockings of this rig only")
    return doubts


def _places(mask: NDArray[np.bool_], most: int = 6) -> str:
    found = [f"{SIDES[pad]} row {row} column {column}" for pad, row, column in np.argwhere(mask).tolist()]
    more = f" and {len(found) - most} more" if len(found) > most else ""
    return ", ".join(found[:most]) + more if found else "none"


def _kinds(faults: PadFaults) -> dict[str, NDArray[np.bool_]]:
    return {name: getattr(faults, name) for name in ("reported", "silent", "loud", "noisy")}


def _seen(calibration: TactileCalibration) -> NDArray[np.float64]:
    """Return the gains of the live taxels."""
    return calibration.gain[~calibration.dead]


def _as_mapping(found: _Found) -> dict[str, Any]:
    """Return the calibration's quality in SI units."""
    worth, made = found.worth, found.fit.calibration
    rms = zip(AXES, worth.before, worth.after, strict=True)
    return {
        "rig": made.rig,
        "simulated": made.simulated,
        "sha256": made.data,
        "dockings": made.dockings,
        "dead": {name: np.argwhere(mask).tolist() for name, mask in _kinds(found.faults).items()},
        "misfit": found.fit.misfit,
        "load_shift": made.load_shift,
        "bias": dict(zip(AXES, map(float, made.bias), strict=True)),
        "held_out": {axis: {"before": float(before), "after": float(after)} for axis, before, after in rms},
        "doubts": found.doubts,
    }


def _largest(drift: NDArray[np.float64]) -> float:
    return float(np.nanmax(drift)) if np.isfinite(drift).any() else float("nan")


def _as_text(found: _Found) -> str:
    fit, worth, made = found.fit, found.worth, found.fit.calibration
    gains, drift = _seen(made), _largest(found.tares.drift)
    tare = f"at most {drift:.2f} N apart" if math.isfinite(drift) else "unknown"
    source = ", simulated" if made.simulated else ""
    rows = [("dockings", f"{made.dockings} of rig {made.rig}{source}, {fit.in_range} in range of {made.model}")]
    rows += [
        (f"dead, {name}", _places(mask))
        for name, mask in _kinds(found.faults).items()
        if mask.any() or name == "reported"
    ]
    rows += [
        ("gains", f"{gains.min():.2f} to {gains.max():.2f}, spread {100 * gains.std():.0f} %; misfit {fit.misfit:.2f}"),
        ("tares", f"{found.tares.sessions} sessions, {tare}"),
        ("load shift", f"{fit.load_shift:+.1f} ± {fit.load_shift_error:.1f} N, used {made.load_shift:+.1f} N"),
    ]
    against = "pose in contact" if worth.known else "commanded pose, jitter included"
    for index, axis in enumerate(AXES):
        unit, scale = _UNITS[axis]
        bias, error, used = (values[index] / scale for values in (fit.bias, fit.bias_error, made.bias))
        rows.append((f"{axis} error", f"{bias:+.2f} ± {error:.2f} {unit}, used {used:+.2f} {unit}"))
    rows.append(("held out", f"{worth.count} dockings in range, rms error against the {against}"))
    for axis, before, after in zip(AXES, worth.before, worth.after, strict=True):
        unit, scale = _UNITS[axis]
        rows.append((f"  {axis}", f"{before / scale:.3f} {unit} before, {after / scale:.3f} {unit} after"))
    return "\n".join(f"{name:<17} {text}" for name, text in rows)


def _header(options: argparse.Namespace, found: _Found) -> str:
    """Return the comment with the origin of the file."""
    lines = [
        "Calibration of one rig's pads by `deltacharger calibrate tactile`, for the parameter `calibration` of",
        f"misalignment_node; data: {Path(options.data).name}",
        _as_text(found),
        *(f"doubtful: {doubt}" for doubt in found.doubts),
    ]
    return "\n".join(lines)
