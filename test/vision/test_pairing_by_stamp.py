# SPDX-License-Identifier: Apache-2.0
"""Laws of pairing colour and depth by their stamps."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

from hypothesis import given
from hypothesis import strategies as st

from deltacharger_vision.images import COLOR, DEPTH, STAMP_TOLERANCE, StampMatcher

PERIOD = 33_333_333  # ns, of 30 images a second
MS = 1_000_000

Arrival = tuple[str, int]

arrivals = st.lists(st.tuples(st.sampled_from((COLOR, DEPTH)), st.integers(0, 400)), max_size=120)


def pairs(items: Iterable[Arrival], matcher: StampMatcher[Arrival] | None = None) -> list[tuple[int, int]]:
    """Return the stamps of the colours and depths that are paired; each item is its own image."""
    matcher, found = matcher or StampMatcher(), []
    for kind, stamp in items:
        pair = matcher.add_image(kind, stamp, (kind, stamp))
        if pair is not None:
            assert pair[1] == (COLOR, pair[0])
            found.append((pair[0], pair[2][1]))
    return found


@given(items=arrivals)
def test_pairs_are_near_and_in_order_and_memory_is_bounded(items: list[Arrival]) -> None:
    matcher: StampMatcher[Arrival] = StampMatcher()
    found = pairs([(kind, stamp * MS) for kind, stamp in items], matcher)
    assert all(abs(color - depth) <= STAMP_TOLERANCE for color, depth in found)
    for one, two in itertools.pairwise(found):  # strictly: so nothing is returned twice
        assert one[0] < two[0]
        assert one[1] < two[1]
    assert all(len(waiting) <= 8 for waiting in matcher._waiting.values())


@given(st.integers(-7, 7), st.sets(st.integers(0, 39)), st.sets(st.integers(0, 39)), st.integers(0, 14))
def test_simultaneous_images_are_paired_despite_losses(lead: int, lost: set[int], missed: set[int], apart: int) -> None:
    """One kind arrives up to seven images after the other."""
    colors = [(each, COLOR, each * PERIOD) for each in range(40) if each not in lost]
    depths = [(each + lead, DEPTH, each * PERIOD + apart * MS) for each in range(40) if each not in missed]
    both = [(each * PERIOD, each * PERIOD + apart * MS) for each in range(40) if each not in lost | missed]
    assert pairs((kind, stamp) for _, kind, stamp in sorted(colors + depths)) == both


def test_setting_back_the_clock_begins_again() -> None:
    again = [(kind, stamp * PERIOD) for stamp in range(3) for kind in (DEPTH, COLOR)]
    late = (DEPTH, 10**18)
    found = pairs([*((kind, 10**12 + stamp) for kind, stamp in again), late, *again])
    assert found[3:] == [(stamp * PERIOD, stamp * PERIOD) for stamp in range(3)]
    matcher: StampMatcher[Arrival] = StampMatcher()
    assert len(pairs(again, matcher)) == 3
    assert not pairs(again, matcher)
    matcher.clear()
    assert len(pairs(again, matcher)) == 3
