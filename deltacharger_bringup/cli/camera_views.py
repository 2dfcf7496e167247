# SPDX-License-Identifier: Apache-2.0
"""Views for `deltacharger calibrate camera`: where to take them, and a folder of them.

    FOLDER/views.csv          one row per image, in the order of recording
    FOLDER/camera_info.yaml   as written by camera_calibration
    FOLDER/view_001.png …

Columns of views.csv: image, and angle_0_rad,angle_1_rad,angle_2_rad as servo_node reports them. Lines that start with #
are comments.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import files, yaml_file
from deltacharger_kinematics.calibration.data import RADIANS, CalibrationError, read_table
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_vision import image_files, images
from deltacharger_vision.hand_eye.board import Board
from deltacharger_vision.hand_eye.fit import View
from deltacharger_vision.mount import Mount

VIEWS = "views.csv"
_IMAGE = "image"
_COLUMNS = (_IMAGE, *RADIANS)
_INSET = 0.95  # of the workspace; a real arm reaches some millimetres less than its model
_SPARE = 1.1  # of the board's half diagonal that must be in the image
_NEAREST = 0.03  # m before the camera
_TRIED = 4096


class ViewsError(ValueError):
    """A folder of views cannot be used. Example: a row without an image.

    Args:
        path: file or folder.
        reason: what is wrong and what to do.
    """

    def __init__(self, path: Path, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")


@dataclass(frozen=True)
class Row:
    """One row: the image's name, the line of the file, and the arm's angles (rad)."""

    image: str
    line: int
    angles: Vector


@dataclass(frozen=True)
class SeenViews:
    """Views of a folder that show the board, the names of their images, and the names of the other images."""

    views: tuple[View, ...]
    names: tuple[str, ...]
    without: tuple[str, ...]


def read_rows(folder: Path) -> list[Row]:
    """Read views.csv of a folder.

    Raises:
        ViewsError: there is none, or a line is invalid.
        OSError: it cannot be read.
    """
    path = folder / VIEWS
    if not path.is_file():
        raise ViewsError(folder, f"contains no {VIEWS}; give a folder filled by --take")
    try:
        table = read_table(path, _COLUMNS, "docs/camera-calibration.md")
        if set(table.names) != set(_COLUMNS):
            raise ViewsError(path, f"give the columns {','.join(_COLUMNS)}")
        values = table.columns(RADIANS).tolist()
    except CalibrationError as error:
        raise ViewsError(path, str(error)) from error
    rows = []
    for line, cells, (first, second, third) in zip(table.lines, table.rows, values, strict=True):
        image = cells[_IMAGE]
        if Path(image).suffix.lower() not in image_files.PICTURES or Path(image).name != image:
            problem = f"line {line}: image '{image}'; give a {', '.join(image_files.PICTURES)} file of the same folder"
            raise ViewsError(path, problem)
        rows.append(Row(image, line, (first, second, third)))
    return rows


def gather(
    folder: Path, rows: Sequence[Row], board: Board, intrinsics: images.Intrinsics, geometry: DeltaGeometry
) -> SeenViews:
    """Search the image of each row for the board.

    Raises:
        ViewsError: an image differs in size from the intrinsics, or the arm cannot have the angles of a row.
        ImageError: a file is no image.
        OSError: an image cannot be read.
    """
    kinematics = ScalarDelta(geometry)
    views, names, without = [], [], []
    for row in rows:
        position, slope = _stand(folder / VIEWS, row, kinematics)
        path = folder / row.image
        if not path.is_file():
            missing = f"line {row.line}: there is no image {row.image} in {folder}; copy it there, or delete the line"
            raise ViewsError(folder / VIEWS, missing)
        sighting = board.detect(_pixels(path, intrinsics))
        if sighting is None:
            without.append(row.image)
        else:
            views.append(View(position, sighting, slope))
            names.append(row.image)
    return SeenViews(tuple(views), tuple(names), tuple(without))


def read_pixels(path: Path) -> NDArray[np.uint8]:
    """Return an image as (H, W, 3) RGB, uint8; errors as in `read_color`."""
    return images.rgb8(image_files.read_color(path))


class ViewsFolder:
    """A folder to which views are added one by one, so that no view is lost and recording can resume.

    Args:
        folder: created if missing, continued if it contains views.
        intrinsics: of the camera.

    Attributes:
        angles: rad, of the arm at each view in the folder.

    Raises:
        ViewsError: its views have other settings, or it is no folder of views.
        OSError: it cannot be read or written.
    """

    def __init__(self, folder: Path, intrinsics: images.Intrinsics) -> None:
        self._folder = folder
        self.angles: list[Vector] = []
        folder.mkdir(parents=True, exist_ok=True)
        if (folder / VIEWS).exists():
            self._resume(intrinsics)
            return
        if any(path.name != image_files.CAMERA_INFO for path in folder.iterdir()):
            raise ViewsError(folder, f"contains other files and no {VIEWS}; give a new folder")
        yaml_file.write_yaml(folder / image_files.CAMERA_INFO, camera_info(intrinsics))
        files.append_text(self._folder / VIEWS, f"{','.join(_COLUMNS)}\n")

    def add(self, image: NDArray[np.uint8], angles: Vector) -> str:
        """Add an image (H, W, 3) and the arm's angles (rad) at it; return its name when both are stored."""
        name = f"view_{len(self.angles) + 1:03}.png"
        image_files.write_picture(self._folder / name, image)
        files.append_text(self._folder / VIEWS, ",".join([name, *(f"{angle:.7f}" for angle in angles)]) + "\n")
        self.angles.append(angles)
        return name

    def _resume(self, intrinsics: images.Intrinsics) -> None:
        from deltacharger_vision.image_files import load_camera_info

        rows = read_rows(self._folder)
        ours = all(row.image == f"view_{n:03}.png" for n, row in enumerate(rows, start=1))
        if not ours or not (self._folder / image_files.CAMERA_INFO).is_file():
            raise ViewsError(self._folder, "was not filled by --take; give a new folder")
        if load_camera_info(self._folder / image_files.CAMERA_INFO) != intrinsics:
            raise ViewsError(self._folder, "has other intrinsics than the camera has now; give a new folder")
        self.angles = [row.angles for row in rows]


