# SPDX-License-Identifier: Apache-2.0
"""What lies at the electrodes, by the probe's two looks, and the limits within which current may flow into it."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import NamedTuple

LIVE_VOLTAGE = 1.0
"""V that electrodes have without being driven if a battery is connected to them."""
SHORT_RESISTANCE = 1.0
"""Ω, below it the electrodes are shorted."""


class Port(IntEnum):
    """What lies at the electrodes; the numbers are those of the constants in Probe.srv."""

    UNKNOWN = 0
    OPEN = 1
    DEAD = 2
    LIVE = 3
    SHORT = 4
    REVERSED = 5


class ChargeLimits(NamedTuple):
    """Limits of one closing: A and V at most, a dead port or a live one, s until current flows, s without current."""

    current: float
    voltage: float
    dead: bool = False
    start_time: float = 3.0
    gap_time: float = 0.2


def port_of(resistance: float, voltage: float) -> Port:
    """Return what a probe found.

    Args:
        resistance: Ω at the end of the driven look; inf = no current flows, NaN = not driven, or not measured.
        voltage: V before driving if that is at least `LIVE_VOLTAGE` either way, else at the end.
    """
    if math.isnan(resistance):
        if not abs(voltage) >= LIVE_VOLTAGE:
            return Port.UNKNOWN
        return Port.LIVE if voltage > 0.0 else Port.REVERSED
    if math.isinf(resistance):
        return Port.OPEN
    if math.isnan(voltage):
        return Port.UNKNOWN
    return Port.SHORT if resistance < SHORT_RESISTANCE else Port.DEAD
