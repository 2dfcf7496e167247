# SPDX-License-Identifier: Apache-2.0
"""Decides who may move the arm, from the state of the contactor: pure logic, the clock is passed in.

Electrodes that carry current must not separate. While the contactor is closed, no one moves the arm; docking stands
still and opens it before it moves. While the contactor may close at any moment, or its state is unknown, only the
sender that moved the arm when the contactor was last known to be open may move it. Holding is always allowed.
"""

from __future__ import annotations

import enum
import hmac
from typing import NamedTuple

from deltacharger_core.host_clock import AHEAD

FRESH = 0.2  # s, four periods of charger_power; if older, the state is unknown
_PUBLISHERS = 8  # of charger_power that are tracked; a charger has one


class ContactorState(enum.Enum):
    """Known state of the contactor; the value is the text of a refusal."""

    ABSENT = "there is none"
    OPEN = "open"
    ARMED = "the contactor may close at any moment: only the node that moved the arm before the probe may move it"
    CLOSED = "the contactor is closed: the arm must not move until it is open"
    UNKNOWN = (
        "the contactor may be closed, because charger_power is silent or its stamps are wrong: only the node that last "
        "moved the arm while it was open may move it; check tactile_node"
    )


class Sender(NamedTuple):
    """Sender of a trajectory.

    Attributes:
        secret: header.frame_id, which docking_node draws at random at its start.
        publisher: the middleware's id of the publisher; empty if rclpy does not provide it.
    """

    secret: str = ""
    publisher: bytes = b""

    def is_same(self, other: Sender) -> bool:
        """Return whether both are certainly the same sender; False if nothing is known of one."""
        same = hmac.compare_digest(self.secret.encode(), other.secret.encode())
        return same and self.publisher == other.publisher and bool(self.secret or self.publisher)


class _Report(NamedTuple):
    closed: bool
    armed: bool
    measured: float


class MotionGuard:
    """Tracks charger_power and the sender that moves the arm. Used by one thread.

    The last report of each publisher of charger_power counts, and the worst one decides: a publisher that reports
    "open" cannot override another that reports "closed".
    """

    def __init__(self) -> None:
        self._reports: dict[bytes, _Report] = {}
        self._was_received = False
        self._leader = Sender()

    @property
    def was_received(self) -> bool:
        """Whether charger_power was ever received."""
        return self._was_received

    def observe(self, publisher: bytes, closed: bool, armed: bool, age: float, now: float) -> None:
        """Record a charger_power message.

        Args:
            publisher: id of the sender; empty = unknown.
            closed: whether the contactor is closed.
            armed: whether a probe allows it to close.
            age: s since the measurement by its stamp; negative in the future, NaN for an invalid stamp.
            now: s.
        """
        self._was_received = True
        if age > FRESH or not (closed or age >= -AHEAD):  # a wrong stamp may stop the arm but never free it
            return
        self._reports.pop(publisher, None)
        if len(self._reports) >= _PUBLISHERS:
            del self._reports[next(iter(self._reports))]
        self._reports[publisher] = _Report(closed, armed, now - (age if age > 0.0 else 0.0))

    def state(self, now: float, is_announced: bool) -> ContactorState:
        """Return the state at `now` (s).

        Args:
            now: s.
            is_announced: whether anyone publishes charger_power or serves set_contactor; used only until charger_power
                is first received.
        """
        if not self._was_received:
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

    def record_move(self, sender: Sender, state: ContactorState) -> None:
        """Record that `sender` moved the arm."""
        if state is ContactorState.OPEN:
            self._leader = sender
