# SPDX-License-Identifier: Apache-2.0
"""Which tactile frames docking heard itself, and whether they stand behind an estimate. Part of docking_node."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise

from deltacharger_docking.observation import Reply

_KEPT = 1024  # frames, 8 s: more than the longest request for an estimate takes
_SHARE = 0.5  # of an estimate's frames that docking must have heard itself: a topic of best effort loses some
# The arm has rested longer than that when an estimate is asked for, and the clocks of two computers may differ by so
# much (`refusals.AHEAD`): a frame sampled this long before the question was still sampled after the last move.
_BEFORE = 0.1  # s


class Witness:
    """Remembers the frames of the last seconds by their sequences."""

    def __init__(self) -> None:
        self._heard: deque[tuple[int, float]] = deque(maxlen=_KEPT)

    def hear(self, sequence: int, sampled: float) -> None:
        """Take a frame; `sampled` is when, s monotonic."""
        self._heard.append((sequence, sampled))

    def checked(self, reply: Reply) -> Reply:
        """Return the reply, or a refusal in its place where it holds an estimate that nobody can vouch for."""
        if reply.estimate is None:
            return reply
        doubt = self._doubt(reply.sequences, reply.asked - _BEFORE)
        if not doubt:
            return reply
        text = f"nobody can vouch for the estimate: {doubt}; look for a second server of predict_misalignment"
        return replace(reply, success=False, message=text, estimate=None)

    def _doubt(self, named: tuple[int, ...], since: float) -> str:
        """Return what speaks against frames having been sampled after `since` (s, monotonic); '' = nothing."""
        if not named:
            return "it does not name the frames that it was asked to average"
        if any(later <= earlier for earlier, later in pairwise(named)):
            return "it names tactile frames twice or out of order"
        fresh = {sequence for sequence, sampled in self._heard if sampled > since}
        known = len(fresh.intersection(named))
        if known < _SHARE * len(named) or not known:
            return f"docking heard only {known} of its {len(named)} tactile frames itself after asking"
        first = min(fresh)  # an earlier frame with a higher number is from before tactile_node was restarted
        if any(named[0] <= sequence < first for sequence, sampled in self._heard if sampled <= since):
            return "some of its tactile frames were sampled before it was asked for"
        return ""
