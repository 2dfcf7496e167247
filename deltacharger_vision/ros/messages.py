# SPDX-License-Identifier: Apache-2.0
"""Conversion between arrays and the messages of RGB-D drivers: sensor_msgs/Image and sensor_msgs/CameraInfo."""

from __future__ import annotations

import sys
from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.bounded_file import brief
from deltacharger_vision.cameras.camera_info import Readout, from_camera_info
from deltacharger_vision.cameras.ros_images import color_array, depth_array
from deltacharger_vision.errors import CameraInfoError, ImageError
from deltacharger_vision.images import MILLIMETRE, Intrinsics, RgbdImage
from deltacharger_vision.mount import CAMERA_FRAME


def slash_hint(node: Node, *topics: str) -> str:
    """Return how a topic outside a node's namespace is named; '' if all are named so, or it has no namespace."""
    where = node.get_namespace()
    if where == "/" or all(topic.startswith("/") for topic in topics):
        return ""
    return f"; begin the name of a topic outside {where} with a slash"


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message's header, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def intrinsics_of(info: CameraInfo, source: str) -> Intrinsics:
    """Return the intrinsics of the image sent with a CameraInfo: of its region of interest, binned.

    Raises:
        CameraInfoError: it is unusable; names `source`.
    """
    roi = info.roi
    readout = Readout(roi.x_offset, roi.y_offset, roi.width, roi.height, info.binning_x, info.binning_y)
    return from_camera_info(info.width, info.height, info.k, info.d, info.distortion_model, source, readout)


def rgbd_of(
    color: Image,
    depth: Image | None,
    camera: CameraInfo | Intrinsics,
    depth_unit: float = MILLIMETRE,
    source: str = "camera_info",
) -> RgbdImage:
    """Convert two messages to one image, without depth if that is missing.

    Args:
        color: image.
        depth: of the same pixels.
        camera: calibration of the colour image.
        depth_unit: of 16-bit depth, m.
        source: of the calibration, for errors.

    Raises:
        ImageError: an encoding is unknown, or the images do not match.
        CameraInfoError: the calibration is unusable, or another camera's.
    """
    frame = color.header.frame_id
    if depth is not None and depth.header.frame_id != frame:
        raise ImageError(
            "depth",
            f"in frame {brief(depth.header.frame_id)}, colour in {brief(frame)}: take depth aligned to colour "
            "(RealSense align_depth.enable:=true, Orbbec depth_registration:=true, OAK stereo.i_align_depth: true)",
        )
    if not isinstance(camera, Intrinsics):
        if camera.header.frame_id != frame:
            other = brief(camera.header.frame_id)
            raise CameraInfoError(source, f"of frame {other}, not of the colour image's {brief(frame)}; name its own")
        camera = intrinsics_of(camera, source)
    pixels = color_array(color)
    metres = np.full(pixels.shape[:2], np.nan) if depth is None else depth_array(depth)
    return RgbdImage.make(pixels, metres, camera, depth_unit)


def color_message(color: NDArray[np.uint8], stamp: Time, frame: str = CAMERA_FRAME) -> Image:
    """Return an (H, W, 3) RGB image as rgb8."""
    return _message(color, "rgb8", 3, stamp, frame)


def depth_message(depth: NDArray[np.float32], stamp: Time, frame: str = CAMERA_FRAME) -> Image:
    """Return (H, W) m, NaN = unknown, as 16UC1: whole mm, 0 = unknown, including values beyond 65.5 m."""
    millimetres = np.nan_to_num(depth * np.float32(1e3), nan=0.0, posinf=0.0, neginf=0.0) + np.float32(0.5)
    millimetres[millimetres >= 65536.0] = 0.0
    return _message(millimetres.astype(np.uint16), "16UC1", 2, stamp, frame)


def camera_info_message(intrinsics: Intrinsics, stamp: Time, frame: str = CAMERA_FRAME) -> CameraInfo:
    """Return the calibration of an unrectified image: R is the identity, P the camera matrix."""
    message = CameraInfo()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.height, message.width = intrinsics.height, intrinsics.width
    message.distortion_model = "rational_polynomial" if len(intrinsics.distortion) == 8 else "plumb_bob"
    message.d = list(intrinsics.distortion) or [0.0] * 5
    matrix = intrinsics.matrix()
    message.k = matrix.ravel()
    message.r = np.eye(3).ravel()
    message.p = np.hstack([matrix, np.zeros((3, 1))]).ravel()
    return message


def _message(pixels: NDArray[Any], encoding: str, bytes_per_pixel: int, stamp: Time, frame: str) -> Image:
    message = Image()
    message.header.stamp, message.header.frame_id = stamp, frame
    message.height, message.width = pixels.shape[:2]
    message.encoding, message.is_bigendian = encoding, int(sys.byteorder == "big")
    message.step = message.width * bytes_per_pixel
    data = array("B")  # the only type that rclpy takes without checking each element
    data.frombytes(np.ascontiguousarray(pixels).tobytes())
    message.data = data
    return message
