# SPDX-License-Identifier: Apache-2.0
"""Between tactile perception and its messages."""

from __future__ import annotations

from typing import Any

import numpy as np
from deltacharger.msg import Misalignment, TactileFrame

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_tactile.errors import FrameError
from deltacharger_tactile.estimate import Estimate
from deltacharger_tactile.frame_window import Frame


def to_frame(message: TactileFrame) -> Frame:
    """Return a message as a frame.

    Raises:
        FrameError: it is not of two pads of 10 × 10.
    """
    sizes = {len(message.left), len(message.right)}
    if (message.rows, message.columns) != (ROWS, COLUMNS) or sizes != {ROWS * COLUMNS}:
        raise FrameError(*((message.rows, message.columns, len(pad)) for pad in (message.left, message.right)))
    stamp = message.header.stamp
    left, right = (np.asarray(pad, dtype=float).reshape(ROWS, COLUMNS) for pad in (message.left, message.right))
    return Frame(stamp.sec + 1e-9 * stamp.nanosec, stamp, message.tared, left, right)


def to_message(estimate: Estimate, name: str, stamp: Any) -> Misalignment:
    """Return an estimate of one frame pair as a message.

    Args:
        estimate: pose of the target in end_effector.
        name: of the model.
        stamp: of the newest frame used.
    """
    message = Misalignment()
    message.header.stamp = stamp
    message.header.frame_id = "end_effector"
    message.contact, message.sure, message.in_range = estimate.contact, estimate.sure, estimate.in_range
    for axis in ("angle", "vertical", "horizontal"):
        for field in (axis, f"{axis}_stddev"):
            setattr(message, field, getattr(estimate, field))
        setattr(message, f"{axis}_probability", getattr(estimate, f"{axis}_probability").astype(np.float32))
    message.left_force, message.right_force = estimate.left_force, estimate.right_force
    message.model = name
    return message
