# SPDX-License-Identifier: Apache-2.0
"""Pose of charger_base in other frames: from tf if tf2_ros is installed, otherwise from the node's parameters.

The mount of the charger on its robot has one source: tf's transform of charger_base in base_frame if there is one,
otherwise the parameter base_pose. A given base_pose that differs from tf is an error.

tf2_ros is part of every ROS installation but not on PyPI. Its TransformListener would process every message of /tf in
Python, hundreds a second, for a goal an hour. Here messages wait in the readers' histories (same depth) and enter the
buffer when a transform is requested (docs/benchmarks.md).
"""

import difflib
import importlib.util
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time

from deltacharger_core.frames import CHARGER_BASE, IDENTITY, LONGEST, Pose, TransformParameters, apart, composed
from deltacharger_core.ros import log, on_demand, parameters
from deltacharger_core.texts import far

SAME = (0.002, math.radians(0.5))  # m and rad, tolerance for one mount: rounding in a URDF, measuring by ruler
TF, TF_STATIC = "/tf", "/tf_static"
_DEPTH = 100  # messages, as in TransformListener
_POLL = 0.02  # s between polls for a transform
_NAMED = 5  # frames listed in a message
_QUOTED = 60  # maximum characters of a frame's name in a message
_SET_BACK = 1_000_000_000  # ns; a larger step back of the clock is a restart, e.g. of a simulation


class TransformError(ValueError):
    """A transform is not available now, perhaps later. The message states the reason and the remedy."""


class UnknownFrame(TransformError):
    """A frame is unknown or not connected. A retry does not help."""


def installed() -> bool:
    """Return whether tf2_ros can be imported."""
    return importlib.util.find_spec("tf2_ros") is not None and importlib.util.find_spec("tf2_msgs") is not None


