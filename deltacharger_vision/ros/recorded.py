# SPDX-License-Identifier: Apache-2.0
"""Recorded messages of a camera as messages; apart, since who only publishes or hears images needs no recordings."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.cameras.recording import CameraRecording, Recorded
from deltacharger_vision.images import INFO


def decoded(recording: CameraRecording, each: Recorded) -> Any:
    """Return a recorded message.

    Raises:
        RecordingError: it is none of its topic's type.
    """
    kind = CameraInfo if each.kind == INFO else Image
    try:
        return deserialize_message(each.data, kind)
    except Exception as error:  # rclpy raises its own private kinds
        raise RecordingError(f"{recording.path}: holds a message that is no {kind.__name__}: {error}") from error
