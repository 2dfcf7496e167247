# SPDX-License-Identifier: Apache-2.0
"""Checks that an estimate comes from tactile frames that docking received itself. Part of docking_node."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise

from deltacharger_docking.observation import Reply

_KEPT = 1024  # frames, 8 s: more than the longest request for an estimate takes
_SHARE = 0.5  # of an estimate's frames that docking must have received: a best-effort topic loses some
# The arm has rested for longer than this when an estimate is requested, and clocks of two computers may differ by this
# much (`host_clock.AHEAD`): a frame sampled this long before the request was still sampled after the last move.
_BEFORE = 0.1  # s


class FrameCheck:
    """Stores sequence numbers of recent frames, and checks estimates against them."""

    def __init__(self) -> None:
        self._frames: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def add(self, sequence: int, sampled: float) -> None:
        """Add a frame sampled at `sampled`, s monotonic."""
        self._frames.append((sequence, sampled))

    def checked(self, reply: Reply) -> Reply:
        """Return the reply, or a refusal in its place if its estimate is not confirmed."""
        if reply.estimate is None:
            return reply
        doubt = self._doubt(reply.sequences, reply.asked - _BEFORE)
        if not doubt:
            return reply
        text = f"the estimate is not confirmed: {doubt}; check for a second server of predict_misalignment"
        return replace(reply, success=False, message=text, estimate=None)

    def _doubt(self, named: tuple[int, ...], since: float) -> str:
        """Return why the frames may not have been sampled after `since` (s, monotonic); '' = no reason."""
        if not named:
            return "it does not name the frames that it averaged"
        if any(later <= earlier for earlier, later in pairwise(named)):
            return "it names tactile frames twice or out of order"
        fresh = {sequence for sequence, sampled in self._frames if sampled > since}
        known = len(fresh.intersection(named))
        if known < _SHARE * len(named) or not known:
            return f"docking received only {known} of its {len(named)} tactile frames after the request"
        first = min(fresh)  # an earlier frame with a higher number is from before a restart of tactile_node
        if any(named[0] <= sequence < first for sequence, sampled in self._frames if sampled <= since):
            return "some of its tactile frames were sampled before the request"
        return ""
