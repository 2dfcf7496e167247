# SPDX-License-Identifier: Apache-2.0
"""What the emulated board itself watches in the power stage's readings, as the firmware does (docs/firmware.md)."""

from __future__ import annotations

import math

from deltacharger_core.machine import BATTERY_MAX, BATTERY_MIN
from deltacharger_driver.board.payloads import Power
from deltacharger_driver.board.protocol import ZERO_CURRENT, BoardFault

TARGET_VOLTAGES = 10.0, 30.0  # V that the stage charges
_OPEN_CURRENT = 1.0  # A
_LARGEST_CURRENT = 20.0  # A
_REVERSE_LIMIT = -0.5  # A
_SHORT_VOLTAGE = 2.0  # V; no target has less while current flows
_IDLE_CURRENT = 0.05  # A
_IDLE_TIMEOUT = 3.0  # s closed without any current
_LOST_TIMEOUT = 0.05  # s without current that has flowed before
_BLIND_TIMEOUT = 0.1  # s with a reading unknown or out of range
_SAG_TIMEOUT = 5.0  # s with a low battery, which sags under load
_BOUNCE_TIME, _BOUNCE_PERIOD = 0.02, 0.1  # s with open feedback from its first opening; between two first openings
_RAMP_TIME = 0.05  # s that a commanded opening may take
_ZERO_TIME = 0.05  # s from the opening until feedback and current must confirm it


class Detectors:
    """Judges one reading after the other.

    Attributes:
        seen_closed: whether the contactor closed and has not opened since, apart from bounces.
        open_from: s, when the contactor must be open; inf = it may be closed.

    Args:
        target_voltages: lowest and highest V that the stage charges.
    """

    def __init__(self, target_voltages: tuple[float, float] = TARGET_VOLTAGES) -> None:
        self._lowest, self._highest = target_voltages
        self.reset(0.0)

    def reset(self, now: float) -> None:
        """Begin with an open contactor."""
        self.seen_closed = self._flowed = False
        self.open_from = now + _ZERO_TIME
        self._last: dict[str, float] = {}  # s, when each reading was last good
        self._bounce = -math.inf

    def close(self) -> None:
        """Take a close."""
        self.seen_closed, self.open_from = False, math.inf

    def open(self, now: float, ramp: bool) -> None:
        """Take an opening."""
        self.seen_closed = False
        if not ramp or self.open_from == math.inf:  # a repeated opening does not restart the ramp
            self.open_from = min(self.open_from, now + _ZERO_TIME + ramp * _RAMP_TIME)

    def fault(self, now: float, power: Power) -> int:
        """Return the fault that a reading shows, 0 = none. Comparisons with NaN are false."""
        _, target, current, closed, _ = power
        if self.open_from < math.inf:
            if current < _OPEN_CURRENT:  # the ramp has ended
                self.open_from = min(self.open_from, now + _ZERO_TIME)
            welded = now >= self.open_from and (closed or abs(current) >= ZERO_CURRENT)
            return BoardFault.CONTACTOR_WELDED if welded else BoardFault.NONE
        if target < 0.0:
            return BoardFault.REVERSE_POLARITY
        if current > _OPEN_CURRENT and target < _SHORT_VOLTAGE:
            return BoardFault.SHORT_CIRCUIT
        if current > _LARGEST_CURRENT:
            return BoardFault.OVER_CURRENT
        if current < _REVERSE_LIMIT:
            return BoardFault.REVERSE_CURRENT
        if closed and not self.seen_closed:
            self.seen_closed, self._flowed, self._bounce = True, False, -math.inf
            self._last = dict.fromkeys(("current", "target", "battery", "charge", "flow"), now)
        if not self.seen_closed:
            return BoardFault.NONE
        if not closed and self._has_opened(now):
            self.seen_closed = False
            return BoardFault.NONE
        return self._watch(now, power) or self._charge(now, current)

    def _has_opened(self, now: float) -> bool:
        if now - self._bounce >= _BOUNCE_PERIOD:
            self._bounce = now
        return now - self._bounce >= _BOUNCE_TIME

    def _watch(self, now: float, power: Power) -> int:
        battery, target, current, _, _ = power
        for name, good, longest, reading in (
            ("current", not math.isnan(current), _BLIND_TIMEOUT, current),
            ("target", self._lowest <= target <= self._highest, _BLIND_TIMEOUT, target),
            ("battery", battery <= BATTERY_MAX, _BLIND_TIMEOUT, battery),
            ("charge", battery >= BATTERY_MIN, _SAG_TIMEOUT, 0.0),
        ):
            if good:
                self._last[name] = now
            elif now - self._last[name] >= longest:
                return BoardFault.STALE if math.isnan(reading) else BoardFault.VOLTAGE_OUT_OF_RANGE
        return BoardFault.NONE

    def _charge(self, now: float, current: float) -> int:
        if current >= _IDLE_CURRENT:
            self._last["flow"], self._flowed = now, True
        elif now - self._last["flow"] >= (_LOST_TIMEOUT if self._flowed else _IDLE_TIMEOUT):
            return BoardFault.NONE if math.isnan(current) else BoardFault.NO_CHARGE_CURRENT
        return BoardFault.NONE