class TfTree:
    """The transforms of a node's tf.

    Args:
        node: subscriber of /tf and /tf_static; ages are by its clock.
        given: timeout and maximum age of transforms.

    Raises:
        ImportError: tf2_msgs is not installed.
    """

    def __init__(self, node: Node, given: TransformParameters) -> None:
        from tf2_msgs.msg import TFMessage

        self._node = node
        self._given = given
        latched = QoSProfile(depth=_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._moving = on_demand.PolledTopic(node, TFMessage, TF, QoSProfile(depth=_DEPTH))
        self._fixed = on_demand.PolledTopic(node, TFMessage, TF_STATIC, latched)
        self._lock = threading.Lock()
        self._waits = threading.Lock()  # one waiter at a time: goals in unknown frames must not occupy all workers
        self._buffer: Any = None  # created when first needed: its import takes more memory than the readers
        self._parents: dict[str, str] = {}
        self._left_out: dict[str, str] = {}  # frame → why its newest transform was refused for its stamp
        self._last = 0  # ns, the node's clock
        self._started = time.monotonic()
        self._closing = threading.Event()

    def close(self) -> None:
        """Wake all waiting threads."""
        self._closing.set()

    @property
    def settling(self) -> float:
        """Remaining time, s, in which published transforms may still arrive for the first time."""
        return max(0.0, self._started + self._given.transform_timeout - time.monotonic())

    def knows(self, *frames: str) -> bool:
        """Return whether tf has all these frames now."""
        with self._lock:
            self._read()
            return all(self._knows(frame) for frame in frames)

    def lookup(self, parent: str, child: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of the frame `child` in the frame `parent`.

        Args:
            parent: full name.
            child: full name.
            stamp: time of the pose; None or zero = the newest transform. Between fixed frames any time is valid.
            timeout: s, longest wait; only one caller at a time waits. None = `transform_timeout`.

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
            if self._closing.wait(_POLL):
                raise TransformError("the node is shutting down; send the goal again when it is back")

    def _read(self) -> None:
        """Move new messages into the buffer."""
        now = int(self._node.get_clock().now().nanoseconds)
        if self._buffer is None:
            from tf2_ros import Buffer

            self._buffer = Buffer()
        if now < self._last - _SET_BACK:
            self._buffer.clear()  # static transforms stay
            self._left_out.clear()
        self._last = now
        for message, _ in self._fixed.take():
            for each in message.transforms:
                if each.header.stamp.sec >= 0:
                    self._take(each, self._buffer.set_transform_static)
        for message, _ in self._moving.take():
            for each in message.transforms:
                self._take_moving(each)

    def _take_moving(self, transform: Any) -> None:
        """Store a transform unless it is from the future: the buffer would treat it as the newest until then."""
        stamp, child = transform.header.stamp, transform.child_frame_id
        age = 1e-9 * (self._last - stamp.sec * 1_000_000_000 - stamp.nanosec)
        if stamp.sec < 0 or age < -self._given.transform_age_max:
            when = f"{-age:.1f} s in the future" if stamp.sec >= 0 else "before 1970"
            self._left_out[child] = (
                f"; the newest transform of {quoted(child)} is stamped {when}, beyond {self._limit()}"
            )
            self._parents.setdefault(child, transform.header.frame_id)
            return
        self._left_out.pop(child, None)
        self._take(transform, self._buffer.set_transform)

    def _take(self, transform: Any, put: Callable[[Any, str], None]) -> None:
        put(transform, "tf")
        self._parents[transform.child_frame_id] = transform.header.frame_id

    def _knows(self, frame: str) -> bool:
        return frame in self._parents or frame in self._parents.values()

    def _limit(self) -> str:
        return f"transform_age_max ({self._given.transform_age_max:g} s)"

    def _found(self, parent: str, child: str, stamp: Stamp | None) -> Pose:
        """Return the pose from the buffer; errors as in `lookup`."""
        for frame in (parent, child):
            if not self._knows(frame):
                raise UnknownFrame(f"tf does not know the frame {quoted(frame)}; {self._known(frame)}")
        newest = self._ask(parent, child, Time())
        moves = Time.from_msg(newest.header.stamp).nanoseconds
        if stamp is not None and stamp.sec < 0:
            raise TransformError(f"the stamp is negative (sec {stamp.sec}): send 0 (newest) or the pose's time")
        at = Time() if stamp is None else Time.from_msg(stamp)
        if not moves or not at.nanoseconds:
            what = f"the transform from {quoted(child)} to {quoted(parent)}"
            self._check_age(moves, what, "check its publisher and the clocks")
            return _numbers(newest)
        what = f"the pose in {quoted(parent)}, which moves relative to {quoted(child)},"
        self._check_age(at.nanoseconds, what, "send it with stamp 0 (newest) or with the time of sending")
        return _numbers(self._ask(parent, child, at))

    def _ask(self, parent: str, child: str, at: Time) -> Any:
        from tf2_ros import ConnectivityException, TransformException

        try:
            return self._buffer.lookup_transform(parent, child, at)
        except TransformException as error:
            when = "at the time of its stamp" if at.nanoseconds else "now"
            left_out = next(iter(self._left_out.values()), "")
            why = f"{error}{left_out}"
            kind = UnknownFrame if isinstance(error, ConnectivityException) and not left_out else TransformError
            raise kind(
                f"tf has no transform of {quoted(child)} in {quoted(parent)} {when}: {why}; send the pose with stamp 0 "
                "(newest), and check the publishers of the transforms between them and the clocks"
            ) from error

    def _check_age(self, stamp: int, what: str, remedy: str) -> None:
        """Refuse a stamp (ns) too far in the past or future; 0 = fixed, no check."""
        age = 1e-9 * (self._last - stamp)
        if stamp and abs(age) > self._given.transform_age_max:
            when = f"{age:.1f} s old" if age > 0.0 else f"{-age:.1f} s in the future"
            raise TransformError(f"{what} is {when}, beyond {self._limit()}: {remedy}")

    def _known(self, frame: str) -> str:
        """Return the known frames as text, nearest names first."""
        known = sorted({*self._parents, *self._parents.values()})
        if not known:
            return "it knows none: nothing publishes to /tf or /tf_static in this domain"
        near = difflib.get_close_matches(frame, known, _NAMED, 0.0)
        return f"it knows {len(known)}, such as {', '.join(near)}"


def _numbers(found: Any) -> Pose:
    place, turn = found.transform.translation, found.transform.rotation
    return place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w


def quoted(frame: str) -> str:
    """Return a frame's name, quoted and shortened for messages."""
    return ascii(frame[:_QUOTED])


class Contradiction(TransformError):
    """tf's mount of the charger differs from the parameter base_pose, or is none on a robot."""


class Frames:
    """Provides the pose of charger_base in any frame that tf knows.

    Args:
        node: owner.
        given: frame prefix, and timeout and maximum age of transforms.
        base_frame: full name of the robot's frame.
        base_pose: the node's parameter: pose of charger_base in base_frame.

    Attributes:
        charger_base: full name of charger_base.
    """

    def __init__(self, node: Node, given: TransformParameters, base_frame: str, base_pose: Sequence[float]) -> None:
        self.charger_base = given.named(CHARGER_BASE)
        self._log = log.Log(node)
        self._base_frame = base_frame
        x, y, z, *turn = base_pose
        self._base_pose: Pose = x, y, z, turn[0], turn[1], turn[2], turn[3]
        self._is_given = parameters.was_given(node, "base_pose")
        self._tf = TfTree(node, given) if installed() else None
        self._logged = False  # that base_pose is used although tf is available

    def close(self) -> None:
        """Wake all threads that wait for a transform."""
        if self._tf is not None:
            self._tf.close()

    def needs_tf(self, frame: str) -> bool:
        """Whether `charger_base_in` looks this frame up in tf."""
        return self._tf is not None and frame not in ("", self.charger_base) and len(frame) <= LONGEST

    def charger_base_in(self, frame: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of charger_base in a frame.

        Args:
            frame: full name; empty = charger_base.
            stamp: time of the pose; None or zero = now.
            timeout: s, longest wait for a transform; None = `transform_timeout`.

        Raises:
            UnknownFrame: the frame is unknown.
            TransformError: see `TfTree.lookup`; Contradiction: see `base_pose`.
        """
        if frame in ("", self.charger_base):
            return IDENTITY
        if self._tf is None and frame == self._base_frame:
            return self._base_pose
        if self._tf is None or not self.needs_tf(frame):
            raise UnknownFrame(f"unknown frame {quoted(frame)}: {self._remedy()}")
        base = self.base_pose(timeout)
        if frame == self._base_frame:
            return base
        try:
            if self._tf.knows(self.charger_base):
                return self._tf.lookup(frame, self.charger_base, stamp, timeout)
            return composed(self._tf.lookup(frame, self._base_frame, stamp, timeout), base)
        except UnknownFrame as error:
            raise UnknownFrame(f"unknown frame {quoted(frame)}: {error}; or {self._remedy()}") from error

    def base_pose(self, timeout: float | None = None) -> Pose:
        """Return charger_base in base_frame.

        Raises:
            Contradiction: tf differs from the given parameter.
            TransformError: in tf the charger moves on its robot and its present pose is unknown; or base_pose was not
                given and tf may not have been received yet.
        """
        tf = self._tf
        if tf is None:
            return self._base_pose
        try:
            return self._agreed(tf, 0.0 if self._is_given or timeout == 0.0 else tf.settling)
        except UnknownFrame as error:
            if not self._is_given and tf.settling > 0.0:
                raise TransformError(
                    f"this node has just started and may not have received the transform of {self.charger_base} in "
                    f"{self._base_frame} yet; send the goal again, or set base_pose"
                ) from error
            if not self._logged:
                self._logged = True
                self._log.info(f"base_pose is used for the charger's mount on its robot: {error}")
            return self._base_pose

    def _agreed(self, tf: TfTree, timeout: float | None) -> Pose:
        """Return tf's pose, checked against a given base_pose.

        Raises:
            UnknownFrame: tf does not provide it.
            Contradiction, TransformError: as in `base_pose`.
        """
        found = tf.lookup(self._base_frame, self.charger_base, None, timeout)
        if problem := far(found[:3]):
            raise Contradiction(f"{self.charger_base} in {self._base_frame} by tf: {problem}; correct the URDF")
        distance, turn = apart(found, self._base_pose)
        if self._is_given and (distance > SAME[0] or turn > SAME[1]):
            there, here = _words(self._base_pose), _words(found)
            raise Contradiction(
                f"base_pose contradicts tf: {self.charger_base} in {self._base_frame} is {there} by the parameter and "
                f"{here} by tf, {distance:.3f} m and {math.degrees(turn):.1f}° apart; remove base_pose, or correct it "
                "or the URDF"
            )
        return found

    def _remedy(self) -> str:
        names = f"use {self.charger_base}, {self._base_frame}, or '' to use the camera"
        return names if self._tf is not None else f"{names}; other frames need tf2_ros, which is not installed"


def _words(pose: Pose) -> str:
    return f"({' '.join(f'{number:.4g}' for number in pose)})"
