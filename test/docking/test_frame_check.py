# SPDX-License-Identifier: Apache-2.0
"""The frames of an estimate: sampled after the request, each once, and half of them received by docking itself."""

from __future__ import annotations

import math

import pytest

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.observation import Reply
from deltacharger_docking.ros.frame_check import FrameCheck

PERIOD = 1.0 / 120.0  # s
ASKED = 100.0  # s
BEFORE = range(1000, 1120)  # sampled in the second before it
AFTER = range(1120, 1144)
FELT = MisalignmentEstimate(0.0, 0.01, 0.0, 1e-4, 0.0, 1e-4)


def frame_check(after: range = AFTER, before: range = BEFORE, every: int = 1) -> FrameCheck:
    """One that received a second of frames before ASKED, and every n-th frame after it."""
    found = FrameCheck()
    for frame in before:
        found.add(frame, ASKED - 0.15 - (before.stop - frame) * PERIOD)  # the arm has rested at least this long
    for frame in after[::every]:
        found.add(frame, ASKED + (frame - after.start) * PERIOD)
    return found


def is_believed(found: FrameCheck, *named: int) -> bool:
    reply = found.checked(Reply(7, True, estimate=FELT, sequences=named, asked=ASKED))
    assert reply.number == 7
    assert reply.success == (reply.estimate is not None)
    assert reply.success or "not confirmed" in reply.message
    return reply.success


def test_frames_after_the_request_are_accepted_even_if_half_of_them_were_lost() -> None:
    assert is_believed(frame_check(), *AFTER)
    assert is_believed(frame_check(every=2), *AFTER)
    assert not is_believed(frame_check(every=3), *AFTER)


@pytest.mark.parametrize(
    ("named", "why"),
    [
        ((), "none"),
        ((0,) * 24, "of a publisher that does not count"),
        ((1120,) * 24, "one again and again"),
        (tuple(reversed(AFTER)), "backwards"),
        (tuple(range(1000, 1024)), "of an earlier question"),
        (tuple(range(1108, 1132)), "half of them from before"),
        ((1119, *AFTER[1:]), "one from before"),
        (tuple(range(5000, 5024)), "never received"),
        ((*AFTER[:11], *range(5000, 5013)), "less than half received"),
        ((2**64 - 1,), "the largest number"),
    ],
)
def test_an_estimate_without_matching_frames_is_refused(named: tuple[int, ...], why: str) -> None:
    assert not is_believed(frame_check(), *named), why


@pytest.mark.parametrize("start", [0, 1, 900, 1100, 2000, 10**12])
def test_frames_after_a_restart_of_tactile_node_or_board_are_accepted(start: int) -> None:
    """The sequence restarts with the first, and jumps ahead with the second."""
    after = range(start, start + 24)
    assert is_believed(frame_check(after), *after)
    assert is_believed(frame_check(after, every=2), *after)


def test_without_received_frames_no_estimate_is_accepted() -> None:
    assert not is_believed(FrameCheck(), *AFTER)


def test_answers_without_an_estimate_are_not_changed() -> None:
    reply = Reply(3, True, "tared", resistance=math.pi)
    assert FrameCheck().checked(reply) is reply
