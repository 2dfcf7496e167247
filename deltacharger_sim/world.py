"""One world: mechanics, contact, tactile arrays and circuit, advanced in fixed steps of simulated time."""

from __future__ import annotations

import dataclasses
import math
import random
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim.circuit import Circuit
from deltacharger_sim.clearance import Overlap, overlap
from deltacharger_sim.mechanics import Mechanics
from deltacharger_sim.parameters import WorldParameters

_APART = 0.001  # m of gap that ends a docking; less is a bounce
Pose = tuple[float, float, float]
Array = NDArray[np.float64]


class TactileSource(Protocol):
    """What the world asks of the tactile arrays' model."""

    def begin_docking(self) -> Pose:
        """Draw a new docking and return its displacement (x m, y m, angle rad)."""

    def sample(self, time: float, pose: Pose | None, force: float) -> tuple[Array, Array]:
        """Return left and right (10, 10) N, raw, for the target's pose in end_effector (None = no contact)."""


@dataclass
class Record:
    """What really happened; for tests and reports, never for docking.

    Attributes:
        energised_shorts: times that live electrodes were shorted.
        energised_unsafe: s that the electrodes were live with negative clearance.
        energised: s that the electrodes were live: the contactor was closed, whether or not current flowed.
        parted_live: times that live electrodes left the target.
        unpowered_live: times that a servo lost its torque while the electrodes were live.
        broken_current: largest current that the contactor had to interrupt, A.
        contacts: dockings, bounces not counted.
        peak_force: largest normal force, N.
        peak_push: largest force of the servos along z, N.
    """

    energised_shorts: int = 0
    energised_unsafe: float = 0.0
    energised: float = 0.0
    parted_live: int = 0
    unpowered_live: int = 0
    broken_current: float = 0.0
    contacts: int = 0
    peak_force: float = 0.0
    peak_push: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the values by name."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Snapshot:
    """The truth at one instant, for tests and reports: m, rad, N, A, charger_base; `misalignment` in end_effector."""

    time: float
    position: Vector
    misalignment: Pose | None
    contact_force: float
    push: float
    charge_current: float
    contactor_closed: bool
    clearance: float


