# SPDX-License-Identifier: Apache-2.0
"""Reads RGB-D images and cameras' calibrations from files, writes pictures. Needs OpenCV, `deltacharger[vision]`."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, files, yaml_file
from deltacharger_vision import errors, images
from deltacharger_vision.cameras.ros_formats import Readout, from_camera_info

CAMERA_INFO = "camera_info.yaml"
"""Name of the intrinsics' file in a folder of images."""
PICTURES = (".png", ".jpg", ".jpeg")
_LARGEST = 64 * 2**20  # bytes of a file
_MOST_PIXELS = 4096 * 4096


@dataclass(frozen=True)
class ImageFiles:
    """Files of one RGB-D image.

    Attributes:
        name: their common name.
        color: PNG or JPEG.
        depth: PNG or NPY; None = missing.
    """

    name: str
    color: Path
    depth: Path | None

    def read(self, intrinsics: images.Intrinsics) -> images.RgbdImage:
        """Return the image, without depth if it has none; raises the errors of `read_rgbd`."""
        return read_rgbd(self.color, self.depth, intrinsics)


def require_opencv() -> Any:
    """Return the module cv2.

    Raises:
        ModuleNotFoundError: OpenCV is missing; states how to install it.
    """
    os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(_MOST_PIXELS))  # OpenCV reads it when it is loaded
    try:
        import cv2
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "OpenCV is not installed; install it with pip install 'deltacharger[vision]', or by rosdep with "
            "DELTACHARGER_EXTRAS=vision",
            name="cv2",
        ) from error
    return cv2


def read_rgbd(color: Path, depth: Path | None, intrinsics: images.Intrinsics) -> images.RgbdImage:
    """Return colour and depth of the same pixels.

    Args:
        color: see `read_color`.
        depth: see `read_depth`; None = all unknown.
        intrinsics: of the colour image.

    Raises:
        OSError: a file cannot be read.
        ImageError: a file is unusable; names the file and states what to give instead.
        ModuleNotFoundError: OpenCV is not installed.
    """
    pixels = read_color(color)
    metres = np.full(pixels.shape[:2], np.nan, dtype=np.float32) if depth is None else read_depth(depth)
    try:
        return images.RgbdImage.make(pixels, metres, intrinsics)
    except errors.ImageError as error:
        named = depth if error.source == "depth" and depth is not None else color
        raise errors.ImageError(str(named), str(error)) from error


def read_color(path: Path) -> NDArray[Any]:
    """Return (H, W) gray, (H, W, 3) RGB or (H, W, 4) RGBA, of a PNG or JPEG file.

    A rotation flag of the file is ignored: intrinsics belong to the stored pixels.

    Raises:
        OSError: the file cannot be read.
        ImageError: the file is not an image.
        ModuleNotFoundError: OpenCV is not installed.
    """
    cv2 = require_opencv()
    pixels = _decoded(path)
    if pixels.ndim == 2:
        return pixels
    turned = {3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGBA}
    return np.asarray(cv2.cvtColor(pixels, turned[pixels.shape[2]]))


def read_depth(path: Path) -> NDArray[Any]:
    """Return (H, W) uint16 (0 = unknown) of a 16-bit PNG, or the array of an NPY file.

    Raises:
        OSError: the file cannot be read.
        ImageError: the file is neither, or has 8 bits or several channels.
        ModuleNotFoundError: OpenCV is not installed.
    """
    if path.suffix.lower() == ".npy":
        return _array(path)
    pixels = _decoded(path)
    if pixels.ndim != 2 or pixels.dtype != np.uint16:
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        raise errors.ImageError(
            str(path),
            f"{channels} × {pixels.dtype.itemsize * 8} bits per pixel, a picture for viewing; depth is one channel of "
            "16 bits in millimetres (PNG), or an array of uint16 mm or float m (.npy)",
        )
    return pixels


def write_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    """Write (H, W, 3) RGB as PNG.

    Raises:
        OSError: the file cannot be written.
    """
    cv2 = require_opencv()
    path.write_bytes(cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1].tobytes())


def _decoded(path: Path) -> NDArray[Any]:
    """Decode an image file with OpenCV: (H, W), (H, W, 3) BGR or (H, W, 4) BGRA."""
    cv2 = require_opencv()
    try:
        data = files.read_bytes(path, _LARGEST)
    except files.FileRefused as error:
        raise errors.ImageError(str(path), f"{error.strerror}; give PNG or JPEG") from error
    try:
        pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise errors.ImageError(str(path), "is not an image, damaged or too large; give PNG or JPEG")
    return np.asarray(pixels)


def _array(path: Path) -> NDArray[Any]:
    try:
        with files.open_file(path, _LARGEST) as file:
            return arrays.read_array(file)
    except files.FileRefused as error:
        raise errors.ImageError(str(path), f"{error.strerror}; write one with numpy.save") from error
    except arrays.ArrayError as error:
        raise errors.ImageError(str(path), f"is not an NPY file ({error}); write it with numpy.save") from error


def load_camera_info(path: str | Path) -> images.Intrinsics:
    """Read a calibration YAML (`camera_calibration`, `camera_info_manager`) or an echoed CameraInfo.

    Raises:
        FileNotFoundError: no such file.
        CameraInfoError: another kind of file, a field is missing, or `from_camera_info` refuses it.
    """
    source = str(path)
    try:
        found = yaml_file.read_yaml(path, first=True)  # an echoed topic has one document per message; any will do
    except yaml_file.YamlError as error:
        raise errors.CameraInfoError(source, f"{error.problem}; give the file of the camera's calibration") from error
    if not isinstance(found, dict):
        raise errors.CameraInfoError(source, "holds no mapping; give the file of the camera's calibration")
    return from_camera_info(
        _field(source, found, "image_width", "width"),
        _field(source, found, "image_height", "height"),
        _data(_field(source, found, "camera_matrix", "k", "K")),
        _data(_field(source, found, "distortion_coefficients", "d", "D")),
        str(_field(source, found, "distortion_model") or ""),
        source,
        _readout(source, found),
    )


def _field(source: str, found: dict[str, Any], *names: str) -> Any:
    for name in names:
        if name in found:
            return found[name]
    raise errors.CameraInfoError(source, f"no {' or '.join(names)}; give the file of the camera's calibration")


def _data(found: Any) -> Any:
    if isinstance(found, dict):
        return found.get("data", [])
    return [] if found is None else found


def _readout(source: str, found: dict[str, Any]) -> Readout:
    region = found.get("roi") or {}
    if not isinstance(region, dict):
        raise errors.CameraInfoError(source, f"roi is {files.brief(region)}; it must be a mapping, as in CameraInfo")
    fields = [region.get(name, 0) for name in ("x_offset", "y_offset", "width", "height")]
    fields += [found.get(name, 0) for name in ("binning_x", "binning_y")]
    if wrong := [each for each in fields if isinstance(each, bool) or not isinstance(each, int)]:
        raise errors.CameraInfoError(
            source, f"roi or binning contains {files.brief(wrong[0])}; give whole numbers of pixels"
        )
    return Readout(*fields)