def camera_info(intrinsics: images.Intrinsics) -> dict[str, Any]:
    """Return intrinsics in the form that `load_camera_info` reads from YAML."""
    coefficients = list(intrinsics.distortion) or [0.0] * 5
    return {
        "image_width": intrinsics.width,
        "image_height": intrinsics.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": intrinsics.matrix().ravel().tolist()},
        "distortion_model": "rational_polynomial" if len(coefficients) == 8 else "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
    }


def _stand(path: Path, row: Row, kinematics: ScalarDelta) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the platform's position (3,) m and its derivative (3, 3) m/rad by the arm's angles."""
    position = kinematics.forward(*row.angles)
    slope = np.array(kinematics.jacobian(*position)).reshape(3, 3)
    if not np.isfinite(slope).all():
        raise ViewsError(path, f"line {row.line}: the arm cannot have the angles {row.angles} rad; check --geometry")
    return np.array(position), slope


def _pixels(path: Path, intrinsics: images.Intrinsics) -> NDArray[np.uint8]:
    pixels = read_pixels(path)
    height, width = pixels.shape[:2]
    if (width, height) != (intrinsics.width, intrinsics.height):
        raise ViewsError(
            path,
            f"has {width} × {height} px, but the camera's calibration is for {intrinsics.width} × {intrinsics.height}; "
            "give images and --camera-info of one size",
        )
    return pixels


def view_places(
    geometry: DeltaGeometry, farthest: float, mount: Mount, intrinsics: images.Intrinsics, offset: Vector, radius: float
) -> Iterator[Vector]:
    """Yield positions (m, charger_base) that the camera sees: a Halton sequence in the workspace box.

    Each prefix fills the box evenly, so position does not correlate with time.

    Args:
        geometry: gives the workspace box.
        farthest: largest z, m.
        mount: believed pose of the camera.
        intrinsics: of the camera.
        offset: origin of the board in end_effector, m.
        radius: half the board's diagonal, m.
    """
    from scipy.stats import qmc

    low, high = np.array(geometry.workspace_min), np.array(geometry.workspace_max)
    high[2] = min(high[2], farthest)
    middle, reach = (low + high) / 2, _INSET * (high - low) / 2
    points = middle + reach * (2.0 * qmc.Halton(3, scramble=False).random(_TRIED) - 1.0)
    for point in points[_visible(points + offset, mount, intrinsics, _SPARE * radius)]:
        yield float(point[0]), float(point[1]), float(point[2])


def _visible(
    centres: NDArray[np.float64], mount: Mount, intrinsics: images.Intrinsics, radius: float
) -> NDArray[np.bool_]:
    """Return which spheres of `radius` m around `centres` (N, 3) are in the image."""
    turn, place = mount.pose[:3, :3], mount.pose[:3, 3]
    camera = (centres - place) @ turn
    before = camera[:, 2] > _NEAREST + radius
    pixels = images.project(np.where(before[:, None], camera, (0.0, 0.0, 1.0)), intrinsics)
    margin = radius * np.array([intrinsics.fx, intrinsics.fy]) / np.maximum(camera[:, 2:], _NEAREST)
    inside = (pixels > margin) & (pixels < np.array([intrinsics.width, intrinsics.height]) - margin)
    return np.asarray(before & inside.all(axis=1))
