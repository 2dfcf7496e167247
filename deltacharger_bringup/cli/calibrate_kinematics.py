# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics`: plan poses, or fit the geometry to measured poses and judge the fit."""

from __future__ import annotations

import argparse
import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.cli.calibration import conclude, encoder_of, geometry_of, refusing
from deltacharger_bringup.cli.files import file_to_write
from deltacharger_bringup.cli.output import DONE, WRONG_INPUT, CommandError, print_result
from deltacharger_bringup.cli.parser import namespace_option
from deltacharger_bringup.cli.types import SEED, between, integer
from deltacharger_core.bounded_file import sha256
from deltacharger_kinematics.calibration.calibrate import GeometryCalibration, calibrate, describe
from deltacharger_kinematics.calibration.checks import named
from deltacharger_kinematics.calibration.data import Encoder, read_measurements
from deltacharger_kinematics.calibration.plan import plan, write_plan
from deltacharger_kinematics.calibration.problem import NAMES, Uncertainty, numbers, rms
from deltacharger_kinematics.calibration.table import MILLIMETRE
from deltacharger_kinematics.geometry import LIMB_COUNT
from deltacharger_kinematics.geometry_file import geometry_to_mapping, save_geometry

_WORST = 5  # rows to name
_UNEXPLAINED = 2.0  # scatter; below it the stated uncertainties are plausible
_SUSPICIOUS = 3.0  # tolerances; a well-built arm hardly ever differs more


