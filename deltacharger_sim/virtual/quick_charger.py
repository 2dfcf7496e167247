# SPDX-License-Identifier: Apache-2.0
"""A charger in virtual time that computes only values that are read.

Six of its dockings take the time of one of `VirtualCharger`, its base class.

Differences from `VirtualCharger`, which follows the nodes at their rates:
- The world takes steps of 10 ms instead of 5, twice that while the arm settles, and again while the electrodes rest on
  the target. A standing world takes one step between two steps of the machine.
- The machine is stepped every 10 ms only if its script acts on every observation. Otherwise steps are up to 80 ms
  apart, and 130 ms while the arm stands still.
- Lines are sent in one piece. Tactile frames are made when they are read.

Every servo reading that a decision depends on is made and fed to the machine, as in the real charger. docs/campaigns.md
has the measured differences.
"""

import functools
import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_docking import arm, observation
from deltacharger_docking.contact import CONTACT_WINDOW
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_kinematics import scalar, trajectory_feed
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.line import ARM_ACCELERATION, ARM_SPEED, PEAK_SPEED, REFUSED, way_done
from deltacharger_sim.pads import PadSource
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.virtual.virtual_charger import PROFILE, TICK, Pending, VirtualCharger
from deltacharger_sim.world import SharedWorld, World

_MARGIN = 0.02  # share of the reach that both ends must keep from its edge
_INTERVAL = 0.02  # s between two points, as in the usual lines
_FEWEST = 24  # intervals for which differences give the arms' accelerations to 1 %, and so the time to 0.5 %
_LOOKS = (0.0, 0.25, 0.5, 0.75, 1.0)  # shares of a leg
_REFUSED, _EDGE = int(REFUSED), 0.02  # m around the workspace box


class QuickPlanner(arm.Planner):
    """Plans lines well inside the reach point by point in plain floats; `Planner` plans all others.

    Such a line has the usual time law; the arms' limits are checked only at its points. Its lead under the arm's
    weight is exact at both ends and in the middle, and a parabola between them. Waypoints carry no velocities,
    because nothing reads them.
    """

    def __init__(self, parameters: DockingParameters, geometry: DeltaGeometry) -> None:
        super().__init__(parameters, geometry)
        self._scalar = scalar.ScalarDelta(geometry)
        (x0, y0, z0), (x1, y1, z1) = geometry.workspace_min, geometry.workspace_max
        self._low = (x0 - _EDGE, y0 - _EDGE, z0 - _EDGE)
        self._high = (x1 + _EDGE, y1 + _EDGE, z1 + _EDGE)

    def line(self, start: Vector, goal: Vector, speed: float) -> tuple[trajectory_feed.Waypoint, ...]:
        """Return the waypoints from `start` to `goal`, as `Planner.line`."""
        quick = self._quick(start, goal, speed)
        return super().line(start, goal, speed) if quick is None else quick

    def check_way(self, speed: float, *places: Vector) -> None:
        """Refuse a path as `Planner.check_way` does; a path well inside the reach is checked at a few points only."""
        for start, goal in pairwise(places):
            if not all(self._is_good(trajectory_feed.between(start, goal, share)) for share in _LOOKS):
                super().check_way(speed, start, goal)

    def _is_good(self, point: Vector) -> bool:
        solved = self._scalar.solve(*point) if self._is_inside(point) else None
        return solved is not None and not solved[1] & _REFUSED and solved[2] >= _MARGIN

    def _is_inside(self, point: Vector) -> bool:
        return all(low <= value <= high for low, value, high in zip(self._low, point, self._high, strict=True))

    def _quick(self, start: Vector, goal: Vector, speed: float) -> tuple[trajectory_feed.Waypoint, ...] | None:
        """Return the line; None if a point of it needs the full check."""
        duration = max(PEAK_SPEED * math.dist(start, goal) / speed, 2.0 * _INTERVAL)
        count = max(math.ceil(duration / _INTERVAL), _FEWEST)
        ways = _ways(count)
        angles = []
        for way in ways:
            point = trajectory_feed.between(start, goal, way)
            solved = self._scalar.solve(*point) if self._is_inside(point) else None
            if solved is None or solved[1] & _REFUSED or solved[2] < _MARGIN:
                return None
            angles.append(solved[0])
        duration = max(duration, self._fastest(angles))
        return tuple(self._waypoints(start, goal, ways, angles, duration))

    def _fastest(self, angles: list[Vector]) -> float:
        """Return the shortest time (s) in which the arms can pass these angles (rad), equally spaced in time."""
        turn = bend = 0.0
        for before, here, after in zip(angles, angles[1:], angles[2:]):  # noqa: B905 their lengths differ
            for a, b, c in zip(before, here, after, strict=True):
                turn, bend = max(turn, abs(c - a)), max(bend, abs(c - b - b + a))
        count = len(angles) - 1
        return max(0.5 * count * turn / ARM_SPEED, count * math.sqrt(bend / ARM_ACCELERATION))

    def _waypoints(
        self,
        start: Vector,
        goal: Vector,
        ways: tuple[float, ...],
        angles: list[Vector],
        duration: float,
    ) -> Iterator[trajectory_feed.Waypoint]:
        parameters, geometry = self.parameters, self._scalar.geometry
        held = [
            self._scalar.holding_torque(*point, parameters.gravity)
            for point in (start, trajectory_feed.between(start, goal, 0.5), goal)
        ]
        softness, low, high = 1.0 / self.springs.stiffness, geometry.joint_min, geometry.joint_max
        for index in range(1, len(ways)):
            way, (a, b, c) = ways[index], angles[index]
            first, middle, last = (1.0 - way) * (1.0 - 2.0 * way), 4.0 * way * (1.0 - way), way * (2.0 * way - 1.0)
            d, e, f = (first * p + middle * q + last * r for p, q, r in zip(*held, strict=True))
            led = (
                min(max(a + d * softness, low), high),
                min(max(b + e * softness, low), high),
                min(max(c + f * softness, low), high),
            )
            yield trajectory_feed.Waypoint(index / (len(ways) - 1) * duration, led, self.bound((d, e, f)))


