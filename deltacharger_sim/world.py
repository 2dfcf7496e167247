# SPDX-License-Identifier: Apache-2.0
"""A simulated world: mechanics, contact, tactile arrays and circuit, advanced in fixed steps or by a clock."""

import dataclasses
import math
import random
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from deltacharger_core import arrays, machine, servo_types
from deltacharger_driver.servos.registers import TICK
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_sim import motion, pads
from deltacharger_sim.circuit import Circuit, Overlap
from deltacharger_sim.emulators.power import Outputs, StageReading, TargetPort
from deltacharger_sim.mechanics import Mechanics
from deltacharger_sim.parameters import STEP, WorldParameters


@dataclass
class Record:
    """True events; for tests and reports, never for docking.

    Attributes:
        energised_shorts: number of shorts of live electrodes.
        energised_unsafe: s that the electrodes were live with negative clearance.
        energised: s that the electrodes were live: with closed contactor, or without contactor on the target;
            current is not needed.
        parted_live: number of times that live electrodes left the target.
        unpowered_live: number of times that a servo lost its torque while the electrodes were live.
        broken_current: largest current interrupted by the contactor, or by the electrodes if there is none, A.
        contacts: dockings, without bounces.
        peak_force: largest normal force, including impacts within a step, N.
        peak_push: largest force on the target along z without the magnets', N: of servos and impacts.
        lifted_live: number of times that one bar of live electrodes carried nothing while the other pressed.
        bar_heat: largest heat in one bar's contact, W.
        energy: into the target at the electrodes, J.
        port_shorted: s that a bar bridged a live port, whatever the contactor did.
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
    lifted_live: int = 0
    bar_heat: float = 0.0
    energy: float = 0.0
    port_shorted: float = 0.0


@dataclass(frozen=True)
class Snapshot:
    """The truth at one instant, for tests and reports: m, rad, N, A, charger_base; `misalignment` in end_effector."""

    time: float
    position: Vector
    misalignment: pads.Pose | None
    contact_force: float
    push: float
    charge_current: float
    contactor_closed: bool
    clearance: float


_APART = 0.001  # m of gap that ends a docking; a smaller one is a bounce
_NOTHING = 1e-9  # s
TEMPERATURE = 28.0  # °C of each servo; a docking heats it by 2 K
_CURRENT_UNIT = servo_types.MX_64.current_unit  # A, step of a reading
T = TypeVar("T")


class World:
    """The simulated environment of one charger.

    Args:
        parameters: all of them; the attribute has the target's present pose.
        tactile: the pads, a `PadSource`; None = pads that read nothing.
        seed: of the current noise.
        geometry: of the delta.
        start: of the platform, m, charger_base.
        mechanics: model of the arm's motion.

    Attributes:
        dt: s of a step, unless `step` is given another.

    Raises:
        ValueError: the arm does not reach `start`.
    """

    def __init__(
        self,
        parameters: WorldParameters,
        tactile: pads.PadSource | None = None,
        seed: int = 0,
        geometry: DeltaGeometry | None = None,
        start: Vector = (0.0, 0.0, 0.0),
        mechanics: motion.MakeMotion = Mechanics,
    ) -> None:
        self.parameters = parameters
        self.geometry = geometry or DeltaGeometry()
        self.mechanics: motion.Motion = mechanics(parameters, self.geometry, start)
        self.circuit = Circuit(parameters.circuit, parameters.port, parameters.stage)
        self.record = Record()
        self.time, self.dt = 0.0, STEP
        self._tactile = tactile
        self._random = random.Random(seed)
        self._enabled = (False, False, False)
        self._reference = self.mechanics.angles
        self._limit = (0.0, 0.0, 0.0)
        self._jitter: pads.Pose = (0.0, 0.0, 0.0)
        self._docked = False
        self._overlap: Overlap | None = None
        self._overlap_pose: pads.Pose | None = None
        self._was_short = self._was_parted = self._was_unpowered = self._was_lifted = False
        self._lay_wired = False  # electrodes without a contactor were on the target
        self._moving: tuple[float, float, float, float] | None = None  # m/s, m/s, rad/s of the target, remaining s

    def command(
        self,
        index: int,
        enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """Command servo `index`: torque on, goal angle (rad), current bound (A), gains of its stiffness and damping."""
        bound = current_limit if math.isfinite(current_limit) else 0.0
        if enabled != self._enabled[index]:
            self._enabled = _with(self._enabled, index, enabled)
        if reference != self._reference[index] and math.isfinite(reference):
            self._reference = _with(self._reference, index, reference)
        if bound != self._limit[index]:
            self._limit = _with(self._limit, index, bound)
        known = self.mechanics.gains, self.mechanics.brakes
        if (gain, braking) != (known[0][index], known[1][index]) and 0.0 <= gain + braking < math.inf:
            self.mechanics.set_gains(_with(known[0], index, gain), _with(known[1], index, braking))

    def step(self, dt: float | None = None) -> None:
        """Advance by `dt` s, by default the attribute."""
        dt = self.dt if dt is None else dt
        mechanics = self.mechanics
        moved = self._moving is not None
        if moved:
            self._move(dt)
        x, y = self._offset()
        mechanics.step(dt, self._enabled, self._reference, self._limit, x, y)
        self.time += dt
        if moved or not mechanics.still:
            self._follow_contact()
        self.circuit.step(dt, self._overlap, mechanics.bars)
        self._take_record(dt)

    def move_target(self, dx: float, dy: float, roll: float, seconds: float) -> None:
        """Move the target from its present pose at constant speed for `seconds`; this replaces an active move.

        In contact, friction of the electrodes drags the platform, up to its limit and against the arm's stiffness;
        beyond, they slide. The platform cannot rotate, so a rotating target slides under it.

        Args:
            dx: m, charger_base.
            dy: along y, m.
            roll: about z through the target's centre, rad.
            seconds: duration, above 0.

        Raises:
            ParameterError: the target would leave the bounds of its parameters.
            TargetFixed: the model of the arm's motion cannot move the target.
            ValueError: a number is not finite, or the duration is not above 0.
        """
        if not (0.0 < seconds < math.inf and all(map(math.isfinite, (dx, dy, roll)))):
            raise ValueError(f"move ({dx!r}, {dy!r}) m, {roll!r} rad in {seconds!r} s: give finite numbers, time > 0")
        self.mechanics.carry(0.0, 0.0)
        target = self.parameters.target
        dataclasses.replace(target, x=target.x + dx, y=target.y + dy, roll=target.roll + roll)  # checks its bounds
        self._moving = dx / seconds, dy / seconds, roll / seconds, seconds

    @property
    def target_moves(self) -> bool:
        """Whether the target is moving."""
        return self._moving is not None

    def _move(self, dt: float) -> None:
        """Move the target by a step."""
        assert self._moving is not None
        vx, vy, turn, left = self._moving
        now = dt if dt < left else left
        # The remaining time is not an exact sum of steps: a remainder below 1 ns must not cost a step.
        self._moving = (vx, vy, turn, left - now) if left - now > _NOTHING else None
        target, dx, dy = self.parameters.target, vx * now, vy * now
        moved = dataclasses.replace(target, x=target.x + dx, y=target.y + dy, roll=target.roll + turn * now)
        self.parameters = dataclasses.replace(self.parameters, target=moved)
        self.mechanics.carry(dx, dy)

    @property
    def misalignment(self) -> pads.Pose | None:
        """Pose of the target in end_effector (x m, y m, angle rad) while in contact, else None."""
        return self._relative() if self._docked and self.mechanics.contact_force > 0.0 else None

    def push(self) -> float:
        """Return the force of the servos on the target along z (N)."""
        return self.mechanics.contact_force - self.mechanics.magnet_force if self._docked else 0.0

    def snapshot(self) -> Snapshot:
        """Return the true state now."""
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
        """Return angle (rad), rate (rad/s), current (A), voltage (V) and temperature (°C) of a servo.

        Angle and current have the resolution of its registers.
        """
        mechanics, servo = self.mechanics, self.parameters.servo
        current = mechanics.torques[index] / servo.torque_constant
        angle = mechanics.angles[index] + mechanics.slack[index]
        noise = servo.current_noise + servo.current_noise_share * abs(current)
        if not self._enabled[index]:
            current = 0.0
        elif noise > 0.0:
            current += self._random.gauss(0.0, noise)
        angle, current = round(angle / TICK) * TICK, round(current / _CURRENT_UNIT) * _CURRENT_UNIT
        return angle, mechanics.rates[index], current, machine.NOMINAL_VOLTAGE, TEMPERATURE

    def taxels(self) -> tuple[arrays.Array, arrays.Array]:
        """Return both pads' raw readings (10, 10) N now."""
        if self._tactile is None:
            return np.zeros((10, 10)), np.zeros((10, 10))
        mechanics = self.mechanics
        return self._tactile.sample(self.time, self.misalignment, mechanics.contact_force, mechanics.lean)

    def _offset(self) -> tuple[float, float]:
        """Return the target's centre in end_effector, m along x and y."""
        target, jitter = self.parameters.target, self._jitter
        position, shift = self.mechanics.position, self.mechanics.target_shift
        return target.x + shift[0] - position[0] + jitter[0], target.y + shift[1] - position[1] + jitter[1]

    def _relative(self) -> pads.Pose:
        x, y = self._offset()
        tilt = self.mechanics.tilt
        if tilt != (0.0, 0.0):
            lever = self.parameters.platform.lever
            x, y = x - lever * tilt[1], y + lever * tilt[0]
        return x, y, self.parameters.target.roll + self._jitter[2]

    def _follow_contact(self) -> None:
        """Draw a new docking's jitter at first touch; update the overlap if the pose has changed."""
        if self.mechanics.contact_force > 0.0:
            if not self._docked:
                self._docked = True
                self.record.contacts += 1
                if self._tactile is not None:
                    self._jitter = self._tactile.begin_docking()
            pose = self._relative()
            if _differs(pose, self._overlap_pose):
                self._overlap_pose = pose
                self._overlap = Overlap(*pose)
            return
        self._overlap = self._overlap_pose = None
        if self._docked and self.mechanics.gap > _APART:
            self._docked = False
            self._jitter = (0.0, 0.0, 0.0)

    def _take_record(self, dt: float) -> None:
        record, circuit = self.record, self.circuit
        force = self.mechanics.peak_force
        if force > record.peak_force:
            record.peak_force = force
        if self._docked and force - self.mechanics.magnet_force > record.peak_push:
            record.peak_push = force - self.mechanics.magnet_force
        record.broken_current = circuit.broken_current
        lies = self._overlap
        record.energy += circuit.power * dt
        record.port_shorted += dt if circuit.port_shorted else 0.0
        if circuit.wired:
            record.parted_live += self._lay_wired and lies is None
            self._lay_wired = lies is not None
        if not (circuit.closed or self._lay_wired):
            self._was_short = self._was_parted = self._was_unpowered = self._was_lifted = False
            return
        record.energised += dt
        if lies is not None and lies.clearance < 0.0:
            record.energised_unsafe += dt
        short = lies is not None and lies.short
        record.energised_shorts += short and not self._was_short
        self._was_short = short
        parted = lies is None
        record.parted_live += parted and not self._was_parted
        self._was_parted = parted
        bars = self.mechanics.bars
        lifted = (bars.upper > 0.0) != (bars.lower > 0.0)
        record.lifted_live += lifted and not self._was_lifted
        self._was_lifted = lifted
        record.bar_heat = max(record.bar_heat, circuit.heat)
        unpowered = not all(self._enabled)
        record.unpowered_live += unpowered and not self._was_unpowered
        self._was_unpowered = unpowered


