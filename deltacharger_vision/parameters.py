# SPDX-License-Identifier: Apache-2.0
"""Parameters of camera_node and electrode_detector_node, except those of the terminal."""

from dataclasses import dataclass
from pathlib import PurePosixPath

from deltacharger_core.parameters import Bounded, ParameterError, flag, number, words
from deltacharger_vision.images import NEAREST_DEPTH

COLOR_TOPIC, DEPTH_TOPIC = "color/image_raw", "depth/image_raw"
"""Relative topic names of an RGB-D camera."""


def info_topic(color: str) -> str:
    """Return the name of the calibration's topic, beside that of the colour images."""
    return str(PurePosixPath(color).with_name("camera_info"))


@dataclass(frozen=True)
class OakSettings(Bounded):
    """Setup of an OAK-D.

    Raises:
        ParameterError: a value is out of bounds, or the exposure takes longer than one image.
    """

    rate: float = number(15.0, 1.0, 60.0, "Hz", "images per second")
    exposure_us: int = number(10_000, 1, 33_000, "µs", "exposure of the colour camera (assumed)")
    device_id: str = words("", "id or name of the camera; '' = any")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.exposure_us > 1e6 / self.rate:
            longest = f"{self.exposure_us} is outside 1 to {1e6 / self.rate:.0f} µs at this rate"
            raise ParameterError("exposure_us", self.exposure_us, longest)


@dataclass(frozen=True)
class DetectorNodeParameters(Bounded):
    """Operation of electrode_detector_node, and the camera's mount."""

    rate: float = number(0.0, 0, 60, "Hz", "images examined while there are subscribers ({unit}); 0 = none")
    image_age_max: float = number(0.5, 0.02, 10.0, "s", "largest age of a usable image")
    depth_range_min: float = number(
        NEAREST_DEPTH,
        0.0,
        5.0,
        "m",
        "depth nearer than the camera can measure is not used: OAK-D 0.174, D435 0.28, D455 0.52",
    )
    color_topic: str = words(COLOR_TOPIC, "topic of the colour images; their calibration is camera_info beside it")
    depth_topic: str = words(DEPTH_TOPIC, "topic of the depth images, aligned to colour")
    mount_file: str = words("", "YAML of `deltacharger calibrate camera`; empty = the usual mount")
    mount_from_tf: bool = flag(
        False, "take the camera's pose from tf, by the frame_id of its images; tf has no covariance"
    )