class OnePieceFeed(trajectory_feed.TrajectoryFeed):
    """Sends each line at once and complete: a sender in virtual time never falls silent."""

    def piece(self, time: float, held: bool = False) -> trajectory_feed.Piece | None:
        """Return the line if it has not been sent yet."""
        if not self._line or math.isfinite(self._sent):
            return None
        self._sent = time
        return self._line

    def _ran_out(self, time: float) -> bool:
        return False


@functools.lru_cache(maxsize=64)
def _ways(count: int) -> tuple[float, ...]:
    """Return the share of the path covered at the ends of `count` equal shares of a line's time."""
    return tuple(way_done(index / count) for index in range(count + 1))


MOVING, CHARGING, STANDING = 8, 5, 13  # ticks that one step of the machine may last; each POWER is seen
SETTLING = 2  # ticks that one step of the world may last while the platform only follows its goal
_MORE = 0.005  # s before the machine's contact window at which servo readings begin: half a tick
_NEAR = 0.005  # m of gap, below which the magnets may snap before the machine is stepped again
_STILL = 1e-4  # m/s; a motion at this speed changes the contact current by less than its noise
_SAME_PLACE, _SAME_TURN = 5e-4, 4e-3  # m and rad within which the pads read the same, except for the force
_SAME_FORCE = 0.2  # relative
_SAME_LEAN = 2e-4  # rad of remaining yaw; moves 1.5 N from one pad to the other
_SURELY = 0.4  # N; farther from the threshold, noise cannot decide: four standard deviations


class _Unclocked(SharedWorld):
    """A plant that advances only when its owner steps the world."""

    def _advance(self) -> World:
        return self.world


