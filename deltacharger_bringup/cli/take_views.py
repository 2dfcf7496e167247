# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate camera --take N`: move the board before the camera and store an image at each position."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deltacharger_bringup.calibrate.camera_views import ViewsFolder
from deltacharger_bringup.calibrate.view_places import view_places
from deltacharger_bringup.cli.charger import DISCOVERY, prepare, ros_context
from deltacharger_bringup.cli.output import FAILED, INTERRUPTED, CommandError, Interrupts, log_line
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision.hand_eye.board import Board, markers_in
from deltacharger_vision.hand_eye.calibrate import PLACES_APART
from deltacharger_vision.mount import Mount

if TYPE_CHECKING:
    from deltacharger_bringup.calibrate.camera_client import CameraClient
    from deltacharger_records.datasets.arm_client import ArmClient

_IMAGE = 5.0  # s; limit for an image
_BLIND = 6  # positions without the board before giving up
_SHARE = 3  # positions tried per wanted view


def take(options: argparse.Namespace, board: Board, offset: Vector, geometry: DeltaGeometry) -> None:
    """Fill the folder `options.views` up to `options.take` views.

    Raises:
        CommandError: the charger or the camera does not answer, or the board is not visible; exit code 130 after an
            interruption. Views already taken are kept.
        VisionError, ViewsError: the camera's intrinsics, its images or the folder cannot be used.
    """
    mount = Mount.load(options.mount) if options.mount else Mount.default()
    prepare(options, look_around=True)
    folder: ViewsFolder | None = None
    with Interrupts() as interrupts, ros_context() as context:
        from deltacharger_bringup.calibrate.camera_client import CameraClient, CameraError
        from deltacharger_records.datasets.arm_client import ArmClient
        from deltacharger_records.datasets.arm_guest import ArmError

        try:
            with (
                ArmClient(context, geometry, options.namespace, interrupts.event) as arm,
                CameraClient(context, options.color_topic, options.namespace) as camera,
            ):
                arm.wait_until_ready(DISCOVERY)
                intrinsics = camera.intrinsics(DISCOVERY, arm.check)
                folder = ViewsFolder(Path(options.views), intrinsics)
                if folder.angles:
                    log_line(
                        f"{options.views} contains {len(folder.angles)} views already; continuing to {options.take}"
                    )
                radius = math.hypot(*board.pattern) / 2 + board.margin
                places = view_places(geometry, 1e-3 * options.z_max_mm, mount, intrinsics, offset, radius)
                if len(folder.angles) < options.take:
                    _visit(arm, camera, board, _left(places, folder, geometry), folder, options.take)
        except (ArmError, CameraError) as error:
            code = INTERRUPTED if interrupts.event.is_set() else FAILED
            held = 0 if folder is None else len(folder.angles)
            kept = f"; {options.views} contains {held} views; repeat the command to resume" if held else ""
            raise CommandError(f"{error}{kept}", code, views=held) from error
    log_line(f"{options.views} contains {len(folder.angles)} views; the torque is off")


def _left(places: Iterable[Vector], folder: ViewsFolder, geometry: DeltaGeometry) -> list[Vector]:
    """Return the positions without a view in the folder.

    Raises:
        CommandError: there are none.
    """
    kinematics = ScalarDelta(geometry)
    held = [kinematics.forward(*angles) for angles in folder.angles]
    left = [place for place in places if all(math.dist(place, other) > PLACES_APART for other in held)]
    if not left:
        raise CommandError(
            "with this --mount the camera sees the board at no new position: correct --mount or --board-…-mm"
        )
    return left


def _visit(
    arm: ArmClient, camera: CameraClient, board: Board, places: Iterable[Vector], folder: ViewsFolder, wanted: int
) -> None:
    """Move through the positions and store images that show the board, until there are enough."""
    log_line("keep clear: the arm moves now")
    arm.start()
    blind, tried = 0, 0
    for place in places:
        if len(folder.angles) >= wanted or tried >= _SHARE * wanted:
            break
        tried += 1
        arm.move(place)
        before = arm.angles()
        image = camera.image(_IMAGE, arm.check)
        angles = arm.angles()
        where = ", ".join(f"{1e3 * value:.0f}" for value in place)
        if not _still(before, angles):
            log_line(f"at ({where}) mm the arm moved while the image was taken; skipped")
        elif board.detect(image) is None:
            blind += 1
            log_line(f"at ({where}) mm the board is not visible")
            if blind == _BLIND and not folder.angles:
                raise CommandError(_unseen(board, image), FAILED)
        else:
            middle = tuple(0.5 * (first + second) for first, second in zip(before, angles, strict=True))
            name = folder.add(image, (middle[0], middle[1], middle[2]))
            log_line(f"{name}: {len(folder.angles)} of {wanted}, at ({where}) mm")
    if len(folder.angles) < wanted:
        log_line(f"only {len(folder.angles)} views at {tried} positions: correct --mount, or make the board visible")
    arm.go_home()


def _still(before: Vector, after: Vector) -> bool:
    from deltacharger_records.datasets.arm_client import STILL

    return float(np.abs(np.subtract(before, after)).max()) <= STILL


def _unseen(board: Board, image: np.ndarray) -> str:
    others = ", ".join(markers_in(image)[:5])
    hint = f"it shows {others}: give the right --board" if others else "is the board there, lit, and facing the camera?"
    return f"no image of {_BLIND} positions shows {board.name}; {hint}"
