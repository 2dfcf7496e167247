# SPDX-License-Identifier: Apache-2.0
"""Electrodes in charger_base as a message."""

from __future__ import annotations

from builtin_interfaces.msg import Time
from deltacharger.msg import ElectrodeDetection

from deltacharger_vision.mount import FRAME, quaternion
from deltacharger_vision.placed import Placed


def detection_message(
    placed: Placed, stamp: Time, confidence: float, distance: float, frame_id: str = FRAME, source: str = "both"
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
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in quaternion(placed.rotation()))
    message.pose.covariance = placed.known_covariance().ravel()
    return message
