# SPDX-License-Identifier: Apache-2.0
"""Accuracy of `calibrate camera` on simulated images: `python lab/benchmarks/hand_eye.py`.

Each calibration draws a mount (2 mm and 0.5° from the usual one), constant joint errors (0.1°), whole encoder ticks,
the board's position and tilt on the platform (2 mm, 2°) and the measurement error of that position (0.5 mm). All are
standard deviations. The simulated camera (640 × 400 px, f = 441 px, noise, blur of 1.4 px, uneven light) shows board,
platform, arms and rods. Positions are those of `--take`. Errors compare the found mount with the drawn one: of a point
seen at the dock (0, 0, 80 mm), and of the rotation. NEES is the mean squared error in units of the covariance (6 is
right for the mount, 3 for the point). "in 95 %" is the share of calibrations with an error at the dock within the 95 %
ellipsoid. "doubt" is the share that the command reports as doubtful. Seeds start at 20 000. 15 minutes on one core.

`--example FOLDER` writes one such set of views for the command itself.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deltacharger_bringup.cli.camera_views import ViewsFolder, view_places
from deltacharger_kinematics.calibration.calibrate import COUNT, Uncertainty, numbers, with_numbers
from deltacharger_kinematics.calibration.data import TICK
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision.hand_eye.board import AprilTag, Board, Charuco
from deltacharger_vision.hand_eye.calibrate import Calibration, calibrate, doubts
from deltacharger_vision.hand_eye.views import Beliefs, View
from deltacharger_vision.mount import Mount
from deltacharger_vision.rendering.board_drawing import bracket, with_board
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import CameraParameters, shifted
from deltacharger_vision.rendering.scene_drawing import charger_parts, draw_scene
from deltacharger_vision.terminal import turn

Array = NDArray[np.float64]

FIRST_SEED = 20_000
DOCK = np.array([0.0, 0.0, 0.080])
BOARDS: dict[str, Board] = {"AprilTag 36h11, 40 mm": AprilTag(), "ChArUco 5 × 4, 12 mm": Charuco()}
WITHIN_95 = 7.815  # χ² with three degrees of freedom
_CLEAR = 0.008  # m between board and platform, so that no drawn board intersects it
FARTHEST = 0.060  # m along z, as --take by default


@dataclasses.dataclass(frozen=True)
class Errors:
    """Standard deviations of one calibration, m and rad, and its constant errors.

    Attributes:
        arm: scatter of each dimension of the arm, in tolerances of 0.5 mm and 1°.
        camera: defects of the image.
        print_size: true size of the print, in units of the stated one.
    """

    mount: float = 0.002
    mount_rotation: float = math.radians(0.5)
    joints: float = math.radians(0.1)
    board: float = 0.002
    board_rotation: float = math.radians(2.0)
    offset: float = 0.0005
    arm: float = 0.0
    camera: CameraParameters = dataclasses.field(default_factory=CameraParameters)
    print_size: float = 1.0


CASES: dict[str, Errors] = {
    "tag, 20, exact ruler": Errors(offset=1e-6),
    "tag, 20, exposure 0.3": Errors(camera=CameraParameters(exposure=0.3)),
    "tag, 20, exposure 3": Errors(camera=CameraParameters(exposure=3.0)),
    "tag, 20, defocus 1.5 px": Errors(camera=CameraParameters(defocus=1.5)),
    "tag, 20, joints 0.3°": Errors(joints=math.radians(0.3)),
    "tag, 20, uncalibrated arm": Errors(arm=1.0),
    "tag, 20, print 2 % small": Errors(print_size=0.98),
}


class Rig:
    """One drawn charger with a board, and its simulated camera."""

    def __init__(self, seed: int, board: Board, errors: Errors) -> None:
        self._random = np.random.default_rng(seed)
        draw = self._random.normal
        self.board = board
        self.mount = np.array(Mount.default().pose)
        self.mount[:3, 3] += draw(scale=errors.mount, size=3)
        self.mount[:3, :3] = turn(draw(scale=errors.mount_rotation, size=3)) @ self.mount[:3, :3]
        self.joints = draw(scale=errors.joints, size=3)
        self._bracket = bracket()
        self._bracket[:3, 3] += draw(scale=errors.board, size=3)
        self._bracket[2, 3] -= _CLEAR
        self._bracket[:3, :3] = turn(draw(scale=errors.board_rotation, size=3)) @ self._bracket[:3, :3]
        first, second, third = self._bracket[:3, 3] + draw(scale=errors.offset, size=3)
        self.ruler = errors.offset
        self.offset: Vector = (float(first), float(second), float(third))
        self._kinematics = ScalarDelta()
        nominal = DeltaGeometry()
        drawn = numbers(nominal) + errors.arm * draw(size=COUNT) * Uncertainty().tolerances
        self._true = ScalarDelta(with_numbers(nominal, drawn))
        self._camera = SimulatedCamera(parameters=errors.camera)
        self._printed = scaled(board, errors.print_size)
        self._scene = draw_scene(self._random, clutter=4, target=False)

    def views(self) -> Iterator[tuple[NDArray[np.uint8], Vector]]:
        """Yield images with the arm's angles as servo_node would report them."""
        radius = math.hypot(*self.board.pattern) / 2 + self.board.margin
        usual = Mount.default()
        for place in view_places(DeltaGeometry(), FARTHEST, usual, OAK_D, self.offset, radius):
            wanted = np.array(self._kinematics.inverse(*place))
            reported = TICK * np.round(wanted / TICK)
            # The true angle lies anywhere within the tick.
            true = reported + self.joints + TICK * self._random.uniform(-0.5, 0.5, 3)
            yield self._image(true), (float(reported[0]), float(reported[1]), float(reported[2]))

    def _image(self, angles: Array) -> NDArray[np.uint8]:
        first, second, third = map(float, angles)
        platform = self._true.forward(first, second, third)
        scene = with_board(
            self._scene, self._printed, np.linalg.inv(self.mount) @ shifted(platform) @ self._bracket, in_camera=True
        )
        parts = charger_parts(self.mount, platform, (first, second, third))
        scene = dataclasses.replace(scene, foreground=(*scene.foreground, *parts))
        terminal = np.linalg.inv(self.mount) @ shifted((0.0, 0.0, 0.3))
        return self._camera.render(scene, terminal, self._random, color_only=True).color

    def seen(self, image: NDArray[np.uint8], angles: Vector) -> View | None:
        """Return the view of an image; None if it does not show the board."""
        sighting = self.board.detect(image)
        if sighting is None:
            return None
        position = self._kinematics.forward(*angles)
        slope = np.array(self._kinematics.jacobian(*position)).reshape(3, 3)
        return View(np.array(position), sighting, slope)


