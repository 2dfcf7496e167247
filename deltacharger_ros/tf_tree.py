# SPDX-License-Identifier: Apache-2.0
"""What tf knows, looked up only when somebody asks: tf2_ros's buffer over /tf and /tf_static.

tf2_ros comes with every ROS installation and not from PyPI. Its TransformListener would take every message of /tf in
Python, hundreds a second, for a goal an hour; here they wait in the readers' histories, as long as that listener's,
and go into the buffer when a transform is asked for (docs/benchmarks.md).
"""

from __future__ import annotations

import difflib
import importlib.util
import threading
import time
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time

from deltacharger_core.frames import TransformParameters
from deltacharger_core.rotation import Pose
from deltacharger_ros.on_demand import PolledTopic

TF, TF_STATIC = "/tf", "/tf_static"
_DEPTH = 100  # messages, as of TransformListener
_POLL = 0.02  # s between two looks while a transform is waited for
_NAMED = 5  # frames that a message lists
_QUOTED = 60  # characters of a frame's name that a message repeats
_SET_BACK = 1_000_000_000  # ns by which a clock goes back that begins anew, such as that of a simulation


class TransformError(ValueError):
    """A transform cannot be told now; the message says why and what to do. It may come back by itself."""


class UnknownFrame(TransformError):
    """A frame is not known, or nothing connects it. Asking again does not help."""


def installed() -> bool:
    """Return whether tf2_ros can be imported."""
    return importlib.util.find_spec("tf2_ros") is not None and importlib.util.find_spec("tf2_msgs") is not None


