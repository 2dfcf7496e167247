# SPDX-License-Identifier: Apache-2.0
"""Pose of charger_base in other frames: from tf if tf2_ros is installed, otherwise from the node's parameters.

The mount of the charger on its robot has one source: tf's transform of charger_base in base_frame if there is one,
otherwise the parameter base_pose. A given base_pose that differs from tf is an error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time as Stamp
from rclpy.node import Node

from deltacharger_core.frames import CHARGER_BASE, LONGEST, TransformParameters
from deltacharger_core.rotation import IDENTITY, Pose, apart, composed
from deltacharger_core.units import far
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.log import Log
from deltacharger_ros.parameters import was_given
from deltacharger_ros.tf_tree import TfTree, TransformError, UnknownFrame, installed, quoted

SAME = (0.002, math.radians(0.5))  # m and rad, tolerance for one mount: rounding in a URDF, measuring by ruler
_LOOK, _LOOKS = 1.0, 30  # s between comparisons of tf with base_pose after the start, and their maximum number


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
        self._log = Log(node)
        self._base_frame = base_frame
        x, y, z, *turn = base_pose
        self._base_pose: Pose = x, y, z, turn[0], turn[1], turn[2], turn[3]
        self._is_given = was_given(node, "base_pose")
        self._tf = TfTree(node, given) if installed() else None
        self._logged = False  # that base_pose is used although tf is available
        if self._tf is not None and self._is_given:
            self._looks = 0
            self._timer = steady_timer(node, _LOOK, self._compare)

    def close(self) -> None:
        """Wake all threads that wait for a transform."""
        if self._tf is not None:
            self._tf.close()

    @property
    def follows_tf(self) -> bool:
        """Whether tf2_ros is installed."""
        return self._tf is not None

    def needs_tf(self, frame: str) -> bool:
        """Whether `charger_base_in` looks this frame up in tf."""
        return self.follows_tf and frame not in ("", self.charger_base) and len(frame) <= LONGEST

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

    def pose_in(self, parent: str, child: str, stamp: Stamp | None = None, timeout: float | None = None) -> Pose:
        """Return the pose of the frame `child` in the frame `parent` from tf; see `TfTree.lookup`."""
        if self._tf is None:
            raise UnknownFrame(f"{quoted(child)} in {quoted(parent)}: tf2_ros is not installed")
        return self._tf.lookup(parent, child, stamp, timeout)

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

    def _compare(self) -> None:
        """Report a contradiction between parameter and tf at the start, before any goal."""
        assert self._tf is not None
        self._looks += 1
        try:
            self._agreed(self._tf, 0.0)
        except Contradiction as error:
            self._log.error(f"{error}. Until this is corrected, goals in frames of the robot are refused")
        except TransformError:
            if self._looks < _LOOKS:
                return
        self._timer.cancel()

    def _remedy(self) -> str:
        names = f"use {self.charger_base}, {self._base_frame}, or '' to use the camera"
        return names if self._tf is not None else f"{names}; other frames need tf2_ros, which is not installed"


def _words(pose: Pose) -> str:
    return f"({' '.join(f'{number:.4g}' for number in pose)})"
