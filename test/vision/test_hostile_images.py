# SPDX-License-Identifier: Apache-2.0
"""Random invalid images and calibrations: a detection, none, or a named error; nothing else."""

from __future__ import annotations

import math
import random
from array import array
from typing import Any

import pytest
from sensor_msgs.msg import CameraInfo, Image

pytest.importorskip("cv2", reason="the detector with deltacharger[vision]")

from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.detector.electrode_detector_node_io import Shot
from deltacharger_vision.errors import VisionError
from deltacharger_vision.terminal import Terminal

from ..marks import night

pytestmark = pytest.mark.ros

WIDTH, HEIGHT = 64, 48
SIZES = (0, 1, 63, 65, 640, 65_535, 2**31, 2**32 - 1)
NUMBERS = (0.0, 1.0, -1.0, 1e-300, 1e308, -1e308, math.nan, math.inf, -math.inf)
COLORS = {"rgb8": 3, "bgra8": 4, "mono8": 1, "yuv422": 2, "bayer_rggb8": 1, "": 3, "x" * 100_000: 3}
DEPTHS = {"16UC1": 2, "32FC1": 4, "mono16": 2, "32SC1": 4}


def image(dice: random.Random, encodings: dict[str, int]) -> Image:
    name = dice.choice(list(encodings)[:3]) if dice.random() < 0.8 else dice.choice(list(encodings))
    step = WIDTH * encodings[name]
    message = Image(encoding=name, width=WIDTH, height=HEIGHT, step=step, is_bigendian=dice.choice((0, 1, 255)))
    cut = dice.choice((1, HEIGHT * step)) if dice.random() < 0.1 else 0
    message.data = array("B", dice.randbytes(HEIGHT * step - cut))
    if dice.random() < 0.1:
        setattr(message, dice.choice(("width", "height", "step")), dice.choice(SIZES))
    return message


def calibration(dice: random.Random) -> CameraInfo:
    message = CameraInfo(width=WIDTH, height=HEIGHT, distortion_model="plumb_bob")
    message.k = [60.0, 0.0, 32.0, 0.0, 60.0, 24.0, 0.0, 0.0, 1.0]
    message.d = [0.0] * 5
    way = dice.randrange(12)
    if way == 0:
        message.k[dice.randrange(9)] = dice.choice(NUMBERS)
    elif way == 1:
        message.d = [dice.choice(NUMBERS) for _ in range(dice.choice((0, 1, 5, 8, 14, 10_000)))]
    elif way == 2:
        message.distortion_model = dice.choice(("", "fisheye", "rational_polynomial", "x" * 100_000))
    elif way == 3:
        message.width = dice.choice(SIZES)
    return message


@pytest.mark.parametrize(("seed", "count"), [(1, 200), night(2, 5000)])
def test_no_image_raises_an_unnamed_error(seed: int, count: int) -> None:
    dice, detector = random.Random(seed), ElectrodeDetector(Terminal())
    refused = list[str]()
    for number in range(count):
        shot = Shot(number, 0, image(dice, COLORS), image(dice, DEPTHS), calibration(dice))
        try:
            found: Any = detector.detect(shot.image())
        except VisionError as error:
            refused.append(str(error))
        else:
            assert found is None, "noise"
    assert 0.1 * count < len(refused) < 0.9 * count
    assert max(map(len, refused)) < 1000