class TfTree:
    """The transforms of a node's tf.

    Args:
        node: subscribes to /tf and /tf_static; its clock tells ages.
        given: how transforms are waited for and judged.

    Raises:
        ImportError: tf2_msgs is not installed.
    """

    def __init__(self, node: Node, given: TransformParameters) -> None:
        from tf2_msgs.msg import TFMessage

        self._node = node
        self._given = given
        latched = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moving = PolledTopic(node, TFMessage, TF, QoSProfile(depth=_DEPTH))
        self._fixed = PolledTopic(node, TFMessage, TF_STATIC, latched)
        self._lock = threading.Lock()
        self._waits = threading.Lock()  # held by the one who waits: goals in unknown frames keep no worker from others
        self._buffer: Any = None  # made when it is first needed: its import takes more memory than the readers
        self._parents: dict[str, str] = {}
        self._static: dict[str, Any] = {}
        self._last = 0  # ns, the node's clock
        self._settled = time.monotonic() + given.transform_timeout

    @property
    def settling(self) -> float:
        """How long fixed transforms that are published may still take to be heard after the start, s."""
        left = self._settled - time.monotonic()
        return left if left > 0.0 and self._node.count_publishers(TF_STATIC) else 0.0

    def knows(self, *frames: str) -> bool:
        """Return whether tf knows all these frames now."""
        with self._lock:
            self._read()
            return all(self._knows(frame) for frame in frames)

    def lookup(self, parent: str, child: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of the frame `child` in the frame `parent`.

        Args:
            parent: full name.
            child: full name.
            stamp: when; None or zero = the newest that tf knows. Where nothing moves between the two, any time will do.
            timeout: s that it is waited for, by one caller at a time; None = `transform_timeout`.

        Raises:
            UnknownFrame: tf does not know a frame, or does not connect them.
            TransformError: the transform, or the stamp, is older than `transform_age_max` or lies in the future.
        """
        patience = self._given.transform_timeout if timeout is None else timeout
        alone = patience > 0.0 and self._waits.acquire(blocking=False)
        try:
            return self._wait(parent, child, stamp, patience if alone else 0.0)
        finally:
            if alone:
                self._waits.release()

    def _wait(self, parent: str, child: str, stamp: Stamp | None, patience: float) -> Pose:
        end = time.monotonic() + patience
        while True:
            with self._lock:
                self._read()
                try:
                    return self._found(parent, child, stamp)
                except TransformError:
                    if time.monotonic() >= end:
                        raise
            time.sleep(_POLL)

    def _read(self) -> None:
        """Give the buffer what has come since the last look."""
        now = int(self._node.get_clock().now().nanoseconds)
        if self._buffer is None or now < self._last - _SET_BACK:
            self._begin()
        self._last = now
        for message, _ in self._fixed.take():
            for each in message.transforms:
                self._static[each.child_frame_id] = each
                self._take(each, fixed=True)
        for message, _ in self._moving.take():
            for each in message.transforms:
                self._take(each, fixed=False)

    def _begin(self) -> None:
        """Begin with an empty buffer, but for what is fixed and was told once."""
        from tf2_ros import Buffer

        self._buffer = Buffer()
        self._parents.clear()
        for each in self._static.values():
            self._take(each, fixed=True)

    def _take(self, transform: Any, fixed: bool) -> None:
        put = self._buffer.set_transform_static if fixed else self._buffer.set_transform
        put(transform, "tf")
        self._parents[transform.child_frame_id] = transform.header.frame_id

    def _knows(self, frame: str) -> bool:
        return frame in self._parents or frame in self._parents.values()

    def _found(self, parent: str, child: str, stamp: Stamp | None) -> Pose:
        """Return the pose by what is in the buffer; errors as of `lookup`."""
        self._check_connected(parent, child)
        newest = self._ask(parent, child, Time())
        moves = Time.from_msg(newest.header.stamp).nanoseconds
        at = Time() if stamp is None else Time.from_msg(stamp)
        if not moves or not at.nanoseconds:
            self._check_age(moves, f"the transform from '{child}' to '{parent}'", "check what publishes it, and clocks")
            return _numbers(newest)
        what = f"the pose in '{_quoted(parent)}', which moves against '{_quoted(child)}',"
        self._check_age(at.nanoseconds, what, "send it with stamp 0, the newest, or stamp it when you send it")
        return _numbers(self._ask(parent, child, at))

    def _ask(self, parent: str, child: str, at: Time) -> Any:
        from tf2_ros import TransformException

        try:
            return self._buffer.lookup_transform(parent, child, at)
        except TransformException as error:
            when = "at the time of its stamp" if at.nanoseconds else "now"
            raise TransformError(
                f"tf cannot tell '{_quoted(child)}' in '{_quoted(parent)}' {when}: {error}; send the pose with stamp "
                "0, the newest, and check what publishes the transforms between them, and clocks"
            ) from error

    def _check_age(self, stamp: int, what: str, remedy: str) -> None:
        """Refuse what was stamped (ns) too long ago or ahead; 0 = it does not move."""
        age, limit = 1e-9 * (self._last - stamp), self._given.transform_age_max
        if stamp and abs(age) > limit:
            when = f"{age:.1f} s old" if age > 0.0 else f"{-age:.1f} s in the future"
            raise TransformError(f"{what} is {when}, beyond transform_age_max ({limit:g} s): {remedy}")

    def _check_connected(self, parent: str, child: str) -> None:
        for frame in (parent, child):
            if not self._knows(frame):
                raise UnknownFrame(f"tf does not know the frame '{_quoted(frame)}'; {self._known(frame)}")
        roots = [self._root(frame) for frame in (parent, child)]
        if roots[0] != roots[1]:
            raise UnknownFrame(
                f"tf does not connect '{_quoted(parent)}' with '{_quoted(child)}': they hang on '{roots[0]}' and on "
                f"'{roots[1]}'; start what publishes the transform between these, such as localization"
            )

    def _root(self, frame: str) -> str:
        seen = {frame}
        while (above := self._parents.get(frame)) is not None and above not in seen:
            frame = above
            seen.add(frame)
        return frame

    def _known(self, frame: str) -> str:
        """Return in words which frames there are, the nearest names first."""
        known = sorted({*self._parents, *self._parents.values()})
        if not known:
            return "it knows none: nothing publishes to /tf or /tf_static in this domain"
        near = difflib.get_close_matches(frame, known, _NAMED, 0.0)
        return f"it knows {len(known)}, such as {', '.join(near)}"


def _numbers(found: Any) -> Pose:
    place, turn = found.transform.translation, found.transform.rotation
    return place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w


def _quoted(frame: str) -> str:
    return ascii(frame[:_QUOTED])[1:-1]
