# SPDX-License-Identifier: Apache-2.0
"""Values returned by the board link: samples on the host's clock, results and counters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from deltacharger_driver.board.payloads import Power, Taxels


class TactileSample(NamedTuple):
    """One sampling of both pads.

    Attributes:
        time: sampling instant, s on the host's monotonic clock.
        sequence: unwrapped, rising across a reboot; gaps are lost frames.
        device_time_us: us on the board's clock at the sampling instant.
        pads: (2, 10, 10) N, float32: left (the pad at +x) and right; row 0 at +y, column 0 at +x of end_effector;
            NaN = dead.
        tared: the board subtracts a tare.
        overrun: the board lost samplings before this one.
    """

    time: float
    sequence: int
    device_time_us: int
    pads: Taxels
    tared: bool
    overrun: bool


@dataclass(frozen=True)
class PowerSample:
    """The power stage at `time`, s on the host's monotonic clock."""

    time: float
    power: Power


@dataclass(frozen=True)
class ProbeResult:
    """A probe: ohm and V as `port_of` takes them, and its time (s, monotonic)."""

    resistance: float
    target_voltage: float
    time: float


@dataclass
class BoardLinkCounters:
    """Counts of the link; they only rise."""

    tactile: int = 0
    power: int = 0
    lost_tactile: int = 0
    lost_power: int = 0
    duplicates: int = 0
    unknown_types: int = 0
    bad_payloads: int = 0
    reboots: int = 0
    retries: int = 0
    unanswered: int = 0
    heartbeats: int = 0
    callback_errors: int = 0
