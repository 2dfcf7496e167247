# SPDX-License-Identifier: Apache-2.0
"""Pairs colour and depth images by their stamps as they arrive."""

from __future__ import annotations

import bisect
from typing import Generic, TypeVar

Color = TypeVar("Color")
Depth = TypeVar("Depth")
Item = TypeVar("Item")

_JUMP = 1_000_000_000
"""ns; networks do not reorder messages over so long: the clock was set back, or a recording restarted."""


class StampMatcher(Generic[Color, Depth]):
    """Pairs each colour image with the nearest depth, as soon as both have arrived.

    An exact match has priority, then the nearest within the tolerance. Every item is returned at most once, in order:
    items older than the last pair are dropped. If an item is more than 1 s older than an earlier one of its kind, the
    clock was set back: waiting items from before are dropped, and the order restarts. Of several items with one stamp,
    the first counts.

    Args:
        tolerance_ns: largest difference of stamps, 0 to 1 s; below half the image period, no nearer item can arrive
            later.
        depth: most waiting items of each kind; the oldest is dropped.
    """

    def __init__(self, tolerance_ns: int, depth: int = 8) -> None:
        self._tolerance = tolerance_ns
        self._colors: _Waiting[Color] = _Waiting(depth)
        self._depths: _Waiting[Depth] = _Waiting(depth)

    def __len__(self) -> int:
        """Return the number of waiting items."""
        return len(self._colors.stamps) + len(self._depths.stamps)

    def add_color(self, stamp_ns: int, item: Color) -> tuple[int, Color, Depth] | None:
        """Add a colour image; return its stamp, the image and its depth if that has arrived."""
        return self._matched(stamp_ns) if self._taken(self._colors, stamp_ns, item) else None

    def add_depth(self, stamp_ns: int, item: Depth) -> tuple[int, Color, Depth] | None:
        """Add a depth image; return its colour's stamp, the colour and the depth if the colour has arrived."""
        return self._matched(stamp_ns) if self._taken(self._depths, stamp_ns, item) else None

    def clear(self) -> None:
        """Drop all items, for example after a pause."""
        self._colors.clear()
        self._depths.clear()

    def _taken(self, stream: _Waiting[Item], stamp: int, item: Item) -> bool:
        """Add an item and return whether it waits."""
        if stream.newest is not None and stamp < stream.newest - _JUMP:
            stream.newest = None
            self._colors.forget_after(stamp + _JUMP)
            self._depths.forget_after(stamp + _JUMP)
        return stream.add(stamp, item)

    def _matched(self, stamp: int) -> tuple[int, Color, Depth] | None:
        """Return the pair with the item just added; no other pair can be new."""
        color, depth = self._colors.nearest(stamp), self._depths.nearest(stamp)
        if color is None or depth is None or abs(color - depth) > self._tolerance:
            return None
        return color, self._colors.take(color), self._depths.take(depth)


class _Waiting(Generic[Item]):
    """Items of one kind, by increasing stamp.

    Attributes:
        stamps: of the waiting items, ns.
        newest: largest stamp since the clock was last set back.
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
        """Add an item; False if it is a duplicate, not newer than the last pair, or older than all in a full queue."""
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
        """Return the stamp nearest to `stamp`, the older of two, or None if nothing waits."""
        return min(self.stamps, key=lambda each: abs(each - stamp), default=None)

    def take(self, stamp: int) -> Item:
        """Return the waiting item of a stamp, and drop it with all older ones."""
        place = self.stamps.index(stamp)
        item = self._items[place]
        del self.stamps[: place + 1], self._items[: place + 1]
        self._given = stamp
        return item

    def forget_after(self, stamp: int) -> None:
        """Drop items newer than `stamp`, from before the clock was set back."""
        kept = bisect.bisect_right(self.stamps, stamp)
        del self.stamps[kept:], self._items[kept:]
        if self._given is not None and self._given > stamp:
            self._given = None
