# SPDX-License-Identifier: Apache-2.0
"""Estimates use only frames sampled after the request, even if clocks are set."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from deltacharger_tactile.frame_window import Frame, FrameWindow, Refused

FORCES = np.ones((10, 10))


class Clock:
    """A clock that can be set."""

    def __init__(self) -> None:
        self.time = 1000.0

    def __call__(self) -> float:
        return self.time


def frame(sampled: float) -> Frame:
    return Frame(sampled, None, 0, True, FORCES, FORCES)


def ask(window: FrameWindow, wanted: int, then: list[Frame]) -> list[Frame]:
    """Request `wanted` fresh frames; `then` arrives during the wait."""
    sender = threading.Timer(0.05, lambda: [window.add(each) for each in then])
    sender.start()
    try:
        return window.fresh(wanted, 0.5)
    finally:
        sender.join()


@pytest.mark.parametrize("jump", [0.0, -1.0, -3600.0])
def test_frames_from_before_the_request_never_count(jump: float) -> None:
    clock = Clock()
    window = FrameWindow(clock)
    for index in range(50):
        window.add(frame(clock.time + 0.01 * index))
    clock.time += 0.5 + jump
    after = [frame(clock.time + 0.01 * index) for index in range(1, 4)]
    assert ask(window, 3, after) == after


def test_frames_that_arrive_late_do_not_count() -> None:
    clock = Clock()
    window = FrameWindow(clock)
    with pytest.raises(Refused, match="0 of 1 fresh"):
        ask(window, 1, [frame(clock.time - 0.2)])


@pytest.mark.parametrize(("stamp", "problem"), [(-0.3, "0.300 s old"), (0.3, "0.300 s ahead of this node")])
def test_an_average_must_be_current(stamp: float, problem: str) -> None:
    clock = Clock()
    with pytest.raises(Refused, match=problem):
        FrameWindow(clock).average([frame(clock.time + stamp)], 0.25)
