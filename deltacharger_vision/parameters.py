# SPDX-License-Identifier: Apache-2.0
"""Parameters of camera_node and electrode_detector_node, except those of the camera and the terminal."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, flag, number, pose, tunable, words
from deltacharger_vision.images import DEPTH_BIAS, MILLIMETRE, NEAREST_DEPTH
from deltacharger_vision.mount import POSITION_STDDEV, ROTATION_STDDEV, Mount, pose_numbers

COLOR, DEPTH, CAMERA_INFO = "color/image_raw", "depth/image_raw", "color/camera_info"
"""Relative topic names of an RGB-D camera."""


@dataclass(frozen=True)
class ReplayParameters(Bounded):
    """Recording that camera_node publishes instead of a camera."""

    replay: str = words("", "MCAP recording to publish instead of a camera")
    replay_loop: bool = flag(False, "restart the recording at its end")


@dataclass(frozen=True)
class DetectorNodeParameters(Bounded):
    """Operation of electrode_detector_node, and the camera's mount."""

    rate: float = tunable(0.0, 0, 60, "Hz", "images examined while there are subscribers ({unit}); 0 = none")
    timeout: float = tunable(2.0, 0.1, 60.0, "s", "search time of a request without its own timeout")
    image_age_max: float = tunable(0.5, 0.02, 10.0, "s", "largest age of a usable image")
    stamp_tolerance: float = number(0.015, 0.0, 1.0, "s", "largest difference between the stamps of colour and depth")
    depth_unit: float = number(MILLIMETRE, 1e-5, 0.01, "m", "unit of 16-bit depth: 1 mm by REP 118, 0.1 mm by some")
    depth_range_min: float = number(
        NEAREST_DEPTH,
        0.0,
        5.0,
        "m",
        "depth nearer than the camera can measure is not used: OAK-D 0.174, D435 0.28, D455 0.52",
    )
    depth_bias: float = number(
        DEPTH_BIAS, 0.0, 0.2, "", "standard deviation of the relative error of all depth; makers allow twice as much"
    )
    color_topic: str = words(COLOR, "topic of the colour images")
    depth_topic: str = words(DEPTH, "topic of the depth images, aligned to colour")
    camera_info_topic: str = words(CAMERA_INFO, "topic of the colour images' calibration")
    mount_file: str = words("", "YAML of `deltacharger calibrate camera`; replaces the three parameters mount…")
    mount_from_tf: bool = flag(
        False,
        "take the camera's pose from tf, by the frame_id of its images, instead of mount; tf has no covariance",
    )
    mount: tuple[float, ...] = pose(pose_numbers(Mount.default().pose), "camera_color_optical_frame in charger_base")
    mount_position_stddev: float = number(POSITION_STDDEV, 0.0, 0.1, "m", "error of the mount's position, per axis")
    mount_rotation_stddev: float = number(ROTATION_STDDEV, 0.0, 0.5, "rad", "error of the mount's rotation, per axis")
