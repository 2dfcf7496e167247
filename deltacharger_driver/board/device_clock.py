# SPDX-License-Identifier: Apache-2.0
"""Converts a device's clock and sequence numbers to the host's: sampling times and lost packets."""

from __future__ import annotations

import itertools
import math

WINDOW = 30.0  # s of history; with 8 s, one second of late packets on a loaded host tilts the line by milliseconds
_BUCKET = 0.5  # s, one minimum each
_SHORTEST_BASELINE = 2.5  # s of history before a drift is estimated
_LARGEST_DRIFT = 500e-6  # s/s; two poor crystals differ by 200e-6


class DeviceClock:
    """Maps a device's clock to the host's by the packets with the least delay.

    Every packet gives `received - device_time`: the true offset plus a delay that is never negative. The minimum over
    the last seconds is the offset plus the shortest delay (Cristian, 1989; the one-way form of NTP's clock filter).
    The drift between the crystals is the slope of the closest line below the minima of all half-second buckets: an edge
    of their lower convex hull (Moon, Skelly and Towsley, 1999). So late packets do not tilt it.

    The shortest delay itself (wire time, 3.2 ms for a u12 packet at 1 Mbaud) cannot be measured one-way and remains in
    the result.
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget everything; the device's clock restarted."""
        self._minima: list[tuple[float, float]] = []  # device time, smallest received - device time
        self._bucket = -math.inf
        self.drift = 0.0  # s/s, positive if the host's clock runs faster
        self.offset = math.nan  # s, at the device's time zero

    def update(self, device_time: float, received: float) -> float:
        """Add one packet and return its device time on the host's clock.

        Args:
            device_time: s, the device's clock.
            received: s, the host's monotonic clock at reception.

        Returns:
            s on the host's clock, never later than `received`.
        """
        delay = received - device_time
        bucket = math.floor(device_time / _BUCKET)
        if bucket > self._bucket:
            self._bucket = bucket
            self._minima = [m for m in self._minima if m[0] >= device_time - WINDOW]
            self._minima.append((device_time, delay))
            self._fit()
        elif delay < self._minima[-1][1]:
            self._minima[-1] = (device_time, delay)
            self._fit()
        return min(self.to_host(device_time), received)

    def to_host(self, device_time: float) -> float:
        """Return the host's time (s) at a device time (s); NaN before the first packet."""
        return device_time + self.offset + self.drift * device_time

    def _fit(self) -> None:
        minima = self._minima
        drift = 0.0
        if minima[-1][0] - minima[0][0] >= _SHORTEST_BASELINE:
            drift = min(max(_slope_beneath(minima), -_LARGEST_DRIFT), _LARGEST_DRIFT)
        self.drift = drift
        self.offset = min(delay - drift * time for time, delay in minima)


def _slope_beneath(points: list[tuple[float, float]]) -> float:
    """Return the slope of the line below all points with the least total distance to them.

    It is the edge of their lower convex hull (Andrew, 1979) that spans their mean time.

    Args:
        points: (time, value), times rising, at least two.
    """
    hull: list[tuple[float, float]] = []
    for time, value in points:
        while len(hull) > 1 and _turns_right(hull[-2], hull[-1], (time, value)):
            hull.pop()
        hull.append((time, value))
    mean = sum(time for time, _ in points) / len(points)
    for (start, low), (end, high) in itertools.pairwise(hull):
        if end >= mean:
            return (high - low) / (end - start)
    raise AssertionError("the last point is not before the mean")


def _turns_right(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> bool:
    """Return whether b lies on or above the line from a to c."""
    return (b[1] - a[1]) * (c[0] - a[0]) >= (c[1] - a[1]) * (b[0] - a[0])


class SequenceUnwrapper:
    """Turns sequence numbers modulo 65536 into numbers that only rise, also across a reboot of the device.

    Attributes:
        lost: packets missed so far: every gap, modulo 65536.
        duplicates: packets that repeated the number before.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.duplicates = 0
        self._base = 0
        self._last: int | None = None  # None until the first packet: a host may join a running stream

    def reboot(self) -> None:
        """Expect numbers from 0 again and continue above everything returned so far."""
        self._base += 0 if self._last is None else self._last + 1
        self._last = -1

    def update(self, sequence: int) -> int | None:
        """Return the unwrapped number of a packet, or None for a repeated packet."""
        if self._last is None:
            self._last = sequence
            return self._base + sequence
        missed = (sequence - self._last - 1) % 65536
        if missed == 65535 and self._last >= 0:
            self.duplicates += 1
            return None
        self.lost += missed
        self._last += missed + 1
        return self._base + self._last
