# SPDX-License-Identifier: Apache-2.0
"""Who may move the arm, by what is known of the contactor: pure logic, the clock is passed in.

Electrodes that carry current must not come apart. While the contactor is closed nobody moves the arm: docking stands
still then, and opens it before it goes anywhere. While it may close at any moment, and while nobody tells its state,
only the sender moves the arm who led it when the contactor was last known to be open. Holding is always allowed.
"""

from __future__ import annotations

import enum
import hmac
import math
from typing import NamedTuple

FRESH = 0.2  # s, four periods of charger_power; older, the state is unknown
AHEAD = 0.1  # s that a stamp may lie in the future and still tell of an open contactor
_PUBLISHERS = 8  # of charger_power that are told apart; a charger has one


class ContactorState(enum.Enum):
    """What is known of the contactor; the value is what a refusal says."""

    ABSENT = "there is none"
    OPEN = "open"
    ARMED = "the contactor may close at any moment: only the node that moved the arm before the probe may move it"
    CLOSED = "the contactor is closed: nobody moves the arm until it is open"
    UNKNOWN = (
        "the contactor may be closed, because charger_power is silent or wrongly stamped: only the node that last "
        "moved the arm while it was open may move it; look at tactile_node"
    )


class Sender(NamedTuple):
    """Who sent a trajectory.

    Attributes:
        secret: header.frame_id, which docking_node draws at random when it starts.
        publisher: the middleware's id of the publisher; empty where rclpy does not tell it.
    """

    secret: str = ""
    publisher: bytes = b""

    def is_same(self, other: Sender) -> bool:
        """Return whether both are known to be one; nobody is the same as one of whom nothing is known."""
        same = hmac.compare_digest(self.secret.encode(), other.secret.encode())
        return same and self.publisher == other.publisher and bool(self.secret or self.publisher)


class _Report(NamedTuple):
    closed: bool
    armed: bool
    measured: float


class MotionGuard:
    """Follows charger_power and who leads the arm. Used by one thread.

    Each publisher of charger_power counts by its last report, and the worst one decides: who says that the contactor
    is open cannot talk over the one that says it is closed.
    """

    def __init__(self) -> None:
        self._reports: dict[bytes, _Report] = {}
        self._was_heard = False
        self._leader = Sender()

    @property
    def was_heard(self) -> bool:
        """Whether charger_power ever came."""
        return self._was_heard

    def observe(self, publisher: bytes, closed: bool, armed: bool, age: float, now: float) -> None:
        """Take note of a charger_power.

        Args:
            publisher: who sent it; empty = not known.
            closed: whether the contactor is closed.
            armed: whether there is a probe that allows it to close.
            age: s since the measurement by its stamp; negative in the future, NaN where the stamp is none.
            now: s.
        """
        self._was_heard = True
        if age > FRESH or not (closed or age >= -AHEAD):  # an impossible stamp may stop the arm, never free it
            return
        self._reports.pop(publisher, None)
        if len(self._reports) >= _PUBLISHERS:
            del self._reports[next(iter(self._reports))]
        self._reports[publisher] = _Report(closed, armed, now - (age if age > 0.0 else 0.0))

    def state(self, now: float, is_announced: bool) -> ContactorState:
        """Return what is known at `now` (s).

        Args:
            now: s.
            is_announced: whether somebody publishes charger_power or serves set_contactor; looked at only where
                charger_power never came.
        """
        if not self._was_heard:
            return ContactorState.UNKNOWN if is_announced else ContactorState.ABSENT
        fresh = [report for report in self._reports.values() if now - report.measured <= FRESH]
        if not fresh:
            return ContactorState.UNKNOWN
        if any(report.closed for report in fresh):
            return ContactorState.CLOSED
        return ContactorState.ARMED if any(report.armed for report in fresh) else ContactorState.OPEN

    def may_move(self, sender: Sender, state: ContactorState) -> bool:
        """Return whether `sender` may move the arm in this state."""
        if state in (ContactorState.OPEN, ContactorState.ABSENT):
            return True
        return state is not ContactorState.CLOSED and sender.is_same(self._leader)

    def led(self, sender: Sender, state: ContactorState) -> None:
        """Take note that `sender` moved the arm."""
        if state is ContactorState.OPEN:
            self._leader = sender


def stamp_age(sec: int, nanosec: int, now: int) -> float:
    """Return how long ago (s) a stamp was at `now` (ns); NaN for one before 1970, whatever a sender wrote."""
    return (now - sec * 1_000_000_000 - nanosec) * 1e-9 if sec >= 0 else math.nan
