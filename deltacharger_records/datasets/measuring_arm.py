# SPDX-License-Identifier: Apache-2.0
"""The arm of a running charger for measuring its servos: goals in whole ticks, unfiltered angles and currents."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ServoState

from deltacharger_core.servos_file import STIFFNESS_MAX, STIFFNESS_MIN
from deltacharger_docking.motion import Planner
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.calibration.servo_arm import ArmReadings, whole_ticks
from deltacharger_kinematics.geometry import Vector
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_records.datasets.arm_client import ArmClient

_LATE = 0.03  # s until a goal reaches the servos: transport and one bus cycle
_SILENCE = 2.0  # s that a reading may wait beyond its end for its first message


class MeasuringArm(ArmClient):
    """An `ArmClient` that also implements `ServoArm`."""

    _goals: Vector | None = None
    _log: tuple[list[Vector], list[Vector]] = ([], [])  # angles (rad) and currents (A) since a reading began

    def parameters_of(self, name: str) -> dict[str, Any]:
        """Return a node's parameters; empty if it does not answer."""
        return self._ask(name)

    def start(self) -> None:
        """Switch the torque on as `ArmClient.start` does, and hold the position by known goals."""
        here = whole_ticks(self.angles())
        super().start()
        self._goals = here
        self._publish([Waypoint(_LATE, here, ())])  # type: ignore[arg-type]  # no bound: servo_node's own

    def clock(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""
        return self._goals or whole_ticks(self.angles())

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Move the goals along a line, see `ServoArm`.

        Raises:
            ArmError: the arm may no longer be moved.
        """
        self.check()
        self._publish([Waypoint(at, whole_ticks(goals), bound) for at, goals in line])
        self._goals = whole_ticks(line[-1][1])
        over = time.monotonic() + line[-1][0] + _LATE
        self._wait(lambda: time.monotonic() >= over, math.inf, self.check)

    def read(self, seconds: float) -> ArmReadings:
        """Return the servo_state readings of the next `seconds`, at least one message.

        Raises:
            ArmError: the arm may no longer be moved.
        """
        with self._lock:
            self._log = [], []
            angles, currents = self._log
        over = time.monotonic() + seconds
        self._wait(lambda: time.monotonic() >= over and len(currents) > 0, seconds + _SILENCE, self.check)
        self.check()
        with self._lock:
            return ArmReadings(np.array(angles).reshape(-1, 3), np.array(currents).reshape(-1, 3))

    def retire(self, stiffness: float) -> None:
        """Move to docking's rest position; `stiffness` (N·m/rad) compensates the weight; errors as in `move`."""
        known = min(max(stiffness, STIFFNESS_MIN), STIFFNESS_MAX)
        self._planner = Planner(
            dataclasses.replace(DockingParameters(), servo_stiffness=known), self._kinematics.geometry
        )
        self._commanded = self.position()
        self.go_home()

    def _on_servo_state(self, message: ServoState) -> None:
        super()._on_servo_state(message)
        if len(message.position) == len(message.current) == 3 and all(message.valid):
            with self._lock:
                angles, currents = self._log
                angles.append(tuple(message.position))
                currents.append(tuple(message.current))
