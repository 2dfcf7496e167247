# SPDX-License-Identifier: Apache-2.0
"""Estimates use only frames sampled after the request, even if clocks are set."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import pytest

from deltacharger_tactile.frame_window import Frame, FrameWindow, Refused

NOW = 1000.0


def frame(sampled: float) -> Frame:
    return Frame(sampled, None, 0, True, np.ones((10, 10)), np.ones((10, 10)))


def ask(window: FrameWindow, wanted: int, then: list[Frame]) -> list[Frame]:
    """Request `wanted` fresh frames; `then` arrives during the wait."""
    sender = threading.Timer(0.02, lambda: [window.add(each) for each in then])
    sender.start()
    try:
        return window.fresh(wanted, 0.1 if wanted > len(then) or then[0].sampled < NOW else 60.0)
    finally:
        sender.join()


@pytest.mark.parametrize("jump", [0.0, 1.0, 3600.0])
def test_frames_from_before_the_request_never_count(jump: float) -> None:
    window = FrameWindow(lambda: NOW)
    for index in range(50):
        window.add(frame(NOW + jump - 0.5 + 0.01 * index))  # the clock was set back by `jump` since
    after = [frame(NOW + 0.01 * index) for index in range(1, 4)]
    assert ask(window, 3, after) == after


def test_frames_that_arrive_late_do_not_count() -> None:
    with pytest.raises(Refused, match="0 of 1"):
        ask(FrameWindow(lambda: NOW), 1, [frame(NOW - 0.2)])


@pytest.mark.parametrize(("stamp", "noun"), [(-0.3, "old"), (0.3, "ahead")])
def test_an_average_must_be_current(stamp: float, noun: str) -> None:
    with pytest.raises(Refused, match=noun):
        FrameWindow(lambda: NOW).average([frame(NOW + stamp)], 0.25)
    FrameWindow(lambda: NOW).average([frame(NOW + stamp)], 0.35)


def test_an_average_is_tared_and_as_dead_as_its_frames() -> None:
    window, whole, dead = FrameWindow(lambda: NOW), frame(NOW), frame(NOW)
    dead.left[:], dead.left[3, 4] = 3.0, np.nan
    left, right = window.average([dead, whole], 0.25)
    assert np.isnan(left).sum() == 1
    assert (left[0, 0], right[3, 4]) == (2.0, 1.0)
    with pytest.raises(Refused, match="tare"):
        window.average([dataclasses.replace(whole, tared=False), whole], 0.25)
