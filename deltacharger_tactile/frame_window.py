# SPDX-License-Identifier: Apache-2.0
"""The newest tactile frames of a node: stores them, waits for them, averages them. Independent of ROS."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.host_clock import COMPARE_CLOCKS
from deltacharger_core.machine import FRAME_RATE
from deltacharger_tactile.parameters import FRAMES_MAX


@dataclass(frozen=True)
class Frame:
    """One reading of both pads.

    Attributes:
        sampled: s, time of sampling on the clock of `FrameWindow`.
        stamp: the same time, as in the message.
        sequence: of the message.
        tared: whether the baseline was subtracted.
        left: (10, 10) N, the pad at +x; NaN = dead.
        right: (10, 10) N, the pad at −x.
    """

    sampled: float
    stamp: Any
    sequence: int
    tared: bool
    left: Array
    right: Array


class Refused(Exception):
    """Frames do not allow an estimate. Example: untared frames; the message states what to do."""


class FrameWindow:
    """Received frames of one device; all methods are thread-safe.

    Args:
        now: clock of the frames' sampling times, s.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._frames: deque[tuple[float, Frame]] = deque(
            maxlen=FRAMES_MAX
        )  # with the time.monotonic() of their arrival
        self._arrived = threading.Condition()
        self._closed = False

    def add(self, frame: Frame) -> None:
        """Add a frame and wake waiting threads."""
        with self._arrived:
            self._frames.append((time.monotonic(), frame))
            self._arrived.notify_all()

    def close(self) -> None:
        """Release waiting threads."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()

    def newest(self, count: int) -> list[Frame]:
        """Return at most `count` frames, oldest first."""
        with self._arrived:
            return [frame for _, frame in self._frames][-count:]

    def fresh(self, wanted: int, timeout: float) -> list[Frame]:
        """Wait for `wanted` frames that are sampled and received from now on.

        Both conditions are needed: another computer's clock may be ahead, and its frames date from the future.

        Args:
            wanted: number of frames, at most FRAMES_MAX.
            timeout: s beyond their duration at 120 Hz.

        Raises:
            Refused: they did not arrive in time, or the window was closed.
        """
        since, asked = self._now(), time.monotonic()
        deadline = asked + timeout + wanted / FRAME_RATE
        with self._arrived:
            while True:
                fresh = [frame for arrived, frame in self._frames if arrived > asked and frame.sampled > since]
                if self._closed:
                    raise Refused("the node is closing")
                if len(fresh) >= wanted:
                    return fresh[:wanted]
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise Refused(self._why_too_few(len(fresh), wanted))
                self._arrived.wait(left)

    def average(self, frames: Sequence[Frame], max_age: float) -> tuple[Array, Array]:
        """Return left and right (10, 10) N, the mean of frames; a taxel that is dead in one frame is dead.

        Args:
            frames: at least one, oldest first.
            max_age: s, largest age of the newest.

        Raises:
            Refused: the frames are stale or not tared.
        """
        age = self._now() - frames[-1].sampled
        if not age <= max_age:
            raise Refused(f"the newest tactile frame is {age:.3f} s old, more than max_age {max_age:g} s")
        if age < -max_age:
            raise Refused(
                f"the newest tactile frame is stamped {-age:.3f} s ahead of this node's clock; {COMPARE_CLOCKS}"
            )
        if not all(frame.tared for frame in frames):
            raise Refused("the tactile frames are not tared; call the service tare without contact")
        left, right = (np.mean([getattr(frame, side) for frame in frames], axis=0) for side in ("left", "right"))
        return left, right

    def _why_too_few(self, fresh: int, wanted: int) -> str:
        if not self._frames:
            return "no tactile_frame has arrived; check that tactile_node runs"
        age = self._now() - self._frames[-1][1].sampled
        return (
            f"{fresh} of {wanted} fresh frames arrived in time, the newest is {age:.2f} s old; check tactile_node; "
            f"{COMPARE_CLOCKS}"
        )
