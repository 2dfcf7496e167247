# SPDX-License-Identifier: Apache-2.0
"""Colour and depth of one instant, brought together by their stamps as they arrive."""

from __future__ import annotations

import bisect
from typing import Generic, TypeVar

Color = TypeVar("Color")
Depth = TypeVar("Depth")
Item = TypeVar("Item")

_JUMP = 1_000_000_000
"""ns; no network mixes up the order of messages over so long: the clock was set back, or a recording began again."""


class StampMatcher(Generic[Color, Depth]):
    """Gives each colour with the nearest depth, at once when the second of the two arrives.

    Of what waits, an exact match is taken first, then the nearest within the tolerance. Every item is given once, and
    in order: what is older than the pair given last is dropped, however late it arrives. An item more than 1 s older
    than one before it of the same kind means that the clock was set back: what waits from before is forgotten, and the
    order begins anew. Of several items of one stamp the first counts.

    Args:
        tolerance_ns: largest difference of stamps, 0 to 1 s; under half the time between two images, no nearer one
            can arrive later.
        depth: how many items of each kind wait at most; the oldest gives way.
    """

    def __init__(self, tolerance_ns: int, depth: int = 8) -> None:
        self._tolerance = tolerance_ns
        self._colors: _Waiting[Color] = _Waiting(depth)
        self._depths: _Waiting[Depth] = _Waiting(depth)

    def __len__(self) -> int:
        """Return how many items wait."""
        return len(self._colors.stamps) + len(self._depths.stamps)

    def add_color(self, stamp_ns: int, item: Color) -> tuple[int, Color, Depth] | None:
        """Take a colour image; return its stamp, it and its depth where that waits."""
        return self._matched(stamp_ns) if self._taken(self._colors, stamp_ns, item) else None

    def add_depth(self, stamp_ns: int, item: Depth) -> tuple[int, Color, Depth] | None:
        """Take a depth image; return its colour's stamp, the colour and it where that waits."""
        return self._matched(stamp_ns) if self._taken(self._depths, stamp_ns, item) else None

    def clear(self) -> None:
        """Forget everything, as after a pause."""
        self._colors.clear()
        self._depths.clear()

    def _taken(self, stream: _Waiting[Item], stamp: int, item: Item) -> bool:
        """Let an item wait, and return whether it does."""
        if stream.newest is not None and stamp < stream.newest - _JUMP:
            stream.newest = None
            self._colors.forget_after(stamp + _JUMP)
            self._depths.forget_after(stamp + _JUMP)
        return stream.add(stamp, item)

    def _matched(self, stamp: int) -> tuple[int, Color, Depth] | None:
        """Return the pair that the item just added makes, of one kind or the other; nothing else can be new."""
        color, depth = self._colors.nearest(stamp), self._depths.nearest(stamp)
        if color is None or depth is None or abs(color - depth) > self._tolerance:
            return None
        return color, self._colors.take(color), self._depths.take(depth)


class _Waiting(Generic[Item]):
    """Items of one kind, by rising stamp.

    Attributes:
        stamps: of those that wait, ns.
        newest: largest stamp that was added since the clock was last set back.
    """

    def __init__(self, room: int) -> None:
        self._room = room
        self.clear()

    def clear(self) -> None:
        self.stamps: list[int] = []
        self.newest: int | None = None
        self._items: list[Item] = []
        self._given: int | None = None

    def add(self, stamp: int, item: Item) -> bool:
        """Return whether it waits: it is no duplicate, not older than what was given, nor than all in a full room."""
        self.newest = stamp if self.newest is None else max(stamp, self.newest)
        place = bisect.bisect_left(self.stamps, stamp)
        if (self._given is not None and stamp <= self._given) or self.stamps[place : place + 1] == [stamp]:
            return False
        self.stamps.insert(place, stamp)
        self._items.insert(place, item)
        if len(self.stamps) <= self._room:
            return True
        del self.stamps[0], self._items[0]
        return place > 0

    def nearest(self, stamp: int) -> int | None:
        """Return the stamp nearest to `stamp`, the older of two, or None where nothing waits."""
        return min(self.stamps, key=lambda each: abs(each - stamp), default=None)

    def take(self, stamp: int) -> Item:
        """Return the item of a stamp that waits, and drop it with all older ones."""
        place = self.stamps.index(stamp)
        item = self._items[place]
        del self.stamps[: place + 1], self._items[: place + 1]
        self._given = stamp
        return item

    def forget_after(self, stamp: int) -> None:
        """Forget what is newer than `stamp`, as from before the clock was set back."""
        kept = bisect.bisect_right(self.stamps, stamp)
        del self.stamps[kept:], self._items[kept:]
        if self._given is not None and self._given > stamp:
            self._given = None
