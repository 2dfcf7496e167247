# SPDX-License-Identifier: Apache-2.0
"""The newest tactile frames of a node: kept, waited for and averaged. Knows no ROS."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import FRAME_RATE
from deltacharger_tactile.parameters import FRAMES_MAX


@dataclass(frozen=True)
class Frame:
    """One reading of both pads.

    Attributes:
        sampled: s, when, on the clock that `FrameWindow` is given.
        stamp: the same as the message carries it.
        sequence: of the message.
        tared: whether the baseline was subtracted.
        left: (10, 10) N, the pad at +x; NaN = dead.
        right: the same for the pad at −x.
    """

    sampled: float
    stamp: Any
    sequence: int
    tared: bool
    left: Array
    right: Array


class Refused(Exception):
    """Frames do not allow an estimate. Example: not tared; the message says what to do."""


class FrameWindow:
    """Frames of one device as they arrive; every method may be called from any thread.

    Args:
        now: the clock that stamps the frames, s.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._frames: deque[tuple[float, Frame]] = deque(
            maxlen=FRAMES_MAX
        )  # with the time.monotonic() of their arrival
        self._arrived = threading.Condition()
        self._closed = False

    def add(self, frame: Frame) -> None:
        """Take a frame, and wake who waits for one."""
        with self._arrived:
            self._frames.append((time.monotonic(), frame))
            self._arrived.notify_all()

    def close(self) -> None:
        """Release all who wait."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()

    def newest(self, count: int) -> list[Frame]:
        """Return at most `count` frames, oldest first."""
        with self._arrived:
            return [frame for _, frame in self._frames][-count:]

    def fresh(self, wanted: int, timeout: float) -> list[Frame]:
        """Wait for `wanted` frames that are sampled from now on and have not arrived yet.

        The second matters where the clock is set back: then frames of before claim to come after now.

        Args:
            wanted: frames, at most FRAMES_MAX.
            timeout: s beyond the time that they take at 120 Hz.

        Raises:
            Refused: they did not come in time, or the window was closed.
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
        """Return left and right (10, 10) N, the mean of frames; a taxel that was dead in one of them is dead.

        Args:
            frames: at least one, oldest first.
            max_age: s that may have passed since the last of them.

        Raises:
            Refused: they are stale or not tared.
        """
        age = self._now() - frames[-1].sampled
        if age > max_age:
            raise Refused(f"the newest tactile frame is {age:.3f} s old, more than max_age {max_age:g} s")
        if age < -max_age:
            raise Refused(
                f"the newest tactile frame is stamped {-age:.3f} s ahead of this node's clock; set both clocks"
            )
        if not all(frame.tared for frame in frames):
            raise Refused("the tactile frames are not tared; call the service tare out of contact")
        left, right = (np.mean([getattr(frame, side) for frame in frames], axis=0) for side in ("left", "right"))
        return left, right

    def _why_too_few(self, fresh: int, wanted: int) -> str:
        if not self._frames:
            return "no tactile_frame has arrived; check that tactile_node runs"
        age = self._now() - self._frames[-1][1].sampled
        return (
            f"{fresh} of {wanted} fresh frames in time, the newest is {age:.2f} s old; "
            "check tactile_node and that both hosts' clocks agree"
        )