class QuickCharger(VirtualCharger):
    """One docking of a campaign; equal seeds give the same docking to the last bit.

    Args:
        world: the simulated world; its `step` is not used.
        parameters: of docking.
        pads: of `rig_seed` and `seed`.
        seed: of noise and jitter.
        rig_seed: seed of the device with the pads.
        geometry: the arm's dimensions that docking assumes; None = the true ones.
        proportional: whether the readings of pads on level faces grow with the force alone, so that an earlier
            reading predicts one under a little more force.
        profile: of the target.
    """

    def __init__(
        self,
        world: WorldParameters,
        parameters: DockingParameters,
        pads: PadSource,
        seed: int,
        rig_seed: int,
        geometry: DeltaGeometry | None = None,
        proportional: bool = True,
        profile: TargetProfile = PROFILE,
    ) -> None:
        self._pads = pads
        self._proportional = proportional
        super().__init__(world, parameters, seed, rig_seed, pads, geometry, profile)
        self._arrived: tuple[trajectory_feed.Waypoint, ...] = ()  # the line whose end has been commanded
        self._current = math.nan  # A, into the target at the last observation
        self._felt: arrays.Array | None = None  # N, the last tared frame made in contact
        self._largest = 0.0  # N on the taxel with the largest reading
        self._read_at: tuple[float, ...] | None = None  # pose (m, m, rad), force (N), number of the contact, yaw (rad)

    def _make_plant(self) -> SharedWorld:
        return _Unclocked(self.world, clock=lambda: 0.0)

    def _make_machine(self) -> DockingMachine:
        parameters, geometry = self.parameters, self.geometry
        feed = OnePieceFeed(machine.SERVO_DAMPING / parameters.servo_stiffness)
        return DockingMachine(parameters, geometry, QuickPlanner(parameters, geometry), feed, self.profiles)

    def tick(self) -> None:
        """Advance until the next decision: 10 to 130 ms."""
        standing = self._stands()
        most = STANDING if standing else CHARGING if self._is_live else MOVING
        self._pass(self._stride(most), standing)
        if not self._is_live:
            self._watch_power()
        self._serve()
        self._step()

    def _stride(self, most: int) -> int:
        """Return how many ticks may pass until the machine or a service must act."""
        until = self._quiet_until()
        for pending in self._pending:
            until = min(until, pending.due)
        left = (until - self.now) / TICK
        return 1 if left <= 1.0 else math.ceil(min(left, most) - 1e-6)

    def _quiet_until(self) -> float:
        """Return the time (s) until which the script only waits: in free air, before anything can be touched."""
        waits = self._waits
        if not waits.nearing:
            return waits.until
        mechanics = self.world.mechanics
        return min(waits.until, self.now + (mechanics.gap - mechanics.onset - _NEAR) / waits.nearing)

    @property
    def _is_live(self) -> bool:
        return self._energised or self.world.circuit.closed

    def _stands(self) -> bool:
        """Return whether goal, platform, contactor and charge current are steady."""
        if self._is_live:
            return self._charges_on()
        if self._trajectory and self.now - self._started < self._trajectory[-1].time + TICK:
            return False
        return self._speed() < _STILL

    def _charges_on(self) -> bool:
        """Return whether the platform stands still and the current has not changed since the last call."""
        world = self.world
        before, self._current = self._current, world.circuit.current
        steady = world.circuit.port.steady and self._current == before and self._current > 0.0
        return steady and world.mechanics.still and not world.target_moves

    def _world_ticks(self) -> int:
        """Return how many ticks one step of the world may last."""
        if self._is_live:
            return 1
        settles = bool(self._trajectory) and self._arrived is self._trajectory
        # On the target the magnets hold the platform sideways; before, its final position depends on the step.
        held = 2 if self.world.mechanics.contact_force > 0.0 else 1
        return held * (SETTLING if settles else 1)

    def _speed(self) -> float:
        """Return the platform's speed along its fastest axis (m/s)."""
        x, y, z = self.world.mechanics.velocity
        speed: float = max(abs(x), abs(y), abs(z))
        return speed

    def _servos(self) -> None:
        line, elapsed = self._trajectory, self.now - self._started
        if line and self._arrived is line:
            return
        if line:
            self._bound, self._goal = self._along(line, elapsed)
        for index in range(3):
            self.world.command(index, self._torque, self._goal[index], self._bound[index])
        if line and self._torque and elapsed >= line[-1].time:
            self._arrived = line

    def _pass(self, ticks: int, standing: bool) -> None:
        """Let `ticks` of 10 ms pass, feeding the machine the readings that its next decision needs."""
        world, start, waits = self.world, self.now, self._waits
        # While live, the contact current is checked after each of these steps.
        decides = start + ticks * TICK if self._energised else self._quiet_until() if waits.reads else math.inf
        from_then_on = decides - (CONTACT_WINDOW + _MORE)
        if standing:
            world.step(ticks * TICK)
            self.now = start + ticks * TICK
            self._watch_power()
        most = self._world_ticks()
        stepped = 0
        for index in range(1, ticks + 1):
            self.now = start + index * TICK
            if not standing and (index - stepped == most or index == ticks):
                world.step((index - stepped) * TICK)
                self._servos()
                self._watch_joints()
                stepped = index
                if self._is_live:
                    self._watch_power()
            if index < ticks and self.now >= from_then_on:
                self._earlier.append((self.now, *self._reading()))

    def _reading(self) -> tuple[Vector, Vector]:
        servo = self.world.servo
        (a, _, i, _, _), (b, _, j, _, _), (c, _, k, _, _) = servo(0), servo(1), servo(2)
        return (a, b, c), (i, j, k)

    def _feels(self) -> bool:
        """Return whether some taxel reads 1 N; a hardly changed contact is not computed again."""
        pose, force = self.world.misalignment, self.world.mechanics.contact_force
        if (self.excess is None and pose is None) or not self._tared:
            self._read_at = self._felt = None
            return False
        if self.excess is not None or not self._proportional:
            self._felt = self.feel(1, 0.0)[0] - self.baseline
            return float(np.nanmax(self._felt)) >= machine.CONTACT_FORCE
        assert pose is not None
        known = self._read_at
        if known is None or not self._is_known(known, pose, force):
            self._felt = self._pads.frames(self.world.time, pose, force, 1, 0.0, self.world.mechanics.lean)[0]
            self._felt -= self.baseline
            self._largest = float(np.nanmax(self._felt))
            self._read_at = known = (*pose, force, float(self.world.record.contacts), self._yaw())
        return self._largest * force >= machine.CONTACT_FORCE * known[3]

    def _taxels(self) -> arrays.Array | None:
        """Return the last frame made in contact, at the present force."""
        if self._felt is None or self._read_at is None or not self._read_at[3] > 0.0:
            return self._felt
        return (self._felt * (self.world.mechanics.contact_force / self._read_at[3])).clip(min=0.0)

    def _is_known(self, known: tuple[float, ...], pose: tuple[float, float, float], force: float) -> bool:
        """Return whether the last reading still holds: same contact and place, same force or far from threshold.

        On leaning faces the distance to the threshold does not count: the pads share a larger force differently.
        """
        x, y, angle, pressed, contact, yaw = known
        if contact != self.world.record.contacts or abs(pose[2] - angle) > _SAME_TURN:
            return False
        if abs(self._yaw() - yaw) > _SAME_LEAN:
            return False
        if abs(pose[0] - x) > _SAME_PLACE or abs(pose[1] - y) > _SAME_PLACE:
            return False
        far = (
            self.world.mechanics.lean is None and abs(self._largest * force / pressed - machine.CONTACT_FORCE) > _SURELY
        )
        return far or abs(force - pressed) < _SAME_FORCE * pressed

    def _yaw(self) -> float:
        """Return the remaining yaw between platform and target, rad."""
        lean = self.world.mechanics.lean
        return 0.0 if lean is None else lean.residual[1]

    def feel(self, count: int, period: float) -> NDArray[Any]:
        """Return `count` frames (count, 2, 10, 10) N, a `period` (s) apart, that end now; not tared, NaN where dead."""
        world = self.world
        pressed, lean = world.mechanics.contact_force, world.mechanics.lean
        return self._pads.frames(world.time, world.misalignment, pressed, count, period, lean)

    def _reply(self, pending: Pending) -> observation.Reply:
        if pending.request.service in (observation.Service.TARE, observation.Service.ESTIMATE):
            raw = self.feel(max(1, round((pending.due - pending.asked) / TICK)), TICK)
            untared = pending.request.service is observation.Service.TARE
            pending.frames = list(raw if untared else (raw - self.baseline).clip(min=0.0))
        return super()._reply(pending)
