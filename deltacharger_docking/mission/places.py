# SPDX-License-Identifier: Apache-2.0
"""Places of the base: poses on the ground, the mount of the arm, and the views of a search."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from deltacharger_core.frames import rotation
from deltacharger_kinematics.geometry import Vector

SEARCH_TURN, SEARCH_STEP = 0.2, 0.15  # rad, m between two views
SEARCH_TURNS, SEARCH_STEPS = 2, 1  # turns to each side at each distance; steps back
_LEVEL = 0.5  # least horizontal part of charger_base's z axis that defines a heading


@dataclass(frozen=True)
class Place:
    """A pose on the ground: x, y (m) and yaw (rad about the vertical, from x toward y) in `frame`."""

    x: float
    y: float
    yaw: float
    frame: str = "map"

    def __str__(self) -> str:
        return f"({self.x:.2f}, {self.y:.2f}) m, yaw {self.yaw:.2f} rad of {self.frame}"

    def at(self, x: float, y: float, yaw: float = 0.0) -> Place:
        """Return the place with these coordinates (m, rad) in this one."""
        cosine, sine = math.cos(self.yaw), math.sin(self.yaw)
        return replace(
            self, x=self.x + cosine * x - sine * y, y=self.y + sine * x + cosine * y, yaw=wrapped(self.yaw + yaw)
        )

    def distance(self, other: Place) -> float:
        """Return the distance of another place in the same frame (m)."""
        return math.hypot(other.x - self.x, other.y - self.y)

    def turn(self, other: Place) -> float:
        """Return the angle (rad, ≥ 0) between both headings."""
        return abs(wrapped(other.yaw - self.yaw))


def wrapped(angle: float) -> float:
    """Return the angle (rad) in (−π, π]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


class BaseMount:
    """charger_base in the robot's base frame (REP-103: x forward, y left, z up).

    Args:
        pose: x, y, z (m), then the quaternion x, y, z, w (any length) of charger_base in the base frame.

    Attributes:
        heading: direction of charger_base's z axis on the ground, rad in the base frame.

    Raises:
        ValueError: the numbers are not a pose, or charger_base's z axis is too steep.
    """

    def __init__(self, pose: Sequence[float]) -> None:
        if len(pose) != 7 or not all(map(math.isfinite, pose)) or not any(pose[3:]):
            raise ValueError("base_pose needs 7 finite numbers: x y z, then a quaternion x y z w that is not zero")
        self._position = (pose[0], pose[1], pose[2])
        self._rotation = rotation(*pose[3:])
        forward = (self._rotation[0][2], self._rotation[1][2])
        if math.hypot(*forward) < _LEVEL:
            raise ValueError("base_pose points charger_base's z axis up or down; the target must be beside the robot")
        self.heading = math.atan2(forward[1], forward[0])

    def in_base(self, point: Vector) -> Vector:
        """Return a point of charger_base (m) in the base frame."""
        x, y, z = (
            origin + sum(factor * value for factor, value in zip(row, point, strict=True))
            for origin, row in zip(self._position, self._rotation, strict=True)
        )
        return x, y, z

    def faced(self, base: Place, yaw: float, pitch: float = 0.0) -> float:
        """Return the direction that electrodes face (rad, the frame of `base`), from the lean of their z axis.

        Args:
            base: place of the robot.
            yaw: rotation of their z axis about +y of charger_base, rad.
            pitch: its rotation about +x, rad, less than a quarter turn.
        """
        away = (math.sin(yaw), -math.cos(yaw) * math.tan(pitch), math.cos(yaw))  # along their z axis, not normalized
        x, y = (sum(factor * value for factor, value in zip(row, away, strict=True)) for row in self._rotation[:2])
        return wrapped(base.yaw + math.atan2(y, x) + math.pi)

    def seen_from(self, base: Place, point: Vector, facing: float) -> Place:
        """Return electrodes at `point` (m, charger_base) of a robot at `base`; they face `facing` (rad, its frame)."""
        x, y, _ = self.in_base(point)
        return replace(base.at(x, y), yaw=facing)

    def before(self, electrodes: Place, distance: float) -> Place:
        """Return the base's place from which the electrodes face charger_base at `distance` (m along its z)."""
        yaw = wrapped(electrodes.yaw + math.pi - self.heading)
        x, y, _ = self.in_base((0.0, 0.0, distance))
        return replace(electrodes, yaw=yaw).at(-x, -y)


def views(electrodes: Place, distance: float, mount: BaseMount) -> Iterator[Place]:
    """Yield the places from which to look for electrodes expected at `electrodes`.

    The first faces them from `distance` (m). Then follow wider and wider turns to each side, then the same from farther
    back, in steps. None is nearer than the first.
    """
    for step in range(SEARCH_STEPS + 1):
        place = mount.before(electrodes, distance + step * SEARCH_STEP)
        yield place
        for turn in range(1, SEARCH_TURNS + 1):
            yield place.at(0.0, 0.0, turn * SEARCH_TURN)
            yield place.at(0.0, 0.0, -turn * SEARCH_TURN)
