# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera`: pose of the camera, with its error, from images of a board on the platform."""

import argparse
import datetime
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.cli import arguments, calibrate_kinematics, camera_views, charger, output
from deltacharger_core import files, machine, parameters
from deltacharger_kinematics.calibration.data import MILLIMETRE
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_vision import image_files, mount
from deltacharger_vision.errors import VisionError
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.hand_eye.calibrate import Calibration, calibrate, doubts, held_out_rms, notes
from deltacharger_vision.hand_eye.fit import Beliefs
from deltacharger_vision.rendering.board_drawing import board_svg

_FAR = (0.020, math.radians(10.0))
"""Distance from the believed mount, m and rad; beyond it a wrong input is likelier than a bent bracket."""
_SATURATED = 250  # of 255
_DOCK = (0.0, 0.0, machine.DOCK_DISTANCE)
"""Point of charger_base (m) for which the mount's error is reported: the dock."""


@dataclass(frozen=True)
class _Judged:
    """A calibration and its judgement.

    Attributes:
        found: the calibration.
        seen: its views.
        away: distance of the mount from the believed one, m and rad.
        doubts: reasons not to use it.
        notes: hints for a better one.
    """

    found: Calibration
    seen: camera_views.SeenViews
    away: tuple[float, float]
    doubts: list[str]
    notes: list[str]


def add_camera(parser: argparse.ArgumentParser) -> None:
    """Add the options of `calibrate camera`."""
    add = parser.add_argument
    add("--views", metavar="FOLDER", help="images and views.csv, see docs/camera-calibration.md")
    add("--print", metavar="FILE.svg", help="only draw the board at true size, for a printer")
    add("--out", metavar="FILE", help="write the mount, for the parameter mount_file")
    add("--geometry", metavar="FILE", help="calibrated geometry of the arm (default: the built-in one)")
    text = "believed mount, for comparison and for the choice of positions (default: nominal)"
    add("--mount", metavar="FILE", help=text)
    add("--force", action="store_true", help="overwrite FILE, and write a doubtful mount")
    add = parser.add_argument_group("the board on the platform").add_argument
    text = "apriltag:FAMILY:NUMBER (apriltag:36h11:0)"
    add("--board", default="apriltag:36h11:0", metavar="NAME", help=text)
    text = "side of the tag's black square (40)"
    add("--size-mm", type=arguments.between(2.0, 1000.0), default=40.0, metavar="MM", help=text)
    for axis in "xyz":
        text = f"measured position of its centre along {axis} of end_effector"
        add(f"--board-{axis}-mm", type=arguments.between(-500.0, 500.0), metavar="MM", help=text)
    add = parser.add_argument_group("prior knowledge, as standard deviations").add_argument
    text = "of the board's measured centre, each direction (0.5)"
    add("--board-stddev-mm", type=arguments.between(0.0, 50.0), default=0.5, metavar="MM", help=text)
    add = parser.add_argument_group("with a running charger").add_argument
    add("--take", type=arguments.integer(5, 500), metavar="N", help="first fill FOLDER up to N views; 20 are enough")
    add(
        "--z-max-mm",
        type=arguments.between(5.0, 110.0),
        default=60.0,
        metavar="MM",
        help="largest z of the platform (60)",
    )
    text = "of the camera, with camera_info beside it (color/image_raw)"
    add("--color-topic", default="color/image_raw", metavar="NAME", help=text)
    arguments.namespace_option(parser)


def camera(options: argparse.Namespace) -> output.Result:
    """Take views on request, fit the mount, judge it, and write it unless it is doubtful."""
    with output.wrong_input(VisionError, camera_views.ViewsError, parameters.ParameterError):
        image_files.require_opencv()
        for flag in ("out", "print"):
            if getattr(options, flag) is not None:
                arguments.file_to_write(f"--{flag}", getattr(options, flag), overwrite=options.force)
        board = Board.named(options.board, options.size_mm * MILLIMETRE)
        if options.print is not None:
            return _print(options, board)
        if options.views is None:
            raise output.WrongInput("give --views FOLDER, or --print FILE.svg for a board")
        offset, geometry = _offset(options), calibrate_kinematics.geometry_of(options.geometry)
        if options.take is not None:
            charger.prepare(options, look_around=True)
            with output.Interrupts() as interrupts, charger.ros_context() as context:
                from deltacharger_bringup.cli.take_views import take

                take(options, board, offset, geometry, context, interrupts)
        judged = _judge(options, board, offset, geometry)
        doubts, remarks = judged.doubts, [*judged.notes, *judged.doubts]

        def save(path: str) -> None:
            judged.found.mount.save(path, _about(options, judged))

        return output.conclude(options, bool(doubts), save, _as_text(judged), _as_mapping(judged), remarks)


def _print(options: argparse.Namespace, board: Board) -> output.Result:
    """Draw the board."""
    if Path(options.print).suffix.lower() != ".svg":
        raise output.WrongInput(f"--print {options.print}: give a name that ends in .svg")
    Path(options.print).write_text(board_svg(board), encoding="utf-8")
    side = board.size / MILLIMETRE
    how = f"print it at 100 % (no 'fit to page') on matte paper; the black square must measure {side:g} × {side:g} mm"
    return output.Result(f"wrote {options.print}", {"written": options.print, "size": board.size}, remarks=[how])


def _offset(options: argparse.Namespace) -> Vector:
    """Return the board's origin in end_effector, m."""
    values = {axis: getattr(options, f"board_{axis}_mm") for axis in "xyz"}
    missing = [f"--board-{axis}-mm" for axis, value in values.items() if value is None]
    if missing:
        raise output.WrongInput(
            f"give {', '.join(missing)}: the position of the board's centre in end_effector, measured with a ruler; "
            "images do not show it, because the platform never turns"
        )
    x, y, z = (MILLIMETRE * float(value) for value in values.values())
    return x, y, z


