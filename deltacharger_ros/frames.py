# SPDX-License-Identifier: Apache-2.0
"""Where charger_base is in other frames: by tf where tf2_ros is installed, else by the node's parameters alone.

One truth for where the charger sits on its robot: what tf knows of charger_base in base_frame counts, and the
parameter base_pose where tf knows nothing of it. A base_pose that was given and says otherwise than tf is an error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time as Stamp
from rclpy.node import Node

from deltacharger_core.frames import CHARGER_BASE, LONGEST, TransformParameters
from deltacharger_core.rotation import IDENTITY, Pose, apart, composed
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.log import Log
from deltacharger_ros.parameters import was_given
from deltacharger_ros.tf_tree import TfTree, TransformError, UnknownFrame, installed, quoted

SAME = (0.002, math.radians(0.5))  # m and rad between two poses of one mount: rounding of a URDF, and a ruler's error
_LOOK, _LOOKS = 1.0, 30  # s between two looks whether tf agrees with base_pose after the start, and how many


class Contradiction(TransformError):
    """tf and the parameter base_pose say different things of where the charger is on its robot."""


class Frames:
    """Answers where charger_base is in any frame that tf knows.

    Args:
        node: that asks.
        given: its prefix, and how transforms are waited for and judged.
        base_frame: full name of the robot's frame.
        base_pose: charger_base in it, by the node's parameter of this name.

    Attributes:
        charger_base: full name of charger_base.
    """

    def __init__(self, node: Node, given: TransformParameters, base_frame: str, base_pose: Sequence[float]) -> None:
        self.charger_base = given.named(CHARGER_BASE)
        self._log = Log(node)
        self._base_frame = base_frame
        x, y, z, *turn = base_pose
        self._base_pose: Pose = x, y, z, turn[0], turn[1], turn[2], turn[3]
        self._is_given = was_given(node, "base_pose")
        self._tf = TfTree(node, given) if installed() else None
        self._told = False  # that base_pose is used although there is tf
        if self._tf is not None and self._is_given:
            self._looks = 0
            self._timer = steady_timer(node, _LOOK, self._compare)

    def close(self) -> None:
        """End the waiting of whoever waits for a transform."""
        if self._tf is not None:
            self._tf.close()

    @property
    def follows_tf(self) -> bool:
        """Whether tf2_ros is installed."""
        return self._tf is not None

    def charger_base_in(self, frame: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of charger_base in a frame.

        Args:
            frame: full name; empty = charger_base.
            stamp: when; None or zero = now.
            timeout: s that a transform is waited for; None = `transform_timeout`.

        Raises:
            UnknownFrame: nobody knows the frame.
            TransformError: see `TfTree.lookup`; Contradiction: see `base_pose`.
        """
        if frame in ("", self.charger_base):
            return IDENTITY
        base = self.base_pose(timeout)
        if frame == self._base_frame:
            return base
        if self._tf is None or len(frame) > LONGEST:
            raise UnknownFrame(f"unknown frame {quoted(frame)}: {self._remedy()}")
        try:
            if self._tf.knows(self.charger_base):
                return self._tf.lookup(frame, self.charger_base, stamp, timeout)
            return composed(self._tf.lookup(frame, self._base_frame, stamp, timeout), base)
        except UnknownFrame as error:
            raise UnknownFrame(f"unknown frame {quoted(frame)}: {error}; or {self._remedy()}") from error

    def pose_in(self, parent: str, child: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of the frame `child` in the frame `parent`, by tf alone; see `TfTree.lookup`."""
        if self._tf is None:
            raise UnknownFrame(f"{quoted(child)} in {quoted(parent)}: tf2_ros is not installed")
        return self._tf.lookup(parent, child, stamp, timeout)

    def base_pose(self, timeout: float | None = None) -> Pose:
        """Return charger_base in base_frame.

        Raises:
            Contradiction: tf says otherwise than the parameter that was given.
            TransformError: by tf the charger moves on its robot, and where it is now is not known; or base_pose was not
                given, and tf, which may tell it, may not have been heard yet.
        """
        tf = self._tf
        if tf is None:
            return self._base_pose
        try:
            return self._agreed(tf, 0.0 if self._is_given or timeout == 0.0 else tf.settling)
        except UnknownFrame as error:
            if not self._is_given and tf.settling > 0.0:
                raise TransformError(
                    f"this node has just started, and may not have heard yet where {self.charger_base} is in "
                    f"{self._base_frame} by tf; send the goal again, or set base_pose"
                ) from error
            if not self._told:
                self._told = True
                self._log.info(f"base_pose tells where the charger is on its robot: {error}")
            return self._base_pose

    def _agreed(self, tf: TfTree, timeout: float | None) -> Pose:
        """Return what tf says, UnknownFrame where it says nothing; errors as of `base_pose`."""
        found = tf.lookup(self._base_frame, self.charger_base, None, timeout)
        distance, turn = apart(found, self._base_pose)
        if self._is_given and (distance > SAME[0] or turn > SAME[1]):
            there, here = _words(self._base_pose), _words(found)
            raise Contradiction(
                f"base_pose contradicts tf: {self.charger_base} lies in {self._base_frame} at {there} by the parameter "
                f"and at {here} by tf, {distance:.3f} m and {math.degrees(turn):.1f}° apart; leave base_pose out, or "
                "correct it or the URDF"
            )
        return found

    def _compare(self) -> None:
        """Say at the start, before any goal, that parameter and tf contradict each other."""
        assert self._tf is not None
        self._looks += 1
        try:
            self._agreed(self._tf, 0.0)
        except Contradiction as error:
            self._log.error(f"{error}. Goals in frames of the robot are refused until then")
        except TransformError:
            if self._looks < _LOOKS:
                return
        self._timer.cancel()

    def _remedy(self) -> str:
        names = f"give {self.charger_base}, {self._base_frame}, or '' to use the camera"
        return names if self._tf is not None else f"{names}; other frames need tf2_ros, which is not installed"


def _words(pose: Pose) -> str:
    return f"({' '.join(f'{number:.4g}' for number in pose)})"
