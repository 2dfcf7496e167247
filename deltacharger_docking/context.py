"""What the scripts of docking share: the latest observation, this tick's commands, and the ways to wait."""

from __future__ import annotations

import itertools
import math
from collections.abc import Generator
from dataclasses import replace
from typing import TypeVar

from deltacharger_docking.codes import DockingError, PhaseTimeout, ServoFailure, State, Stuck
from deltacharger_docking.contact_current import ContactCurrent
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import Command, Decision, Observation, Reply, Request, Service, Status
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.trajectory_feed import Piece, TrajectoryFeed, pull
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.statics import TORQUE_CONSTANT

T = TypeVar("T")
# A script is a generator that yields once per tick and finds the world renewed in its context when it goes on, so that
# Algorithm 1 reads from top to bottom as in the paper and still never blocks.
Script = Generator[None, None, T]

_RELEASED = 0.001  # m of retreat that tells the magnets have let go, where the pads feel nothing any more
_REACHES_OUT = (State.APPROACH, State.BACK_OFF, State.CONTACT, State.MEASURE, State.ALIGN)
_SETTING_BACK = 0.05  # s for the goal to get behind the platform before the pull
_SPRING_TRAVEL = 0.004  # m of retreat that electrodes on springs cannot follow, whatever the pads say


