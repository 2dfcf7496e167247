# SPDX-License-Identifier: Apache-2.0
"""State that docking's scripts share: the latest observation, this tick's commands, and the ways to wait."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from deltacharger_core.script import NEXT, Calls, Script, Wait
from deltacharger_docking.codes import Astray, DockingError, PhaseTimeout, ServoFailure, State
from deltacharger_docking.contact_current import ContactCurrent
from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import (
    NAN3,
    Command,
    Decision,
    DockingStatus,
    ElectrodePose,
    Observation,
    Reply,
    Request,
    Service,
)
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.senses import TwoSenses
from deltacharger_docking.yielding import RemainingShare
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.line import way_done
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.trajectory_feed import Piece, TrajectoryFeed, between, pull

_READING = 0.01  # s between two readings: the servos' cycle
_SIGMAS = 2.0  # of the readings' noise that are no drift
_SLOW = 0.01  # rad within the contact current's window
_SURELY = 0.25  # of the configured stiffness, which a servo whose own is unknown has at least
_NEARLY = 0.95  # of a servo's current bound
_OUTSIDE = 0.002  # m beyond the workspace box; faultless dockings stay 0.1 mm within below, 20 mm elsewhere
_REACHES_OUT = (State.APPROACH, State.CONTACT, State.MEASURE, State.ALIGN)


@dataclass(frozen=True)
class KnownContact:
    """Last contact on the target: commanded and measured z (m, charger_base), contact current (A)."""

    commanded: float
    measured: float
    current: float


class Context:
    """State shared by the scripts. In each tick the machine calls `observe` before them and `command` after them."""

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
        self.springs = self.planner.springs
        self.feed = feed or TrajectoryFeed(self.springs.lag)
        self.status = DockingStatus()
        self.observation = Observation(time=0.0)
        self.time = 0.0  # s, the observations' clock; stands still if that is set back
        self.pause = 0.0  # s that this observation came later than expected, or its clock was set back
        self.energise = False
        self.live = False  # the contactor was ordered to close and has not been seen open since
        self.doubtful = False  # there was a second source since the last estimate was requested
        self.energy = 0.0
        self.commanded: Vector = NAN3
        self.share = RemainingShare(parameters)
        self.senses = TwoSenses(parameters)
        self.electrodes: ElectrodePose | None = None  # of the present target, as detected or given before contact
        self.known_contact: KnownContact | None = None  # on the present target
        self.drawn = math.nan  # m along x, by which the magnets drew the platform aside while it landed
        self.lead: Vector = (0.0, 0.0, 0.0)  # m, by which friction and cable keep the platform from its command
        self.touched = self.felt = math.nan  # m, z where the pads began to touch, and where they last did
        self.lets_go = False  # the arm pulls off the magnets, or flies back from them
        self.goal_angles: Vector = NAN3  # final goals of the servos, if known
        self.deadline = math.inf
        self.waits = NEXT  # what the script waited for in its last step
        self._retreats = False  # the line under way leads away from the target
        self._line: tuple[Vector, Vector, float] | None = None  # under way: start and end (m), peak speed (m/s)
        self._calls: Calls[Reply] = Calls()
        self._override: Piece | None = None  # in place of the line under way
        self._set_back = 0.0
        self._last_valid = -math.inf
        self._states: list[State] = []
        self._requests: list[Request] = []
        self._decisions: list[Decision] = []

    def use_parameters(self, parameters: DockingParameters) -> None:
        """Use other parameters; those that describe the machine must be unchanged."""
        self.parameters = self.planner.parameters = parameters

    @property
    def position(self) -> Vector:
        """Measured platform position (m, charger_base)."""
        return self.contact.position

    def observe(self, observation: Observation) -> None:
        """Take the observation of this tick."""
        before, jump = self.time, max(self.observation.time - observation.time, 0.0)
        ages = observation.servo_age, observation.tactile_age, observation.power_age
        if math.isnan(sum(ages)):  # an unknown age is not fresh
            servo, tactile, power = (math.inf if math.isnan(age) else age for age in ages)
            observation = replace(observation, servo_age=servo, tactile_age=tactile, power_age=power)
        self._set_back += jump
        self.time = observation.time + self._set_back
        self.pause = max(jump, self.time - max(before, self.waits.until))
        self.waits = NEXT
        for reading in observation.earlier:
            self.contact.update(*reading)
        if observation.servos_valid:
            self._last_valid = self.time - observation.servo_age
            self.contact.update(self.time, observation.angles, observation.currents)
        else:  # invalid data does not renew the age of the last valid data
            observation = replace(observation, servo_age=max(observation.servo_age, self.time - self._last_valid))
        if observation.tactile_contact:
            self.felt = self.position[2]
            self.touched = self.touched if self.observation.tactile_contact else self.felt
        self.observation = observation
        self._calls.receive(observation.replies)
        power = observation.charge_current * observation.target_voltage
        if observation.contactor_closed and math.isfinite(power):
            self.energy += power * min(self.time - before, self.parameters.energy_gap_max)
        self.doubtful |= bool(observation.duplicate_sources)
        self.status.duplicate_sources = observation.duplicate_sources
        self.status.position = self.position
        self.status.dampings, self.status.friction_force = self.springs.dampings, self.springs.friction_force
        self.status.contact_current, self.status.contact_force = self.contact.value, self.contact.force

    def command(self) -> Command:
        """Return what the scripts requested in this tick, and clear it."""
        trajectory = self.feed.piece(self.time, held=self.is_blind)
        if self._override is not None:
            trajectory = self._override
        if trajectory and not self.observation.torque_enabled:
            trajectory = None  # limp servos refuse it
        states, decisions = tuple(self._states), tuple(self._decisions)
        command = Command(trajectory, tuple(self._requests), self.energise, states, decisions, self.waits)
        self._override = None
        self._requests, self._states, self._decisions = [], [], []
        return command

    @property
    def astray(self) -> Astray | None:
        """Why the arm must not be driven on, if so."""
        seen, geometry = self.observation, self.kinematics.geometry
        if seen.stopped:
            return Astray(f"servo_node stopped the arm: {seen.stopped}")
        box = zip(geometry.workspace_min, self.position, geometry.workspace_max, strict=True)
        if not seen.torque_enabled or not any(p < low - _OUTSIDE or p > high + _OUTSIDE for low, p, high in box):
            return None
        x, y, z = (1000.0 * value for value in self.position)
        return Astray(
            f"the arm is at ({x:.0f}, {y:.0f}, {z:.0f}) mm, outside its workspace: look at its horns, rods and "
            "zero_ticks, and at what drags it"
        )

    @property
    def is_blind(self) -> bool:
        """Whether servo data, or on the way to the target tactile data, is too old for the arm to move on."""
        oldest, observation = self.parameters.press_age_max, self.observation
        reaches_out = self.status.state in _REACHES_OUT and not self._retreats
        return observation.servo_age > oldest or (reaches_out and observation.tactile_age > oldest)

    def enter(self, state: State, limit: float) -> None:
        """Begin a phase that may last `limit` seconds."""
        if state is not self.status.state:
            self._states.append(state)
        self.status.state = state
        self.deadline = self.time + limit

    def expired(self) -> DockingError | None:
        """Return the error of a phase that lasted too long, if it did."""
        if self.time <= self.deadline:
            return None
        phase = self.status.state.name
        return PhaseTimeout(f"{phase} took longer than {phase.lower()}_timeout; see in the log what it waited for")

    @contextmanager
    def waiting_for(self, what: str) -> Iterator[None]:
        """Report in the status what the script waits for."""
        self.status.waiting_for = what
        try:
            yield
        finally:
            self.status.waiting_for = ""

    def wait(self, seconds: float, reads: bool = False) -> Script[None]:
        """Let `seconds` pass; `reads`: readings made during the wait count for the contact current."""
        end = self.time + seconds
        while self.time < end:
            yield Wait(end, reads)

    def ask(self, service: Service, error: type[DockingError], timeout: float, frames: int = 0) -> Script[Reply]:
        """Call a service and return its reply, successful or not.

        Raises:
            DockingError: of the given class, if no reply arrives within `timeout` seconds.
        """
        self._calls.forget()  # earlier replies are no longer awaited
        number = self._calls.number()
        self._requests.append(Request(number, service, frames, timeout))
        end = self.time + timeout
        with self.waiting_for(service.value):
            while (reply := self._calls.take(number)) is None:
                if self.time > end:
                    raise error(f"no answer from {service.value} within {timeout:.1f} s; is its node running?")
                yield Wait(end)
        return reply

    def torque_on(self) -> Script[None]:
        """Enable the servos at their present position.

        Raises:
            ServoFailure: they were not enabled.
        """
        self.goal_angles = self.observation.angles
        reply = yield from self.ask(Service.TORQUE_ON, ServoFailure, self.parameters.service_timeout)
        if not reply.success:
            raise ServoFailure(f"the servos were not enabled: {reply.message}")

    def send(self, service: Service) -> None:
        """Call a service without waiting for its reply."""
        self._requests.append(Request(self._calls.number(awaited=False), service))

    def decide(self, kind: str, text: str, **values: float) -> None:
        """Record a decision and the numbers behind it, for logs and recordings; names of numbers end in the unit."""
        self._decisions.append(Decision(self.observation.time, self.status.state, kind, text, tuple(values.items())))

    def send_piece(self, piece: Piece) -> None:
        """Send this piece in this tick, in place of the line under way."""
        self._override = piece

    @property
    def unexplained_lead(self) -> float:
        """Distance (m) along z by which the command leads the platform beyond what push, friction and speed explain."""
        springs, ahead, speed = self.springs, self.commanded, 0.0
        stiffness = springs.stiffness if springs.is_estimated else _SURELY * springs.stiffness
        if self._line is not None and self.feed.is_under_way(self.time):
            start, goal, speed = self._line
            ahead = between(start, goal, way_done(self.feed.share(self.time)))
        x, y, z = self.position
        held = self.kinematics.holding_torque(x, y, z, self.parameters.gravity)
        yields = (
            ((bound - abs(torque)) / stiffness + springs.play) * lever
            for bound, torque, lever in zip(
                self.planner.bound(held), held, self.kinematics.jacobian(x, y, z)[6:], strict=True
            )
        )
        return ahead[2] - z - sum(yields) - springs.damping / stiffness * speed

    def pull(self, goal: Vector, bound: Vector, rest: Vector | None = None) -> None:
        """Set the servos' goals (rad) and torque bounds (N·m) at once.

        Unless repeated, the arm soon goes to `rest` (rad, without weight), or stands where it is if that is None.
        """
        geometry, stiffness = self.kinematics.geometry, self.springs.stiffness
        held = self.kinematics.holding_torque(*self.position, self.parameters.gravity)
        place = rest or self.observation.angles
        wanted = (angle + torque / stiffness for angle, torque in zip(place, held, strict=True))
        a, b, c = (min(max(angle, geometry.joint_min), geometry.joint_max) for angle in wanted)
        self.feed.stop()
        self._override, self.goal_angles = pull(goal, bound, (a, b, c), self.planner.bound(held)), goal

    def hold(self) -> None:
        """Stop where the arm is."""
        self._override = self.feed.hold(self.time)
        self.feed.stop()
        self.commanded, self.goal_angles = self.position, NAN3

    def follow(self, line: Piece, retreats: bool = False) -> None:
        """Begin a line; `retreats` = it leads away from the target."""
        self._retreats, self._override = retreats, None  # it begins even in the tick of a hold
        self.feed.start(line, self.time)
        self.goal_angles = line[-1].angles

    def interrupt(self) -> None:
        """Stop the line under way, if there is one."""
        if self.feed.is_under_way(self.time):
            self.hold()

    def move(
        self,
        goal: Vector,
        speed: float,
        settle: bool = True,
        until: Callable[[], bool] | None = None,
        spare: Callable[[], float] | None = None,
    ) -> Script[bool]:
        """Move on a straight line from the last commanded position to `goal` (m, charger_base); pause while `is_blind`.

        Args:
            goal: end of the line.
            speed: peak, m/s.
            settle: come to rest at the end.
            until: checked in every tick; if true, the line and the command end there.
            spare: s in which `until` cannot become true; None = it cannot before the electrodes touch.

        Returns:
            Whether `until` ended the line; then the arm is not yet at rest.

        Raises:
            Unreachable: the line leaves the arm's reach; nothing was moved.
            ServoFailure: the arm's position is unknown; nothing was moved.
        """
        start = self.commanded if math.isfinite(self.commanded[0]) else self.measured()
        self._line = start, goal, speed
        self.follow(self.planner.line(start, goal, speed), retreats=goal[2] < start[2])
        self.commanded = goal
        while self.feed.is_under_way(self.time):
            if until is not None and until():
                self.commanded = between(start, goal, way_done(self.feed.share(self.time)))
                self._override, self.goal_angles = self.feed.hold(self.time), NAN3
                self.feed.stop()
                return True
            if until is None:
                yield Wait(self.feed.end)
            elif spare is None:
                yield Wait(self.feed.end, reads=True, nearing=speed)
            else:
                yield Wait(min(self.feed.end, self.time + spare()), reads=True)
        if settle:
            yield from self.rest()
        return False

    def read(self) -> Script[None]:
        """Refill the contact current's window; if the arm hardly moves, also estimate the servos' springs."""
        before, began = self.observation.angles, self.time
        self.contact.clear()
        yield from self.wait(self.parameters.contact_window + _READING, reads=True)
        after, span = self.observation.angles, self.time - began
        slow = all(abs(now - then) <= _SLOW for now, then in zip(after, before, strict=True))
        live = math.isfinite(self.goal_angles[0]) and not self.contact.repeats_itself
        if slow and live and not self.is_bound(self.contact.currents):
            a, b, c = ((now - then) / span for now, then in zip(after, before, strict=True))
            self.springs.add_reading(self.goal_angles, between(before, after, 0.5), (a, b, c), self.contact.currents)
            self.feed.lag = self.springs.lag

    def is_bound(self, currents: Vector) -> bool:
        """Return whether a current (A) is at its bound and so no longer shows how far the servo yields."""
        parameters = self.parameters
        held = self.kinematics.holding_torque(*self.position, parameters.gravity)
        share = _NEARLY / parameters.torque_constant
        return not all(abs(now) < share * most for now, most in zip(currents, self.planner.bound(held), strict=True))

    def check_way(self, *places: Vector) -> None:
        """Check the way from the measured position through `places` before the arm moves.

        Raises:
            Unreachable: a leg leaves the arm's reach.
            ServoFailure: the arm's position is unknown.
        """
        self.planner.check_way(self.parameters.travel_speed, self.measured(), *places)

    def measured(self) -> Vector:
        """Return the platform's measured position (m, charger_base).

        Raises:
            ServoFailure: it is unknown.
        """
        if not all(map(math.isfinite, self.position)):
            raise ServoFailure("the arm's position is unknown, so it was not moved; check the servo bus and servo_node")
        return self.position

    def rest(self) -> Script[None]:
        """Wait until the servos have settled and the contact current's window holds only readings at rest.

        Electrodes in contact settle sooner than the arm in free air. While the current drifts, the wait continues.

        Raises:
            ServoFailure: no current was measured within the age allowed for servo_state.
        """
        parameters, contact, settle_time = self.parameters, self.contact, self.springs.settle_time
        settled = self.time + settle_time
        touching = self.observation.tactile_contact
        yield from self.wait(min(settle_time, parameters.settle_touching if touching else math.inf))
        while True:
            yield from self.read()
            if self.time > settled or not abs(contact.drift) > max(
                parameters.drift_max, _SIGMAS * contact.currents_error
            ):
                break
        end = self.time + parameters.servo_age_max
        while not math.isfinite(self.contact.value) or self.observation.servo_age > self.parameters.press_age_max:
            if self.time > end:
                raise ServoFailure("the servos' currents are not measured; check the servo bus and servo_node")
            yield NEXT
