# SPDX-License-Identifier: Apache-2.0
"""Build a `Run` from a charger's messages, live or recorded."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ChargerPower, DockingDecision, DockingState, Misalignment, ServoState, TactileFrame

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_records.replay.run_record import Decided, Run, Touch
from deltacharger_ros.messages import PHASES

_MEASURED = (
    *("horizontal_m", "vertical_m", "angle_rad"),
    *("horizontal_stddev_m", "vertical_stddev_m", "angle_stddev_rad"),
    *("across_m", "across_stddev_m"),
)


class RunBuilder:
    """Fills a `Run`; the caller defines time 0 of its times (s).

    Contact force is computed from servo_state (without the arm's weight), so kinematics_node is not needed.

    Args:
        run: to fill.
        settings: docking_node's parameters and geometry; None = set later, earlier servo_state is skipped.
    """

    def __init__(self, run: Run, settings: tuple[DockingParameters, DeltaGeometry] | None) -> None:
        self.run = run
        self.settings = settings
        self._delta: ScalarDelta | None = None
        self._last_estimate: tuple[float, ...] = ()
        self._contacts = 0

    def enter(self, time: float, phase: str) -> None:
        """Take the current phase."""
        if not self.run.phases or self.run.phases[-1][1] != phase:
            self.run.phases.append((time, phase))

    def servo_state(self, time: float, message: ServoState) -> None:
        """Take position and load of the arm."""
        if len(message.position) != 3 or self.settings is None:
            return
        if self._delta is None:
            self._delta = ScalarDelta(self.settings[1])
            self.run.limits = self.settings[0].overlap_loss_max, self.settings[0].landing_limit
        position = self._delta.forward(*message.position)
        force = current = math.nan
        if math.isfinite(position[2]) and len(message.current) == 3:
            constant = self.settings[0].torque_constant
            held = self._delta.holding_torque(*position, self.settings[0].gravity)
            spare = [constant * current - hold for current, hold in zip(message.current, held, strict=True)]
            force = self._delta.force(*position, (spare[0], spare[1], spare[2]))[2]
            lever = self._delta.jacobian(*position)[6:9]  # dz/dangle of each servo
            current = force * sum(lever) / 3.0 / constant
        self.run.motion.add(time, position[2], force, current)

    def docking_state(self, time: float, message: DockingState) -> None:
        """Take the state."""
        self.enter(time, PHASES.get(message.state, f"state {message.state}"))

    def tactile_frame(self, time: float, message: TactileFrame) -> None:
        """Keep the pads' forces if they are tared and in contact."""
        if not message.tared or message.rows * message.columns != len(message.left):
            return
        shape = (message.rows, message.columns)
        left = np.array(message.left, dtype=np.float64).reshape(shape)
        right = np.array(message.right, dtype=np.float64).reshape(shape)
        if np.isnan(left).all() or np.isnan(right).all() or max(np.nanmax(left), np.nanmax(right)) < CONTACT_FORCE:
            return
        self.run.frames = (left, right)

    def misalignment(self, time: float, message: Misalignment) -> None:
        """Take a continuous estimate."""
        values = (message.horizontal, message.vertical, message.angle) if message.contact else (math.nan,) * 3
        self.run.misalignment.add(time, *values)

    def power(self, time: float, message: ChargerPower) -> None:
        """Take charge current and contactor state."""
        self.run.power.add(time, message.charge_current, float(message.contactor_closed))

    def decision(self, time: float, message: DockingDecision) -> None:
        """Take a decision; measurements and verdicts are decisions, too."""
        values = dict(zip(message.names, message.values, strict=False))
        state = PHASES.get(message.state, f"state {message.state}")
        self.run.decisions.append(Decided(time, state, message.kind, message.text, values))
        self._contacts += message.kind == "contact"
        if message.kind == "measured":
            self._touch(time, [values.get(name, math.nan) for name in _MEASURED], message.text == "sure")
        elif message.kind == "verdict" and self.run.touches:
            self.run.touches[-1].verdict = message.text
            self.run.touches[-1].clearance = values.get("clearance_m", math.nan)

    def dock_feedback(self, time: float, feedback: Any) -> None:
        """Take a Dock.Feedback; a new estimate in it is one that docking used."""
        self.run.contact.add(time, feedback.contact_current)
        new = feedback.misalignment
        values = (new.horizontal, new.vertical, new.angle)
        if math.isnan(new.angle) or values == self._last_estimate:
            return
        self._last_estimate = values
        self.run.decided.add(time, *values)
        if not self.run.decisions:  # docking_decision was not recorded
            stddevs = (new.horizontal_stddev, new.vertical_stddev, new.angle_stddev)
            self._touch(time, [*values, *stddevs, new.across, new.across_stddev], new.sure and new.in_range)

    def _touch(self, time: float, values: Sequence[float], sure: bool) -> None:
        x, y, angle, x_stddev, y_stddev, angle_stddev, across, across_stddev = values
        spreads, where = (x_stddev, y_stddev, angle_stddev), (self._contacts, self.run.frames)
        touch = Touch(time, x, y, angle, *spreads, sure, *where, across=across, across_stddev=across_stddev)
        self.run.touches.append(touch)