class World:
    """The simulated surroundings of one charger.

    Args:
        parameters: everything about it.
        tactile: model of the arrays; None = pads that read nothing.
        seed: of the current noise.
        geometry: of the delta.
        start: where the platform begins, m, charger_base.
    """

    def __init__(
        self,
        parameters: WorldParameters,
        tactile: TactileSource | None = None,
        seed: int = 0,
        geometry: DeltaGeometry | None = None,
        start: Vector = (0.0, 0.0, 0.0),
    ) -> None:
        self.parameters = parameters
        self.geometry = geometry or DeltaGeometry()
        self.mechanics = Mechanics(parameters, self.geometry, start)
        self.circuit = Circuit(parameters.circuit)
        self.record = Record()
        self.time = 0.0
        self._tactile = tactile
        self._random = random.Random(seed)
        self._enabled = [False, False, False]
        self._reference = list(self.mechanics.angles)
        self._limit = [0.0, 0.0, 0.0]
        self._jitter: Pose = (0.0, 0.0, 0.0)
        self._docked = False
        self._overlap: Overlap | None = None
        self._overlap_pose: Pose | None = None
        self._was_short = self._was_parted = self._was_unpowered = False
        self._temperature = [parameters.servo.ambient_temperature] * 3

    def command(self, index: int, enabled: bool, reference: float, current_limit: float) -> None:
        """Set what servo `index` does: torque on, goal angle (rad), current bound (A)."""
        self._enabled[index] = enabled
        if math.isfinite(reference):
            self._reference[index] = reference
        self._limit[index] = current_limit if math.isfinite(current_limit) else 0.0

    def step(self, dt: float | None = None) -> None:
        """Advance by `dt` s (default: the parameter `step`)."""
        dt = self.parameters.step if dt is None else dt
        mechanics = self.mechanics
        enabled = (self._enabled[0], self._enabled[1], self._enabled[2])
        reference = (self._reference[0], self._reference[1], self._reference[2])
        limit = (self._limit[0], self._limit[1], self._limit[2])
        x, y, _ = self._relative()
        mechanics.step(dt, enabled, reference, limit, math.hypot(x, y))
        self.time += dt
        self._follow_contact()
        self.circuit.step(dt, self._overlap, mechanics.contact_force)
        self._heat(dt)
        self._take_record(dt)

    @property
    def misalignment(self) -> Pose | None:
        """Pose of the target in end_effector (x m, y m, angle rad) while in contact, else None."""
        return self._relative() if self._docked and self.mechanics.contact_force > 0.0 else None

    def push(self) -> float:
        """Return the force of the servos on the target along z (N)."""
        return self.mechanics.contact_force - self.mechanics.magnet_force if self._docked else 0.0

    def snapshot(self) -> Snapshot:
        """Return the truth now."""
        return Snapshot(
            self.time,
            self.mechanics.position,
            self.misalignment,
            self.mechanics.contact_force,
            self.push(),
            self.circuit.current,
            self.circuit.closed,
            self._overlap.clearance if self._overlap is not None else math.nan,
        )

    def servo(self, index: int) -> tuple[float, float, float, float, float]:
        """Return angle (rad), rate (rad/s), measured current (A), voltage (V) and temperature (°C) of a servo."""
        servo = self.parameters.servo
        current = self.mechanics.torques[index] / servo.torque_constant
        drawn = sum(abs(torque) for torque in self.mechanics.torques) / servo.torque_constant
        measured = current + self._random.gauss(0.0, servo.current_noise) if self._enabled[index] else 0.0
        voltage = servo.supply_voltage - servo.supply_resistance * drawn
        angle = self.mechanics.angles[index] + self.mechanics.slack[index]
        return angle, self.mechanics.rates[index], measured, voltage, self._temperature[index]

    def taxels(self) -> tuple[Array, Array]:
        """Return both pads' raw readings (10, 10) N now."""
        if self._tactile is None:
            return np.zeros((10, 10)), np.zeros((10, 10))
        return self._tactile.sample(self.time, self.misalignment, self.mechanics.contact_force)

    def _relative(self) -> Pose:
        target, position = self.parameters.target, self.mechanics.position
        dx, dy, turn = self._jitter
        return target.x - position[0] + dx, target.y - position[1] + dy, target.roll + turn

    def _follow_contact(self) -> None:
        """Draw a new docking's jitter at first touch; judge the overlap anew when the pose has changed."""
        if self.mechanics.contact_force > 0.0:
            if not self._docked:
                self._docked = True
                self.record.contacts += 1
                if self._tactile is not None:
                    self._jitter = self._tactile.begin_docking()
            pose = self._relative()
            known = self._overlap_pose
            if known is None or max(abs(a - b) for a, b in zip(pose, known, strict=True)) > 1e-6:
                self._overlap_pose = pose
                self._overlap = overlap(self.parameters.terminal, *pose)
            return
        self._overlap = self._overlap_pose = None
        if self._docked and self.mechanics.gap > _APART:
            self._docked = False
            self._jitter = (0.0, 0.0, 0.0)

    def _heat(self, dt: float) -> None:
        servo = self.parameters.servo
        for index, torque in enumerate(self.mechanics.torques):
            goal = servo.ambient_temperature + servo.heating * (torque / servo.torque_constant) ** 2
            self._temperature[index] += (goal - self._temperature[index]) * min(dt / servo.heating_time, 1.0)

    def _take_record(self, dt: float) -> None:
        record, live = self.record, self.circuit.closed
        record.broken_current = self.circuit.broken_current
        record.peak_force = max(record.peak_force, self.mechanics.contact_force)
        record.peak_push = max(record.peak_push, self.push())
        lies = self._overlap
        if live:
            record.energised += dt
            if lies is not None and lies.clearance < 0.0:
                record.energised_unsafe += dt
        short = live and lies is not None and lies.short
        record.energised_shorts += short and not self._was_short
        self._was_short = short
        parted = live and lies is None
        record.parted_live += parted and not self._was_parted
        self._was_parted = parted
        unpowered = live and not all(self._enabled)
        record.unpowered_live += unpowered and not self._was_unpowered
        self._was_unpowered = unpowered