def scaled(board: Board, factor: float) -> Board:
    """Return a board of another size."""
    if isinstance(board, AprilTag):
        return dataclasses.replace(board, size=factor * board.size)
    assert isinstance(board, Charuco)
    return dataclasses.replace(board, square=factor * board.square, marker=factor * board.marker)


def errors_of(rig: Rig, found: Calibration) -> tuple[Array, Array]:
    """Return the error (6,) of a mount, m and rad, and the error (3,) m of a point seen at the dock."""
    difference = found.mount.pose[:3, :3] @ rig.mount[:3, :3].T
    turned = np.array([difference[2, 1], difference[0, 2], difference[1, 0]])
    turned -= np.array([difference[1, 2], difference[2, 0], difference[0, 1]])
    shift = found.mount.pose[:3, 3] - rig.mount[:3, 3]
    seen = np.linalg.inv(rig.mount) @ np.append(DOCK, 1.0)
    return np.append(shift, 0.5 * turned), (found.mount.pose @ seen)[:3] - DOCK


def nees(error: Array, covariance: Array) -> float:
    """Return the squared error in units of its covariance."""
    return float(error @ np.linalg.solve(covariance, error))


def table(counts: list[int], calibrations: int) -> None:
    print(f"{calibrations} calibrations each; errors p50 / p95; simulated")
    print(f"{'':<29}   dock mm       rotation °    NEES 6  NEES 3  in 95 %  1 σ mm  kept   seen doubt   ms")
    print(f"{'':<77}%                %      %     %")
    for name, board in BOARDS.items():
        rows, seen = measured(board, Errors(), counts, calibrations)
        for count in counts:
            print_row(f"{name}, {count}", rows[count], seen)
    for name, errors in CASES.items():
        rows, seen = measured(AprilTag(), errors, [20], calibrations)
        print_row(name, rows[20], seen)


