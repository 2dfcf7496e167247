# SPDX-License-Identifier: Apache-2.0
"""Laws of pairing colour and depth by their stamps."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

from hypothesis import given, settings
from hypothesis import strategies as st

from deltacharger_vision.images import StampMatcher

PERIOD = 33_333_333  # ns, of 30 images a second
COLOR, DEPTH = "color", "depth"

Arrival = tuple[str, int]
Given = tuple[int, int]
"""Stamps of a colour image and its depth."""

arrivals = st.lists(st.tuples(st.sampled_from((COLOR, DEPTH)), st.integers(0, 400)), max_size=120)


def pairs(matcher: StampMatcher[int, int], items: Iterable[Arrival]) -> list[Given]:
    """Each item is its own stamp."""
    found = []
    for kind, stamp in items:
        pair = matcher.add_color(stamp, stamp) if kind == COLOR else matcher.add_depth(stamp, stamp)
        if pair is not None:
            assert pair[0] == pair[1]
            found.append(pair[1:])
    return found


@st.composite
def interleaved(draw: st.DrawFn, colors: Sequence[int], depths: Sequence[int], lead: int) -> list[Arrival]:
    """Both in their order, one at most `lead` items ahead of the other."""
    result: list[Arrival] = []
    left = {COLOR: [*colors], DEPTH: [*depths]}
    while left[COLOR] or left[DEPTH]:
        ahead = (len(colors) - len(left[COLOR])) - (len(depths) - len(left[DEPTH]))
        may = [kind for kind, led in ((COLOR, ahead), (DEPTH, -ahead)) if left[kind] and led < lead]
        kind = draw(st.sampled_from(may or [kind for kind in left if left[kind]]))
        result.append((kind, left[kind].pop(0)))
    return result


@given(items=arrivals, tolerance=st.integers(0, 50), depth=st.integers(1, 8))
def test_pairs_are_near_and_in_order_and_memory_is_bounded(items: list[Arrival], tolerance: int, depth: int) -> None:
    matcher: StampMatcher[int, int] = StampMatcher(tolerance, depth)
    found = []
    for item in items:
        found += pairs(matcher, [item])
        assert len(matcher) <= 2 * depth
    assert all(abs(color - other) <= tolerance for color, other in found)
    for one, two in itertools.pairwise(found):  # strictly: so nothing is returned twice
        assert one[0] < two[0]
        assert one[1] < two[1]
    assert all((COLOR, color) in items and (DEPTH, other) in items for color, other in found)


@given(items=arrivals, tolerance=st.integers(0, 50))
def test_no_matching_items_remain(items: list[Arrival], tolerance: int) -> None:
    matcher: StampMatcher[int, int] = StampMatcher(tolerance, 1000)
    waiting: dict[str, set[int]] = {COLOR: set(), DEPTH: set()}
    given_last = {COLOR: -1, DEPTH: -1}
    for kind, stamp in items:
        other = DEPTH if kind == COLOR else COLOR
        fresh = stamp > given_last[kind] and stamp not in waiting[kind]
        near = [abs(stamp - each) for each in waiting[other] if abs(stamp - each) <= tolerance] if fresh else []
        found = pairs(matcher, [(kind, stamp)])
        assert bool(found) == bool(near)
        if fresh:
            waiting[kind].add(stamp)
        for pair in found:
            given_last = dict(zip((COLOR, DEPTH), pair, strict=True))
            assert abs(pair[0] - pair[1]) == min(near)
            waiting = {name: {each for each in waiting[name] if each > given_last[name]} for name in waiting}


@settings(max_examples=25)
@given(data=st.data(), lead=st.integers(1, 7), lost=st.sets(st.integers(0, 39)), missed=st.sets(st.integers(0, 39)))
def test_simultaneous_images_are_paired_despite_losses(
    data: st.DataObject, lead: int, lost: set[int], missed: set[int]
) -> None:
    colors = [each * PERIOD for each in range(40) if each not in lost]
    depths = [each * PERIOD for each in range(40) if each not in missed]
    items = data.draw(interleaved(range(40), range(40), lead))
    kept = [
        (kind, each * PERIOD) for kind, each in items if (each not in lost if kind == COLOR else each not in missed)
    ]
    both = [(stamp, stamp) for stamp in colors if stamp in depths]
    assert pairs(StampMatcher(PERIOD // 2 - 1), kept) == both


@settings(max_examples=25)
@given(st.data(), st.integers(2 * 10**9, 10**18), st.integers(0, 6))
def test_setting_back_the_clock_loses_no_image(data: st.DataObject, start: int, late: int) -> None:
    """Also if the last old depth images arrive after colour has restarted."""
    stamps = [each * PERIOD for each in range(12)]
    before = [(kind, start + stamp) for stamp in stamps for kind in (COLOR, DEPTH)]
    delayed = [item for item in before if item[0] == DEPTH][12 - late :]
    before = [item for item in before if item not in delayed]
    after = data.draw(interleaved(stamps, [*(stamp for _, stamp in delayed), *stamps], 8 - late))
    found = pairs(StampMatcher(PERIOD // 3), [*before, *after])
    assert [pair for pair in found if pair[0] < start] == [(stamp, stamp) for stamp in stamps]


def test_the_first_of_equals_is_paired_once_and_clearing_accepts_older_items() -> None:
    matcher: StampMatcher[str, str] = StampMatcher(10)
    for name in ("first", "second"):
        assert matcher.add_color(150, name) is None
    assert matcher.add_depth(150, "depth") == (150, "first", "depth")
    assert matcher.add_depth(150, "again") is None
    matcher.clear()
    assert len(matcher) == 0
    assert matcher.add_color(3, "color") is None
    assert matcher.add_depth(3, "depth") == (3, "color", "depth")
