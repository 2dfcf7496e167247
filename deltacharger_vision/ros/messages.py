# SPDX-License-Identifier: Apache-2.0
"""Messages of RGB-D cameras and of detections: conversion from and to arrays, and a camera's topics."""

import sys
import time
from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from deltacharger.msg import ElectrodeDetection
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.files import brief
from deltacharger_vision import errors, images, mount, parameters
from deltacharger_vision.cameras.ros_formats import Readout, color_array, depth_array, from_camera_info


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


def intrinsics_of(info: CameraInfo, source: str) -> images.Intrinsics:
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
    camera: CameraInfo | images.Intrinsics,
    source: str = "camera_info",
) -> images.RgbdImage:
    """Convert two messages to one image, without depth if that is missing.

    Args:
        color: image.
        depth: of the same pixels.
        camera: calibration of the colour image.
        source: of the calibration, for errors.

    Raises:
        ImageError: an encoding is unknown, or the images do not match.
        CameraInfoError: the calibration is unusable, or another camera's.
    """
    frame = color.header.frame_id
    if depth is not None and depth.header.frame_id != frame:
        raise errors.ImageError(
            "depth",
            f"in frame {brief(depth.header.frame_id)}, colour in {brief(frame)}: take depth aligned to colour "
            "(RealSense align_depth.enable:=true, Orbbec depth_registration:=true, OAK stereo.i_align_depth: true)",
        )
    if not isinstance(camera, images.Intrinsics):
        if camera.header.frame_id != frame:
            other = brief(camera.header.frame_id)
            raise errors.CameraInfoError(
                source, f"of frame {other}, not of the colour image's {brief(frame)}; name its own"
            )
        camera = intrinsics_of(camera, source)
    pixels = color_array(color)
    metres = np.full(pixels.shape[:2], np.nan) if depth is None else depth_array(depth)
    return images.RgbdImage.make(pixels, metres, camera)


def color_message(color: NDArray[np.uint8], stamp: Time, frame: str = mount.CAMERA_FRAME) -> Image:
    """Return an (H, W, 3) RGB image as rgb8."""
    return _message(color, "rgb8", 3, stamp, frame)


def depth_message(depth: NDArray[np.float32], stamp: Time, frame: str = mount.CAMERA_FRAME) -> Image:
    """Return (H, W) m, NaN = unknown, as 16UC1: whole mm, 0 = unknown, including values beyond 65.5 m."""
    millimetres = np.nan_to_num(depth * np.float32(1e3), nan=0.0, posinf=0.0, neginf=0.0) + np.float32(0.5)
    millimetres[millimetres >= 65536.0] = 0.0
    return _message(millimetres.astype(np.uint16), "16UC1", 2, stamp, frame)


def camera_info_message(intrinsics: images.Intrinsics, stamp: Time, frame: str = mount.CAMERA_FRAME) -> CameraInfo:
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


class CameraPublishers:
    """The three topics of an RGB-D camera.

    Args:
        node: that publishes.
        frame_id: full name of the camera's optical frame.

    Attributes:
        published: number of colour images published.
    """

    def __init__(self, node: Node, frame_id: str) -> None:
        self._frame_id = frame_id
        self._clock = node.get_clock()
        self._context = node.context
        self._publishers = {
            images.COLOR: node.create_publisher(Image, parameters.COLOR_TOPIC, qos_profile_sensor_data),
            images.DEPTH: node.create_publisher(Image, parameters.DEPTH_TOPIC, qos_profile_sensor_data),
            images.INFO: node.create_publisher(
                CameraInfo, parameters.info_topic(parameters.COLOR_TOPIC), qos_profile_sensor_data
            ),
        }
        self.published = 0

    def wanted(self, *kinds: str) -> bool:
        """Return whether one of these kinds, or any, has subscribers."""
        return any(self._publishers[kind].get_subscription_count() for kind in kinds or self._publishers)

    def now(self) -> int:
        """Return ROS time, ns."""
        return int(self._clock.now().nanoseconds)

    def image(self, image: images.RgbdImage, taken: float, has_depth: bool = True) -> None:
        """Publish the parts of an image that have subscribers; `taken` is its time (s, time.monotonic)."""
        stamp = _time(self.now() - round(1e9 * (time.monotonic() - taken)))
        if self.wanted(images.INFO):
            self._publish(images.INFO, camera_info_message(image.intrinsics, stamp, self._frame_id))
        if self.wanted(images.COLOR):
            self._publish(images.COLOR, color_message(image.color, stamp, self._frame_id))
        if has_depth and self.wanted(images.DEPTH):
            self._publish(images.DEPTH, depth_message(image.depth, stamp, self._frame_id))

    def info(self, intrinsics: images.Intrinsics) -> None:
        """Publish the calibration alone, stamped now."""
        self._publish(images.INFO, camera_info_message(intrinsics, _time(self.now()), self._frame_id))

    def _publish(self, kind: str, message: Any) -> None:
        if self._context.ok():
            self._publishers[kind].publish(message)
            self.published += kind == images.COLOR


def _time(stamp: int) -> Time:
    return Time(sec=stamp // 1_000_000_000, nanosec=stamp % 1_000_000_000)


def detection_message(
    placed: mount.Placed,
    stamp: Time,
    confidence: float,
    distance: float,
    frame_id: str = mount.FRAME,
    source: str = "both",
) -> ElectrodeDetection:
    """Convert electrodes to a message.

    Args:
        placed: their pose.
        stamp: of the image.
        confidence: 0 to 1.
        distance: m from the camera.
        frame_id: full name of charger_base.
        source: image, depth or both.
    """
    message = ElectrodeDetection(roll=placed.roll, confidence=confidence, range=distance, source=source)
    message.header.stamp, message.header.frame_id = stamp, frame_id
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    place.x, place.y, place.z = (float(value) for value in placed.position)
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in mount.quaternion(placed.rotation()))
    message.pose.covariance = placed.known_covariance().ravel()
    return message