def add_kinematics(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate kinematics`."""
    parser.add_argument("data", nargs="?", metavar="DATA.csv", help="measured poses, see docs/calibration.md")
    parser.add_argument("--out", metavar="FILE", help="write the fitted geometry, for the parameter geometry_file")
    parser.add_argument("--nominal", metavar="FILE", help="geometry to start from (default: the built-in one)")
    parser.add_argument("--plan", metavar="FILE", help="write the poses to measure; with --measure, read them")
    parser.add_argument("--measure", metavar="FILE", help="move to the poses of --plan, ask for and record positions")
    parser.add_argument("--force", action="store_true", help="overwrite files, and write a doubtful geometry")
    known = parser.add_argument_group("prior knowledge, as standard deviations")
    known.add_argument(
        "--measurement-mm", type=between(1e-6, 10.0), default=0.05, metavar="MM", help="of a coordinate (0.05)"
    )
    known.add_argument("--tolerance-mm", type=between(1e-6, 20.0), default=0.5, metavar="MM", help="of lengths (0.5)")
    known.add_argument("--tolerance-deg", type=between(1e-6, 30.0), default=1.0, metavar="DEG", help="of angles (1)")
    judged = parser.add_argument_group("held-out rows, if the file has no column held_out")
    judged.add_argument(
        "--held-out", type=between(0.01, 0.9), default=0.25, metavar="SHARE", help="share of the rows (0.25)"
    )
    judged.add_argument("--seed", type=SEED, default=0, metavar="N", help="random seed (0)")
    encoder = parser.add_argument_group("angle = direction · (ticks − zero_ticks) · 2π/4096, as in servo_node")
    most = 1_048_575
    encoder.add_argument(
        "--zero-ticks",
        type=integer(-most, most),
        nargs=3,
        metavar="N",
        help="per limb (default: from the file, or 2048)",
    )
    encoder.add_argument("--direction", type=integer(-1, 1), nargs=3, metavar="N", help="per limb (1)")
    namespace_option(parser)


def kinematics(options: argparse.Namespace) -> int:
    """Fit, plan or measure, according to the options."""
    if options.measure is not None:
        if options.plan is None or options.data is not None:
            raise CommandError("--measure FILE needs --plan FILE to read, and no DATA.csv", WRONG_INPUT)
        from deltacharger_bringup.cli.measure import measure

        return measure(options, geometry_of(options.nominal))
    if options.plan is not None:
        if options.data is not None or options.out is not None:
            raise CommandError("--plan FILE writes a plan; it takes neither DATA.csv nor --out", WRONG_INPUT)
        return _plan(options)
    if options.data is None:
        raise CommandError(
            "give DATA.csv to fit, --plan FILE to write a plan, or both --plan and --measure", WRONG_INPUT
        )
    return _fit(options)


def _plan(options: argparse.Namespace) -> int:
    geometry = geometry_of(options.nominal)
    file_to_write("--plan", options.plan, overwrite=options.force)
    poses = plan(geometry, options.seed)
    with refusing(options.plan):
        write_plan(options.plan, poses, geometry, encoder_of(options) or Encoder())
    kept = sum(pose.held_out for pose in poses)
    text = f"wrote {options.plan}: {len(poses)} poses, {kept} of them held out to judge the fit"
    print_result(options, text, {"success": True, "written": options.plan, "poses": len(poses), "held_out": kept})
    return DONE


def _fit(options: argparse.Namespace) -> int:
    if options.out is not None:
        file_to_write("--out", options.out, overwrite=options.force)
    nominal = geometry_of(options.nominal)
    uncertainty = Uncertainty(
        options.measurement_mm * MILLIMETRE, options.tolerance_mm * MILLIMETRE, math.radians(options.tolerance_deg)
    )
    with refusing(options.data):
        measurements = read_measurements(options.data, encoder_of(options))
        found = calibrate(measurements, nominal, uncertainty, options.held_out, options.seed)
    digest = sha256(options.data)
    doubts = _doubts(found)

    def save(path: str) -> None:
        save_geometry(found.fit.geometry, path, _header(options, found, digest))

    value = {**_as_mapping(found, digest), "doubts": doubts}
    return conclude(options, bool(doubts), save, _as_text(found), value, doubts)


def _doubts(found: GeometryCalibration) -> list[str]:
    """Return reasons not to use the geometry."""
    doubts = []
    if not found.improves:
        before, after = found.held_out_rms
        doubts.append(
            f"the fit does not improve held-out rows: error {_mm(before)} mm before, {_mm(after)} mm "
            "after; the nominal geometry is equally good, or the measurements contradict each other"
        )
    if found.outliers.any():
        lines = _lines(found, np.flatnonzero(found.outliers))
        doubts.append(f"{named(tuple(lines))}: the other rows contradict this; measure again, or delete the row")
    return doubts


def _worst(found: GeometryCalibration) -> list[int]:
    """Return the rows with the largest residuals, worst first."""
    return [int(row) for row in np.argsort(-np.linalg.norm(found.fit.residuals, axis=1))[:_WORST]]


def _lines(found: GeometryCalibration, rows: Any) -> list[int]:
    return [found.measurements.lines[row] for row in rows]


def _mm(value: float) -> str:
    return f"{value / MILLIMETRE:.3f}"


def _header(options: argparse.Namespace, found: GeometryCalibration, digest: str) -> str:
    """Return the comment with the origin of a geometry file."""
    count, kept = len(found.measurements), int(found.held_out.sum())
    before, after = found.held_out_rms
    encoder = found.measurements.encoder
    mounted = f" with {', '.join(encoder.statement.replace('# ', '').splitlines())}" if encoder else ""
    return "\n".join(
        [
            "Geometry of one arm, fitted by `deltacharger calibrate kinematics`.",
            f"date: {datetime.datetime.now(datetime.timezone.utc):%Y-%m-%d %H:%M} UTC",
            f"measurements: {Path(options.data).name}, SHA-256 {digest}",
            f"nominal geometry: {Path(options.nominal).name if options.nominal else 'built-in'}",
            f"{count} rows; rms error {_mm(rms(found.before))} mm before, {_mm(rms(found.fit.residuals))} mm after",
            f"held out: {kept} of these rows; rms error there {_mm(before)} mm before, {_mm(after)} mm after a fit to "
            f"the other {count - kept}; the geometry below is fitted to all rows",
            f"stated: measurement {options.measurement_mm:g} mm, tolerances {options.tolerance_mm:g} mm and "
            f"{options.tolerance_deg:g} deg",
            f"angles as servo_node reports them{mounted}",
            *(f"doubtful: {doubt}" for doubt in _doubts(found)),
        ]
    )


def _as_mapping(found: GeometryCalibration, digest: str) -> dict[str, Any]:
    """Return everything in SI units."""
    columns = (numbers(found.nominal), numbers(found.fit.geometry), found.standard_deviations)
    before, after = found.held_out_rms
    lengths = np.linalg.norm(found.fit.residuals, axis=1)
    return {
        "sha256": digest,
        "rows": len(found.measurements),
        "parameters": [
            {
                "limb": index // len(NAMES),
                "name": NAMES[index % len(NAMES)],
                "nominal": float(nominal),
                "fitted": float(fitted),
                "stddev": float(stddev),
            }
            for index, (nominal, fitted, stddev) in enumerate(zip(*columns, strict=True))
        ],
        "rms": {"before": rms(found.before), "after": rms(found.fit.residuals), "largest": float(lengths.max())},
        "held_out": {"lines": _lines(found, np.flatnonzero(found.held_out)), "before": before, "after": after},
        "expected": {"rms": found.expected[0], "largest": found.expected[1]},
        "scatter": found.fit.scatter,
        "singular_values": [float(value) for value in found.fit.singular_values],
        "weakest": describe(found.fit.weakest),
        "worst": [{"line": found.measurements.lines[row], "residual": float(lengths[row])} for row in _worst(found)],
        "outliers": _lines(found, np.flatnonzero(found.outliers)),
        "geometry": geometry_to_mapping(found.fit.geometry),
    }


def _as_text(found: GeometryCalibration) -> str:
    count, kept = len(found.measurements), int(found.held_out.sum())
    before, after = found.held_out_rms
    values = found.fit.singular_values
    lengths = np.linalg.norm(found.fit.residuals, axis=1)
    worst = ", ".join(f"line {found.measurements.lines[row]} {_mm(lengths[row])}" for row in _worst(found))
    held = f", {(values < 1.0).sum()} of 18 below 1: the tolerances decide there" if (values < 1.0).any() else ""
    rows = [
        ("all rows", f"{count}: rms {_mm(rms(found.before))} mm before, {_mm(rms(found.fit.residuals))} mm after"),
        ("held out", f"{kept} of them: rms {_mm(before)} mm before, {_mm(after)} mm after a fit to the others"),
        ("expected", f"{_mm(found.expected[0])} mm rms over the workspace, {_mm(found.expected[1])} mm at worst (1 σ)"),
        ("scatter", f"{found.fit.scatter:.2f} of what measurement and encoder explain{_scatter_hint(found)}"),
        ("residuals", f"largest, mm: {worst}"),
        ("singular", f"{' '.join(f'{value:.3g}' for value in values)}{held}"),
        ("weakest", describe(found.fit.weakest)),
    ]
    return "\n".join([*_table(found), "", *(f"{name:<10} {text}" for name, text in rows)])


def _scatter_hint(found: GeometryCalibration) -> str:
    if found.fit.scatter < _UNEXPLAINED:
        return ""
    return ": do the joints have play, or are the measurements less accurate than stated?"


def _table(found: GeometryCalibration) -> list[str]:
    """Return nominal value, fitted value and its standard deviation of each number, limbs side by side."""
    shape = (LIMB_COUNT, len(NAMES))
    nominal, fitted = numbers(found.nominal), numbers(found.fit.geometry)
    far = (np.abs(fitted - nominal) > _SUSPICIOUS * found.uncertainty.tolerances).reshape(shape)
    columns = [values.reshape(shape) for values in (nominal, fitted, found.standard_deviations)]
    lines = [
        " " * 22 + "".join(f"{f'limb {limb}':^30}" for limb in range(LIMB_COUNT)),
        " " * 22 + f"{'nominal':>9}{'fitted':>10}{'±':>8}   " * LIMB_COUNT,
    ]
    for index, name in enumerate(NAMES):
        unit, scale = ("deg", math.radians(1.0)) if name == "angle_offset" else ("mm", MILLIMETRE)
        cells = ""
        for limb in range(LIMB_COUNT):
            start, end, spread = (column[limb, index] / scale for column in columns)
            cells += f"{start:>9.3f}{end:>10.3f}{spread:>8.3f} {'!' if far[limb, index] else ' '} "
        lines.append(f"{name:<17} {unit:<4}{cells}")
    if far.any():
        lines.append(f"! more than {_SUSPICIOUS:g} tolerances from nominal")
    return [line.rstrip() for line in lines]