def measured(
    board: Board, errors: Errors, counts: list[int], calibrations: int
) -> tuple[dict[int, list[tuple[float, ...]]], float]:
    """Return a row per calibration for each number of views, and the share of images that show the board."""
    rows: dict[int, list[tuple[float, ...]]] = {count: [] for count in counts}
    shown = []
    for seed in range(FIRST_SEED, FIRST_SEED + calibrations):
        rig = Rig(seed, board, errors)
        views: list[View] = []
        searched = 0
        for image, angles in rig.views():
            searched += 1
            view = rig.seen(image, angles)
            views += [] if view is None else [view]
            if len(views) == counts[-1] or searched == 3 * counts[-1]:
                break
        shown.append(len(views) / searched)
        for count in counts:
            rows[count].append(row_of(rig, views[:count]))
    return rows, float(np.mean(shown))


def row_of(rig: Rig, views: list[View]) -> tuple[float, ...]:
    started = time.process_time()
    found = calibrate(views, OAK_D, Beliefs(rig.offset, rig.ruler))
    spent = time.process_time() - started
    mount, point = errors_of(rig, found)
    covariance = found.point_covariance(DOCK)
    found_doubts = doubts(found, rig.board.length, [""] * len(views))
    return (
        1e3 * float(np.linalg.norm(point)),
        math.degrees(float(np.linalg.norm(mount[3:]))),
        nees(mount, found.mount.covariance),
        nees(point, covariance),
        100.0 * (nees(point, covariance) < WITHIN_95),
        1e3 * math.sqrt(float(np.trace(covariance))),
        100.0 * float(found.fit.kept.mean()),
        100.0 * bool(found_doubts),
        1e3 * spent,
    )


def print_row(name: str, rows: list[tuple[float, ...]], seen: float) -> None:
    values = np.array(rows)
    dock, rotation = (np.percentile(values[:, column], (50, 95)) for column in (0, 1))
    pose, point, within, spread, kept, doubtful, spent = (float(mean) for mean in values[:, 2:].mean(axis=0))
    print(
        f"{name:<29} {dock[0]:5.2f} {dock[1]:5.2f}  {rotation[0]:6.3f} {rotation[1]:6.3f}  {pose:6.2f}  {point:6.2f}"
        f"   {within:5.0f}   {spread:5.2f}   {kept:5.1f}  {100 * seen:5.1f}  {doubtful:4.0f} {spent:4.0f}",
        flush=True,
    )


def example(folder: Path, seed: int, count: int) -> None:
    rig = Rig(seed, AprilTag(), Errors())
    files = ViewsFolder(folder, OAK_D)
    for image, angles in rig.views():
        if rig.board.detect(image) is not None:
            files.add(image, angles)
        if len(files.angles) == count:
            break
    x, y, z = (1e3 * value for value in rig.offset)
    print(
        f"deltacharger calibrate camera --views {folder} --board-x-mm {x:.2f} --board-y-mm {y:.2f} --board-z-mm {z:.2f}"
    )
    print("true position", rig.mount[:3, 3].round(5))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--calibrations", type=int, default=50)
    parser.add_argument("--views", type=int, nargs="+", default=[5, 10, 20, 40])
    parser.add_argument("--example", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    if options.example is None:
        table(sorted(options.views), options.calibrations)
    else:
        example(options.example, FIRST_SEED, max(options.views))


if __name__ == "__main__":
    main()