def _differs(pose: pads.Pose, known: pads.Pose | None) -> bool:
    """Return whether a pose differs from the known one by more than 1 µm or 1 µrad."""
    if known is None:
        return True
    x, y, turn = pose[0] - known[0], pose[1] - known[1], pose[2] - known[2]
    return not (-1e-6 <= x <= 1e-6 and -1e-6 <= y <= 1e-6 and -1e-6 <= turn <= 1e-6)


def _with(three: tuple[T, T, T], index: int, value: T) -> tuple[T, T, T]:
    changed = list(three)
    changed[index] = value
    return changed[0], changed[1], changed[2]


_CATCH_UP = 0.5  # s; a longer pause of the process is skipped, not computed


class SharedWorld:
    """Advances a world to `clock` at each access; computes nothing in between.

    It is the plant of the servo and board emulators, which use only these methods.

    Args:
        world: advanced in steps of its `dt`.
        clock: s, monotonic.
    """

    def __init__(self, world: World, clock: Callable[[], float] = time.monotonic) -> None:
        self.world = world
        self._clock = clock
        self._lock = threading.RLock()
        self._at = clock()

    def _advance(self) -> World:
        now = self._clock()
        step = self.world.dt
        self._at = max(self._at, now - _CATCH_UP)
        while self._at + step <= now:
            self.world.step(step)
            self._at += step
        return self.world

    def command_servo(
        self,
        index: int,
        torque_enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """Set torque, goal angle (rad), current bound (A) and gains of a servo, as shares of its parameters."""
        with self._lock:
            self._advance().command(index, torque_enabled, reference, current_limit, gain, braking)

    def read_servo(self, index: int) -> tuple[float, float, float, float, float]:
        """Return angle (rad), rate (rad/s), current (A), voltage (V) and temperature (°C) of a servo."""
        with self._lock:
            return self._advance().servo(index)

    def read_taxels(self) -> tuple[arrays.Array, arrays.Array]:
        """Return left and right (10, 10) N, raw; NaN = dead."""
        with self._lock:
            return self._advance().taxels()

    def read_power(self) -> StageReading:
        """Return what the board measures in the power stage."""
        with self._lock:
            return self._advance().circuit.read_power()

    def drive(self, outputs: Outputs) -> None:
        """Take the board's orders to the power stage."""
        with self._lock:
            self._advance().circuit.drive(outputs)

    def change_target(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Let the target's port behave by these `PortParameters`, at its present voltage unless that is among them.

        Returns:
            What they were.
        """
        with self._lock:
            circuit = self._advance().circuit
            before = circuit.port
            circuit.port = TargetPort(replace(before.parameters, **{"voltage": before.voltage, **values}))
            return {name: getattr(before.parameters, name) for name in values if name != "voltage"}

    def probe(self) -> tuple[float, float]:
        """Return the probe's measurement: Ω (inf = no current flows, NaN = a live port) and V."""
        with self._lock:
            return self._advance().circuit.probe()
