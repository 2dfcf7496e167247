# SPDX-License-Identifier: Apache-2.0
"""Messages without measurements: unknown is NaN, never 0."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from deltacharger.msg import Misalignment
from std_msgs.msg import Header

from deltacharger_core.frames import END_EFFECTOR


def unknown(message: Any) -> Any:
    """Set every float of a message and its nested messages to NaN; return the message."""
    for name, kind in message.get_fields_and_field_types().items():
        value = getattr(message, name)
        if kind in ("float", "double"):
            setattr(message, name, math.nan)
        elif isinstance(value, np.ndarray):
            value[:] = math.nan
        elif hasattr(value, "get_fields_and_field_types"):
            unknown(value)
    return message


def unknown_misalignment(frame: str = END_EFFECTOR) -> Misalignment:
    """Return a Misalignment message without any estimate."""
    return unknown(Misalignment(header=Header(frame_id=frame)))
