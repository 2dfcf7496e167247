# SPDX-License-Identifier: Apache-2.0
"""What `deltacharger calibrate camera` says about a mount: as text, as JSON, and in the mount's file."""

from __future__ import annotations

import argparse
import datetime
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.calibrate.camera_views import VIEWS, SeenViews
from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.hand_eye.calibrate import Calibration
from deltacharger_vision.hand_eye.checks import held_out_rms
from deltacharger_vision.mount import quaternion

MILLIMETRE = 1e-3
DOCK = (0.0, 0.0, DOCK_DISTANCE)
"""Point of charger_base (m) at which the mount's error is told: the dock."""


@dataclass(frozen=True)
class Judged:
    """A calibration and what is to be said about it.

    Attributes:
        found: the calibration.
        seen: the views that it was made from.
        away: how far the mount is from the believed one, m and rad.
        doubts: why not to use it.
        notes: what would make it better.
    """

    found: Calibration
    seen: SeenViews
    away: tuple[float, float]
    doubts: list[str]
    notes: list[str]


def _point_stddev(found: Calibration) -> float:
    """Return the standard deviation (m) of a point at the dock by the mount's error, all directions together."""
    return math.sqrt(float(np.trace(found.point_covariance(np.array(DOCK)))))


def _rms(values: Any) -> float:
    return math.sqrt(float(np.mean(np.square(values))))


def as_mapping(judged: Judged) -> dict[str, Any]:
    """Return everything in SI units, for the JSON object."""
    found = judged.found
    kept = found.fit.kept
    moves = np.linalg.norm(found.fit.apart.moves, axis=1)
    return {
        "frame": "charger_base",
        "position": found.mount.pose[:3, 3].tolist(),
        "orientation": quaternion(found.mount.pose[:3, :3]).tolist(),
        "covariance": found.mount.covariance.tolist(),
        "dock_stddev": _point_stddev(found),
        "from_believed": {"distance": judged.away[0], "rotation": judged.away[1]},
        "views": len(judged.seen.names),
        "left_out": [name for name, good in zip(judged.seen.names, kept, strict=True) if not good],
        "without_board": list(judged.seen.without),
        "reprojection_rms": _rms(found.reprojection[kept]),
        "residual": {"rms": _rms(moves[kept]), "largest": float(moves[kept].max())},
        "held_out": {
            "images": [judged.seen.names[index] for index in found.held_out],
            "errors": found.held_out_errors.tolist(),
            "rms": held_out_rms(found),
        },
        "corner_stddev": found.fit.spread.pixel,
        "arm_stddev": found.fit.spread.arm,
        "size": {"factor": found.size, "stddev": found.size_stddev},
        "board_orientation": quaternion(found.board).tolist(),
        "joints": {"error": found.joints[0].tolist(), "stddev": found.joints[1].tolist()},
        "notes": judged.notes,
        "doubts": judged.doubts,
    }


def as_text(judged: Judged) -> str:
    """Return everything for people."""
    found, kept = judged.found, judged.found.fit.kept
    place, spread = found.mount.pose[:3, 3] / MILLIMETRE, np.sqrt(np.diag(found.mount.covariance))
    moves = np.linalg.norm(found.fit.apart.moves, axis=1)[kept] / MILLIMETRE
    normal = ", ".join(f"{value:.3f}" for value in found.board[:, 2])
    angles, errors = (np.degrees(each) for each in found.joints)
    turned = " ".join(f"{value:.6f}" for value in quaternion(found.mount.pose[:3, :3]))
    judges = f"{len(found.held_out)} images: {held_out_rms(found) / MILLIMETRE:.2f} mm rms at the board"
    rows = [
        ("views", f"{len(kept)} show the board, {np.count_nonzero(kept)} agree"),
        ("position", _three(place, spread[:3] / MILLIMETRE, 2) + " mm in charger_base"),
        ("orientation", f"{turned} (x y z w)"),
        ("  error", " ".join(f"{value:.3f}" for value in np.degrees(spread[3:])) + " ° about x y z (1 σ)"),
        ("believed", f"{judged.away[0] / MILLIMETRE:.1f} mm and {math.degrees(judged.away[1]):.2f} ° from there"),
        ("at the dock", f"{_point_stddev(found) / MILLIMETRE:.2f} mm (1 σ), the board's offset included"),
        ("reprojection", f"{_rms(found.reprojection[kept]):.2f} px rms"),
        ("residuals", f"{_rms(moves):.2f} mm rms, {moves.max():.2f} mm at most, at the board"),
        ("held out", judges if found.held_out else "none"),
        ("scatter", f"{found.fit.spread.pixel:.3f} px a corner, {found.fit.spread.arm / MILLIMETRE:.3f} mm a position"),
        ("board size", f"{found.size:.4f} ± {found.size_stddev:.4f} of what was stated, by the platform's moves"),
        ("board normal", f"({normal}) in end_effector, ± {math.degrees(found.board_stddev):.2f} °"),
        ("arm angles", _three(angles, errors, 3) + " ° off, as far as the images tell"),
    ]
    return "\n".join(f"{name:<13} {text}" for name, text in rows)


def _three(values: Any, errors: Any, digits: int) -> str:
    return ", ".join(f"{value:.{digits}f} ± {error:.{digits}f}" for value, error in zip(values, errors, strict=True))


def about(options: argparse.Namespace, board: Board, judged: Judged) -> dict[str, Any]:
    """Return what the mount's file says about how it was made; lengths in m, angles in rad."""
    found = judged.found
    return {
        "by": "deltacharger calibrate camera",
        "date": f"{datetime.datetime.now(datetime.timezone.utc):%Y-%m-%dT%H:%MZ}",
        "views": Path(options.views).absolute().name,
        "sha256": hashlib.sha256((Path(options.views) / VIEWS).read_bytes()).hexdigest(),
        "geometry": Path(options.geometry).name if options.geometry else "built-in",
        "board": board.name,
        "board_size": board.length,
        "board_offset": [MILLIMETRE * getattr(options, f"board_{axis}_mm") for axis in "xyz"],
        "board_offset_stddev": MILLIMETRE * options.board_stddev_mm,
        "images": len(judged.seen.names),
        "left_out": int(np.count_nonzero(~found.fit.kept)),
        "reprojection_rms_px": round(_rms(found.reprojection[found.fit.kept]), 4),
        "held_out": len(found.held_out),
        "held_out_rms": round(held_out_rms(found), 6),
        "dock_stddev": round(_point_stddev(found), 6),
        "size_factor": round(found.size, 5),
        "doubts": judged.doubts,
    }
