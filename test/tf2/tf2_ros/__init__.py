# SPDX-License-Identifier: Apache-2.0
"""A stand-in for tf2_ros where no tf2 is installed: the part of its Buffer that deltacharger_core.ros.frames uses."""

import bisect
import math
from collections.abc import Iterable, Sequence
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.time import Time

from deltacharger_core.frames import IDENTITY, Pose, composed, inverted

_CACHE = 10_000_000_000  # ns, as tf2's
_ENDLESS = 2**63 - 1


class TransformException(Exception):
    """A transform cannot be told."""


class LookupException(TransformException):
    """A frame does not exist."""


class ConnectivityException(TransformException):
    """Nothing connects two frames."""


class ExtrapolationException(TransformException):
    """A time lies outside what is known."""


class _Link:
    """Where a frame was in its parent: at times (ns) in rising order, or for ever."""

    def __init__(self) -> None:
        self.parent = ""
        self.fixed = False
        self.times: list[int] = []
        self.poses: list[Pose] = []

    def put(self, stamp: int, pose: Pose) -> None:
        place = bisect.bisect_left(self.times, stamp)
        if place < len(self.times) and self.times[place] == stamp:
            self.poses[place] = pose
        else:
            self.times.insert(place, stamp)
            self.poses.insert(place, pose)
        while self.times[0] < self.times[-1] - _CACHE:
            del self.times[0], self.poses[0]

    def newest(self) -> int:
        return _ENDLESS if self.fixed else self.times[-1]

    def at(self, stamp: int) -> Pose:
        if self.fixed:
            return self.poses[-1]
        if not self.times[0] <= stamp <= self.times[-1]:
            where = "past" if stamp < self.times[0] else "future"
            raise ExtrapolationException(f"Lookup would require extrapolation into the {where}")
        after = bisect.bisect_left(self.times, stamp)
        if self.times[after] == stamp:
            return self.poses[after]
        start, end = self.times[after - 1], self.times[after]
        share = (stamp - start) / (end - start)
        return _between(self.poses[after - 1], self.poses[after], share)


class Buffer:
    """Transforms of the last 10 s."""

    def __init__(self, cache_time: Any = None, node: Any = None) -> None:
        self._links: dict[str, _Link] = {}

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        """Keep a transform at its stamp."""
        self._put(transform, fixed=False)

    def set_transform_static(self, transform: TransformStamped, authority: str) -> None:
        """Keep a transform for all times."""
        self._put(transform, fixed=True)

    def clear(self) -> None:
        """Forget all but static transforms."""
        self._links = {name: link for name, link in self._links.items() if link.fixed}

    def lookup_transform(self, target_frame: str, source_frame: str, time: Time) -> TransformStamped:
        """Return the pose of `source_frame` in `target_frame`; time zero = the newest that all links have."""
        up, down = self._to_root(source_frame), self._to_root(target_frame)
        if up[-1] != down[-1]:
            raise ConnectivityException(f"'{target_frame}' and '{source_frame}' are not in the same tree")
        while len(up) > 1 and len(down) > 1 and up[-2] == down[-2]:
            up.pop()
            down.pop()
        links = [self._links[frame] for frame in (*up[:-1], *down[:-1])]
        stamp = time.nanoseconds or min((link.newest() for link in links), default=_ENDLESS)
        there, here = self._along(up[:-1], stamp), self._along(down[:-1], stamp)
        found = TransformStamped(child_frame_id=source_frame)
        found.header.frame_id = target_frame
        found.header.stamp = Time(nanoseconds=0 if stamp == _ENDLESS else stamp).to_msg()
        place, turn = found.transform.translation, found.transform.rotation
        place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = composed(inverted(here), there)
        return found

    def _put(self, transform: TransformStamped, fixed: bool) -> None:
        link = self._links.setdefault(transform.child_frame_id, _Link())
        link.parent, link.fixed = transform.header.frame_id, fixed
        place, turn = transform.transform.translation, transform.transform.rotation
        pose = _pose((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))
        link.put(Time.from_msg(transform.header.stamp).nanoseconds, pose)

    def _to_root(self, frame: str) -> list[str]:
        if frame not in self._links and frame not in {link.parent for link in self._links.values()}:
            raise LookupException(f'"{frame}" passed to lookupTransform does not exist')
        way = [frame]
        while way[-1] in self._links:
            way.append(self._links[way[-1]].parent)
            if len(way) > len(self._links) + 1:
                raise LookupException(f"the tree that holds '{frame}' contains a loop")
        return way

    def _along(self, frames: list[str], stamp: int) -> Pose:
        pose = IDENTITY
        for frame in frames:
            pose = composed(self._links[frame].at(stamp), pose)
        return pose


def _between(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose at a share of the way, with quaternions in a straight line: near enough for small turns."""
    same = math.copysign(1.0, sum(p * q for p, q in zip(a[3:], b[3:], strict=True)))
    x, y, z, *turn = (p + share * (f * q - p) for p, q, f in zip(a, b, (1, 1, 1, *[same] * 4), strict=True))
    return _pose((x, y, z), turn)


def _pose(place: Iterable[float], turn: Sequence[float]) -> Pose:
    length = math.hypot(*turn)
    (x, y, z), (a, b, c, d) = place, (value / length for value in turn)
    return x, y, z, a, b, c, d