class Context:
    """State shared by the scripts; the machine fills `observation` before and reads the commands after each tick."""

    def __init__(
        self,
        parameters: DockingParameters,
        geometry: DeltaGeometry,
        planner: Planner | None = None,
        feed: TrajectoryFeed | None = None,
    ) -> None:
        self.parameters = parameters
        self.kinematics = ScalarDelta(geometry)
        self.contact = ContactCurrent(self.kinematics, parameters)
        self.planner = planner or Planner(parameters, geometry)
        self.feed = feed or TrajectoryFeed(parameters.servo_damping / parameters.servo_stiffness)
        self.status = Status()
        self.observation = Observation(time=0.0)
        self.energise = False
        self.live = False  # the contactor was told to close and has not been seen open since
        self.energy = 0.0
        self.commanded: Vector = (math.nan, math.nan, math.nan)
        self.deadline = math.inf
        self.idle_until = -math.inf
        self.reads = False  # the readings up to then count
        self._retreats = False  # the line under way leads away from the target
        self._numbers = itertools.count(1)
        self._told: Piece | None = None  # in place of the line under way
        self._requests: list[Request] = []
        self._replies: dict[int, Reply] = {}
        self._decisions: list[Decision] = []

    @property
    def time(self) -> float:
        """Now (s, the clock of the observations)."""
        return self.observation.time

    @property
    def position(self) -> Vector:
        """Measured platform position (m, charger_base)."""
        return self.contact.position

    def observe(self, observation: Observation) -> None:
        """Take the observation of this tick."""
        previous, self.observation = self.observation, observation
        self.idle_until, self.reads = -math.inf, False
        if observation.servos_valid:
            self.contact.update(observation.time, observation.angles, observation.currents)
        self._replies.update((reply.number, reply) for reply in observation.replies)
        power = observation.charge_current * observation.target_voltage
        if observation.contactor_closed and math.isfinite(power):
            self.energy += power * min(max(observation.time - previous.time, 0.0), 0.2)
        self.status.position = self.position
        self.status.contact_current = self.contact.value

    def command(self) -> Command:
        """Return and forget what the scripts asked for in this tick."""
        trajectory = self.feed.piece(self.time, held=self.is_blind)
        if self._told is not None:
            trajectory = self._told
        if trajectory and not self.observation.torque_enabled:
            trajectory = None  # limp servos refuse it
        command = Command(trajectory, tuple(self._requests), self.energise, tuple(self._decisions))
        self._told = None
        self._requests, self._decisions = [], []
        return command

    @property
    def is_blind(self) -> bool:
        """Whether what the arm does, or on its way to the target what it touches, is too old for it to move on."""
        oldest, observation = self.parameters.press_age_max, self.observation
        reaches_out = self.status.state in _REACHES_OUT and not self._retreats
        return observation.servo_age > oldest or (reaches_out and observation.tactile_age > oldest)

    def enter(self, state: State, limit: float) -> None:
        """Begin a phase that may last `limit` seconds."""
        self.status.state = state
        self.deadline = self.time + limit

    def expired(self) -> DockingError | None:
        """Return the error of a phase that lasted too long, if it did."""
        if self.time <= self.deadline:
            return None
        return PhaseTimeout(f"{self.status.state.name} took longer than allowed; see the parameter for this phase")

    def wait(self, seconds: float, reads: bool = False) -> Script[None]:
        """Let `seconds` pass; `reads` where the contact current is judged by the readings of this time."""
        end = self.time + seconds
        while self.time < end:
            self.idle_until, self.reads = end, reads
            yield

    def ask(self, service: Service, error: type[DockingError], timeout: float, frames: int = 0) -> Script[Reply]:
        """Call a service and return its reply, successful or not.

        Raises:
            DockingError: of the given class, where no reply comes within `timeout` seconds.
        """
        request = Request(next(self._numbers), service, frames, timeout)
        self._requests.append(request)
        end = self.time + timeout
        while request.number not in self._replies:
            if self.time > end:
                raise error(f"no answer from {service.value} within {timeout:.1f} s; is its node running?")
            self.idle_until = end
            yield
        return self._replies.pop(request.number)

    def tell(self, service: Service) -> None:
        """Call a service without waiting for its reply."""
        self._requests.append(Request(next(self._numbers), service))

    def decide(self, kind: str, text: str, **values: float) -> None:
        """Tell whoever reads this docking later what was decided, by which numbers; their names end in the unit."""
        self._decisions.append(Decision(self.time, self.status.state, kind, text, tuple(values.items())))

    def hold(self) -> None:
        """Stop where the arm is."""
        self._told = self.feed.hold(self.time)
        self.feed.stop()
        self.commanded = self.position

    def interrupt(self) -> None:
        """Stop the line under way, if there is one."""
        if self.feed.is_under_way(self.time):
            self.hold()

    def move(self, goal: Vector, speed: float, settle: bool = True) -> Script[None]:
        """Move on a straight line from the last commanded to the `goal` position and come to rest.

        The line stands still while `is_blind`.

        Raises:
            Unreachable: the line leaves the arm's reach; nothing was moved.
            ServoFailure: it is not known where the arm is; nothing was moved.
        """
        start = self.commanded if math.isfinite(self.commanded[0]) else self._measured()
        waypoints = self.planner.line(start, goal, speed)
        self.feed.start(waypoints, self.time)
        self._retreats = goal[2] < start[2]
        self.commanded = goal
        while self.feed.is_under_way(self.time):
            self.idle_until = self.feed.end
            yield
        if settle:
            yield from self.rest()

    def check_way(self, *places: Vector) -> None:
        """Refuse a way from the measured position through `places` before its first leg moves anything.

        Raises:
            Unreachable: some leg leaves the arm's reach.
            ServoFailure: it is not known where the arm is.
        """
        self.planner.check_way(self.parameters.travel_speed, self._measured(), *places)

    def _measured(self) -> Vector:
        if not all(map(math.isfinite, self.position)):
            raise ServoFailure("the arm's position is unknown, so it was not moved; check the servo bus and servo_node")
        return self.position

    def rest(self) -> Script[None]:
        """Wait until the servos have settled and the contact current's window holds only readings at rest.

        Raises:
            ServoFailure: no current was measured within the age allowed for servo_state.
        """
        yield from self.wait(self.parameters.settle_time)
        self.contact.clear()
        yield from self.wait(0.13, reads=True)
        end = self.time + self.parameters.servo_age_max
        while not math.isfinite(self.contact.value) or self.observation.servo_age > self.parameters.press_age_max:
            if self.time > end:
                raise ServoFailure("the servos' currents are not measured; check the servo bus and servo_node")
            yield

    def _is_released(self, z: float) -> bool:
        """Return whether the platform, at `z` m before the pull, has come off; soft electrodes follow a little."""
        retreat = z - self.position[2]
        observation = self.observation
        held = observation.tactile_contact and observation.tactile_age <= self.parameters.tactile_age_max
        return retreat >= (_SPRING_TRAVEL if held else _RELEASED)

    def release(self) -> Script[None]:
        """Pull the electrodes off the magnets.

        The goal is put behind the measured position while the push bound still holds, because a servo whose bound rises
        while it is clipped jumps; only then may it pull. The bound drops as soon as the platform has moved.

        Raises:
            Stuck: the platform did not move within the time allowed.
            Unreachable: it came off where the arm has no way back; it holds there.
            ServoFailure: it is not known where it came off; it holds there.
        """
        parameters, geometry = self.parameters, self.kinematics.geometry
        while not all(map(math.isfinite, self.observation.angles)):
            yield
        self.feed.stop()
        x, y, z = self.position
        lead = parameters.release_current * TORQUE_CONSTANT / parameters.servo_stiffness
        behind = tuple(max(angle - lead, geometry.joint_min) for angle in self.observation.angles)
        goal: Vector = (behind[0], behind[1], behind[2])
        yield from self._pull(goal, parameters.push_current, z, _SETTING_BACK)
        yield from self._pull(goal, parameters.release_current, z, parameters.release_time)
        if not self._is_released(z):
            self.hold()
            raise Stuck(
                f"the magnets held against {parameters.release_current:.1f} A per servo for "
                f"{parameters.release_time:.1f} s; move the target away by hand or raise release_current"
            )
        try:
            free = self._measured()
            self.commanded = (x, y, free[2] - 0.001)
            line = self.planner.line(free, self.commanded, parameters.travel_speed)
        except DockingError:
            self.hold()  # nothing goes on pulling
            raise
        self.feed.start(line, self.time)
        self._retreats = True
        if self.is_blind:
            self._told = (replace(line[-1], time=0.0),)  # here neither
        yield

    def _pull(self, goal: Vector, current: float, z: float, seconds: float) -> Script[None]:
        """Pull toward the angles `goal` for so long, or until the platform has come off.

        It is told in every tick and lapses by itself: whoever stops telling it, and servos that are not heard any more,
        pull no longer. Time without a pull does not count; the phase's does.
        """
        bound, push = ((each * TORQUE_CONSTANT,) * 3 for each in (current, self.parameters.push_current))
        last, left = self.time, seconds
        while left > 0.0 and not self._is_released(z):
            known = self.observation.servos_valid and self.observation.servo_age <= self.parameters.press_age_max
            if known:
                self._told = pull(goal, bound, self._standing(), push)
            yield
            left -= self.time - last if known else 0.0
            last = self.time

    def _standing(self) -> Vector:
        """Return the angles (rad) under which the arm stays where it is, its weight carried."""
        geometry, stiffness = self.kinematics.geometry, self.parameters.servo_stiffness
        held = self.kinematics.holding_torque(*self.position, self.parameters.gravity)
        wanted = (angle + torque / stiffness for angle, torque in zip(self.observation.angles, held, strict=True))
        a, b, c = (min(max(angle, geometry.joint_min), geometry.joint_max) for angle in wanted)
        return a, b, c