def _judge(options: argparse.Namespace, board: Board, offset: Vector, geometry: DeltaGeometry) -> _Judged:
    folder = Path(options.views)
    rows = camera_views.read_rows(folder)
    intrinsics = image_files.load_camera_info(folder / image_files.CAMERA_INFO)
    seen = camera_views.gather(folder, rows, board, intrinsics, geometry)
    if not seen.views:
        hint = f"is it sharp, lit, not cut off, and {board.name} at all?"
        raise output.CommandError(f"none of {len(rows)} images shows the board: {hint}", views=len(rows))
    found = calibrate(seen.views, intrinsics, Beliefs(offset, options.board_stddev_mm * MILLIMETRE))
    away = _away(found.mount, mount.Mount.load(options.mount) if options.mount else mount.Mount.default())
    remarks = [*notes(found, seen.names), *_slips(away)]
    if seen.without:
        remarks.append(f"{len(seen.without)} of {len(rows)} images do not show the board: {_few(seen.without)}")
    if np.median([view.sighting.white for view in seen.views]) >= _SATURATED:
        remarks.append("the print's white is over-exposed, which makes a tag look smaller: lower the camera's exposure")
    return _Judged(found, seen, away, doubts(found, board.size, seen.names), remarks)


def _away(found: mount.Mount, believed: mount.Mount) -> tuple[float, float]:
    """Return the distance of a mount from the believed one, m and rad."""
    turned = 0.5 * (float(np.trace(found.pose[:3, :3] @ believed.pose[:3, :3].T)) - 1.0)
    distance = float(np.linalg.norm(found.pose[:3, 3] - believed.pose[:3, 3]))
    return distance, math.acos(min(1.0, max(-1.0, turned)))


def _slips(away: tuple[float, float]) -> list[str]:
    """Return a note if a sign may be wrong, which no image shows: the mount is far from the believed one."""
    if away[0] < _FAR[0] and away[1] < _FAR[1]:
        return []
    return [
        f"the fitted mount is {1e3 * away[0]:.0f} mm and {math.degrees(away[1]):.0f} ° from the believed one: if that "
        "cannot be, check the signs of --board-…-mm (x to the left, y up, z toward the target) and --mount"
    ]


def _few(names: list[str] | tuple[str, ...], most: int = 5) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def _point_stddev(found: Calibration) -> float:
    """Return the standard deviation (m) of a point at the dock due to the mount, all directions together."""
    return math.sqrt(float(np.trace(found.point_covariance(np.array(_DOCK)))))


def _as_mapping(judged: _Judged) -> dict[str, Any]:
    """Return the mount and its quality in SI units, for the JSON object."""
    found = judged.found
    return {
        "frame": "charger_base",
        "position": found.mount.pose[:3, 3].tolist(),
        "orientation": mount.quaternion(found.mount.pose[:3, :3]).tolist(),
        "covariance": found.mount.covariance.tolist(),
        "dock_stddev": _point_stddev(found),
        "views": len(judged.seen.names),
        "left_out": [name for name, good in zip(judged.seen.names, found.fit.kept, strict=True) if not good],
        "held_out": {"images": [judged.seen.names[index] for index in found.held_out], "rms": held_out_rms(found)},
        "notes": judged.notes,
        "doubts": judged.doubts,
    }


def _as_text(judged: _Judged) -> str:
    """Return everything for people."""
    found, kept = judged.found, judged.found.fit.kept
    place, spread = found.mount.pose[:3, 3] / MILLIMETRE, np.sqrt(np.diag(found.mount.covariance))
    turned = " ".join(f"{value:.6f}" for value in mount.quaternion(found.mount.pose[:3, :3]))
    errors = ", ".join(f"{at:.2f} ± {stddev / MILLIMETRE:.2f}" for at, stddev in zip(place, spread[:3], strict=True))
    rows = [
        ("views", f"{len(kept)} show the board, {np.count_nonzero(kept)} agree"),
        ("position", f"{errors} mm in charger_base"),
        ("orientation", f"{turned} (x y z w)"),
        ("  error", " ".join(f"{value:.3f}" for value in np.degrees(spread[3:])) + " ° about x y z (1 σ)"),
        ("believed", f"{judged.away[0] / MILLIMETRE:.1f} mm and {math.degrees(judged.away[1]):.2f} ° from there"),
        ("at the dock", f"{_point_stddev(found) / MILLIMETRE:.2f} mm (1 σ), the board's offset included"),
        ("reprojection", f"{math.sqrt(np.mean(np.square(found.reprojection[kept]))):.2f} px rms"),
        ("held out", f"{len(found.held_out)} images: {held_out_rms(found) / MILLIMETRE:.2f} mm rms at the board"),
        ("board size", f"{found.size:.4f} ± {found.size_stddev:.4f} of the stated size, by the platform's moves"),
    ]
    return "\n".join(f"{name:<13} {text}" for name, text in rows)


def _about(options: argparse.Namespace, judged: _Judged) -> dict[str, Any]:
    """Return the origin of the mount, for its file."""
    return {
        "by": "deltacharger calibrate camera",
        "date": f"{datetime.datetime.now(datetime.timezone.utc):%Y-%m-%dT%H:%MZ}",
        "views": Path(options.views).absolute().name,
        "sha256": files.sha256(Path(options.views) / camera_views.VIEWS),
        "geometry": Path(options.geometry).name if options.geometry else "built-in",
        "images": len(judged.seen.names),
        "held_out_rms": round(held_out_rms(judged.found), 6),
        "doubts": judged.doubts,
    }
