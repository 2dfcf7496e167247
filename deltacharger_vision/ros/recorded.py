# SPDX-License-Identifier: Apache-2.0
"""Decodes a camera's recorded messages; separate, because publishers and subscribers of images need no recordings."""

from __future__ import annotations

from typing import Any

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, Image

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.cameras.recording import CameraRecording, Recorded
from deltacharger_vision.images import INFO


def decoded(recording: CameraRecording, each: Recorded) -> Any:
    """Decode a recorded message.

    Raises:
        RecordingError: the data are not of its topic's type.
    """
    kind = CameraInfo if each.kind == INFO else Image
    try:
        return deserialize_message(each.data, kind)
    except Exception as error:  # rclpy's own private classes
        raise RecordingError(f"{recording.path}: holds a message that is no {kind.__name__}: {error}") from error
