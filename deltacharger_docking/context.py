# SPDX-License-Identifier: Apache-2.0
"""State that docking's scripts share: the latest observation, this tick's commands, and the ways to wait."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from deltacharger_core import machine, script
from deltacharger_docking import arm, codes
from deltacharger_docking.contact import CONTACT_LOST_CURRENT, CONTACT_WINDOW, PRESS_AGE_MAX, ContactCurrent, Evidence
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
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_kinematics import scalar, trajectory_feed
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.line import way_done

# Chosen on seeds of the family 777001, then 5 and 19.
SETTLE_TOUCHING = 0.05  # s, shortest settling time of electrodes in contact
_DRIFT_MAX = 0.015  # A, change of the contact current within its window that counts as rest

RESPONSE_MIN = 0.4  # least multiple of the expected response that is accepted
RESPONSE_MAX = 2.5  # largest multiple of the expected response that is accepted
SERVICE_TIMEOUT = 3.0  # s, limit for set_torque, tare and predict_misalignment
SAME_SAMPLE = 0.001  # s between two dates of one charger_power
SHOWS = 0.5  # of empty_voltage, that a live port shows where nothing bridges it
_READING = 0.01  # s between two readings: the servos' cycle
_SIGMAS = 2.0  # of the readings' noise that are no drift
_SLOW = 0.01  # rad within the contact current's window
_SURELY = 0.25  # of the configured stiffness, which a servo whose own is unknown has at least
_NEARLY = 0.95  # of a servo's current bound
REACH = 0.004  # m from the target, beyond which the magnets (60 N at contact) pull less than the push bound holds
YIELDS = 0.011  # m to which braked robots give way at most: 23 N on 5 N/mm, 2 mm of play twice, springs of 2 mm
_HELD_MAX = 3.0  # s that the arm waits on its way for fresher data, as long as for nodes that start
_SHOWN = 0.1  # s in which servo_state shows what servo_node has done
_NONE: Mapping[str, TargetProfile] = MappingProxyType({})
_QUERIES = (Service.ESTIMATE, Service.DETECT)  # change nothing, however late they are answered
_REACHES_OUT = (codes.State.APPROACH, codes.State.CONTACT, codes.State.MEASURE, codes.State.ALIGN)
_MOVES = (*_REACHES_OUT, codes.State.RETRACT)


@dataclass(frozen=True)
class KnownContact:
    """Last contact on the target: commanded and measured z (m, charger_base), contact current (A)."""

    commanded: float
    measured: float
    current: float


class Live:
    """What is remembered from the order to close the contactor to the order to open it.

    Attributes:
        refused: why a renewal of the lease was refused; '' if none was.
        rest_voltage: V of the target before current flowed; NaN = its port is dead, or electrodes are wired.
    """

    def __init__(self, time: float, rest_voltage: float = math.nan) -> None:
        self.was_closed = False
        self.rest_voltage = rest_voltage
        self.refused, self.refused_at = "", math.inf
        # s, when each was last as it should be
        self.sound = dict.fromkeys(("battery", "target", "current", "reverse"), time)


class Context:
    """State shared by the scripts. In each tick the machine calls `observe` before them and `command` after them."""

    def __init__(
        self,
        parameters: DockingParameters,
        geometry: DeltaGeometry,
        planner: arm.Planner | None = None,
        feed: trajectory_feed.TrajectoryFeed | None = None,
        profiles: Mapping[str, TargetProfile] = _NONE,
    ) -> None:
        self.parameters = parameters
        self.profiles = profiles
        self.choose_profile("")
        self.kinematics = scalar.ScalarDelta(geometry)
        self.contact = ContactCurrent(self.kinematics, parameters)
        self.planner = planner or arm.Planner(parameters, geometry)
        self.springs = self.planner.springs
        self.feed = feed or trajectory_feed.TrajectoryFeed(self.springs.lag)
        self.status = DockingStatus()
        self.observation = Observation(time=0.0)
        self.time = 0.0  # s, the observations' clock; stands still if that is set back
        self.pause = 0.0  # s that this observation came later than expected, or its clock was set back
        self.energise = False
        self.limits = machine.ChargeLimits(0.0, 0.0)  # of the closed contactor
        self.charge_end = ""  # what ended charging in this goal
        self.charge_voltage = math.nan  # V of the target then
        self.port_shown = False  # a contact with this target has shown its voltage
        self._dark = math.inf  # s, date of the first charger_power of this contact without that voltage
        self.clean: dict[TargetProfile, float] = {}  # Ω, least resistance of a loop with such a target so far
        self.live = False  # the contactor was ordered to close and has not been seen open since
        self.opened = False  # the contactor has been seen open, and was not ordered to close since
        self.closing: Live | None = None  # from the order to close to the order to open
        self.evidence = Evidence()  # of the last measurement
        self.doubt = ""  # how the evidence of the last measurement was lost
        self.doubtful = ""  # second sources since the last estimate was requested
        self.energy = 0.0  # J delivered in this goal; NaN once a part of it was not measured
        self.energy_most = 0.0  # J, with full power for what was not measured
        self.angles: Vector = NAN3  # rad, the last measured ones
        self.commanded: Vector = NAN3
        self.share = arm.RemainingShare(parameters)
        self.electrodes: ElectrodePose | None = None  # of the present target, as detected or given before contact
        self.known_contact: KnownContact | None = None  # on the present target
        self.drawn = math.nan  # m along x, by which the magnets drew the platform aside while it landed
        self.lead: Vector = (0.0, 0.0, 0.0)  # m, by which friction and cable keep the platform from its command
        self.touched = self.felt = math.nan  # m, z where the pads began to touch, and where they last did
        self._touches = False  # the pads touch, since `touched`
        self.lets_go = False  # the arm pulls off the magnets, or flies back from them
        self.goal_angles: Vector = NAN3  # final goals of the servos, if known
        self.started = 0.0  # s, of the goal
        self.deadline = math.inf
        self.waits = script.NEXT  # what the script waited for in its last step
        self._retreats = False  # the line under way leads away from the target
        self._line: tuple[Vector, Vector, float] | None = None  # under way: start and end (m), peak speed (m/s)
        self._calls: script.Calls[Reply] = script.Calls()
        self._orders: dict[int, tuple[Service, float]] = {}  # unanswered, by number, with their time (s)
        self._held, self._held_since = "", 0.0  # by which old data the arm is held on its way, and since when (s)
        self._override: trajectory_feed.Piece | None = None  # in place of the line under way
        self._set_back = 0.0
        self._last_valid = self._last_felt = -math.inf
        self._requests: list[Request] = []
        self._decisions: list[Decision] = []

    def choose_profile(self, name: str) -> None:
        """Use the profile of this name; '' = the first. Without profiles, or a power stage, there is none."""
        known = {} if self.parameters.always_live else self.profiles
        self.profile_name = name or next(iter(known), "")
        self.profile = known.get(self.profile_name)

    @property
    def touches_live(self) -> bool:
        """Whether electrodes may be live at the touch: wired to the battery, or by the target's."""
        return self.parameters.always_live or (self.profile is not None and self.profile.port == "live")

    def end_charge(self, why: str) -> None:
        """Record what ends charging, and the target's voltage."""
        self.charge_end, self.charge_voltage = why, self.observation.target_voltage

    @property
    def position(self) -> Vector:
        """Measured platform position (m, charger_base)."""
        return self.contact.position

    def observe(self, observation: Observation) -> None:
        """Take the observation of this tick."""
        before, jump = self.time, max(self.observation.time - observation.time, 0.0)
        ages = {name: getattr(observation, name) for name in ("servo_age", "tactile_age", "power_age")}
        if unknown := [name for name, age in ages.items() if math.isnan(age)]:  # an unknown age is not fresh
            never: dict[str, Any] = dict.fromkeys(unknown, math.inf)
            observation = replace(observation, **never)
        self._set_back += jump
        self.time = observation.time + self._set_back
        self.pause = max(jump, self.time - max(before, self.waits.until))
        self.waits = script.NEXT
        valid = observation.servos_valid and _measured(observation.angles, observation.currents)
        earlier = tuple(reading for reading in observation.earlier if _measured(*reading[1:]))
        if valid is not observation.servos_valid or len(earlier) < len(observation.earlier):
            observation = replace(observation, servos_valid=valid, earlier=earlier)
        for reading in earlier:
            self.contact.update(*reading)
        if valid:
            self.angles, self._last_valid = observation.angles, self.time - observation.servo_age
            self.contact.update(self.time, observation.angles, observation.currents)
        else:  # invalid data does not renew the age of the last valid data
            observation = replace(observation, servo_age=max(observation.servo_age, self.time - self._last_valid))
        if observation.taxels is None or not np.isnan(np.fmax.reduce(observation.taxels, axis=None)):
            self._last_felt = self.time - observation.tactile_age
        else:  # a frame without a measured taxel is none
            age, known = max(observation.tactile_age, self.time - self._last_felt), self.observation
            observation = replace(
                observation, tactile_age=age, tactile_contact=known.tactile_contact, taxels=known.taxels
            )
        if observation.tactile_contact and observation.oldest <= PRESS_AGE_MAX:
            self.felt = self.position[2]
            self.touched = self.touched if self._touches else self.felt
            self._touches = True
        self._touches &= observation.tactile_contact
        shows = self.profile is not None and observation.target_voltage >= SHOWS * self.profile.empty_voltage
        self.port_shown |= shows and self._touches and not observation.contactor_closed
        self._dark = min(self._dark, self.time - observation.power_age) if self._touches and not shows else math.inf
        self.observation = observation
        self._calls.receive(observation.replies)
        self._cross_off(observation.replies)
        if observation.contactor_closed:
            self._count(observation.charge_current * observation.target_voltage, self.time - before)
        self._tell_hold()
        self.evidence.add(observation.taxels)
        self.doubt = self.doubt or self.evidence_lost
        self.doubtful = observation.duplicate_sources or self.doubtful
        self.status.duplicate_sources = observation.duplicate_sources
        self.status.position = self.position
        self.status.contact_current, self.status.contact_force = self.contact.value, self.contact.force

    def _count(self, power: float, seconds: float) -> None:
        """Count the energy of the last `seconds` at this power (W); unknown after a pause without measurements."""
        known = math.isfinite(power) and seconds <= self.parameters.age_max
        self.energy += power * seconds if known else math.nan
        most = power if known else self.profile.current * self.profile.full_voltage if self.profile else 0.0
        self.energy_most += most * seconds

    def _cross_off(self, replies: Iterable[Reply]) -> None:
        """Remove answered orders. An order to go limp that came too late is repeated if no goal needs the torque."""
        for reply in replies:
            order, sent = self._orders.pop(reply.number, (None, self.time))
            late = not reply.success and self.time - sent > machine.ORDER_AGE_MAX
            if late and order is Service.TORQUE_OFF and self.status.state is codes.State.IDLE:
                self.send(Service.TORQUE_OFF)

    def _tell_hold(self) -> None:
        """Report which old data hold the arm on its way; on the way to the target, still older ones end the goal."""
        before, self._held = self._held, ""
        observation, parameters = self.observation, self.parameters
        if self.is_blind and self.status.state in _MOVES and math.isfinite(self.deadline):
            if observation.servo_age > PRESS_AGE_MAX:
                name, missing = "servo_state", observation.servo_age > parameters.age_max
            else:
                name, missing = "tactile_frame", observation.tactile_age > parameters.age_max
            if not missing or self.status.state is codes.State.RETRACT:
                self._held = f"{name} younger than {PRESS_AGE_MAX:g} s"
        if self._held or before:
            self.status.waiting_for = self._held
        if self._held != before:
            self._held_since = self.time

    def command(self) -> Command:
        """Return what the scripts requested in this tick, and clear it."""
        trajectory = self.feed.piece(self.time, held=self.is_blind)
        if self._override is not None:
            trajectory = self._override
        if trajectory and not self.observation.torque_enabled:
            trajectory = None  # limp servos refuse it
        limits, decisions = self.limits if self.energise else None, tuple(self._decisions)
        command = Command(trajectory, tuple(self._requests), self.energise, limits, decisions, self.waits)
        self._override, self._requests, self._decisions = None, [], []
        return command

    @property
    def felt_forces(self) -> tuple[float, float]:
        """Force on each pad, N; NaN without a tared frame."""
        if (taxels := self.observation.taxels) is None:
            return math.nan, math.nan
        left, right = np.nansum(taxels, axis=(1, 2))
        return float(left), float(right)

    @property
    def is_free(self) -> bool:
        """Whether the electrodes surely touch nothing: by pads, currents and the place where they last touched."""
        seen = self.observation
        pushes = seen.torque_enabled and self.contact.value > CONTACT_LOST_CURRENT
        feels = seen.tactile_contact or not seen.tactile_age <= PRESS_AGE_MAX
        return not (feels or pushes or self.position[2] > self.felt - REACH)

    @property
    def is_dark(self) -> bool:
        """Whether two charger_power of this contact lack the voltage that a live port has shown before."""
        live, sampled = self.profile is not None and self.profile.port == "live", self.time - self.observation.power_age
        return live and self.port_shown and sampled > self._dark + SAME_SAMPLE

    @property
    def evidence_lost(self) -> str:
        """Why the last measurement no longer holds; '' = it does."""
        if self.evidence.place is None:
            return ""
        largest = self.contact.value + self.contact.currents_error
        return self.evidence.lost(self.parameters, self.position, largest, self.observation)

    @property
    def is_blind(self) -> bool:
        """Whether servo data, or on the way to the target tactile data, is too old for the arm to move on."""
        oldest, observation = PRESS_AGE_MAX, self.observation
        reaches_out = self.status.state in _REACHES_OUT and not self._retreats
        return observation.servo_age > oldest or (reaches_out and observation.tactile_age > oldest)

    def enter(self, state: codes.State, limit: float) -> None:
        """Begin a phase that may last `limit` seconds."""
        self.status.state = state
        self.deadline = self.time + limit

    def expired(self) -> codes.DockingError | None:
        """Return the error of a phase that lasted too long, or whose data stayed too old to move on, if so."""
        if self._held and self.time - self._held_since > _HELD_MAX:
            observation = self.observation
            if observation.servo_age > PRESS_AGE_MAX:
                return observation.servo_silence()
            told = f"{self._held} was awaited for {_HELD_MAX:g} s, but is {observation.tactile_age:.2f} s old"
            return codes.TactileStale(f"{told}; check the board's cable, tactile_node, and this computer's load")
        if self.time <= self.deadline:
            return None
        phase, waited = self.status.state.name, self.status.waiting_for
        hint = f"it waited for {waited}" if waited else "see in the log what it did"
        return codes.PhaseTimeout(f"{phase} took longer than {phase.lower()}_timeout; {hint}")

    @contextmanager
    def waiting_for(self, what: str) -> Iterator[None]:
        """Report in the status what the script waits for."""
        self.status.waiting_for = what
        try:
            yield
        finally:
            self.status.waiting_for = ""

    def wait(self, seconds: float, reads: bool = False) -> script.Script[None]:
        """Let `seconds` pass; `reads`: readings made during the wait count for the contact current."""
        end = self.time + seconds
        while self.time < end:
            yield script.Wait(end, reads)

    def until(self, condition: Callable[[], bool], seconds: float) -> script.Script[bool]:
        """Wait until a condition holds, at most so many seconds; return whether it does."""
        end = self.time + seconds
        while not condition():
            if self.time > end:
                return False
            yield script.NEXT
        return True

    def ask(
        self, service: Service, error: type[codes.DockingError], timeout: float, frames: int = 0
    ) -> script.Script[Reply]:
        """Call a service and return its reply, successful or not.

        Raises:
            DockingError: of the given class, if no reply arrives within `timeout` seconds.
        """
        self._calls.forget()  # earlier replies are no longer awaited
        number = self._calls.number()
        self._request(Request(number, service, frames, timeout))
        end = self.time + timeout
        with self.waiting_for(service.value):
            while (reply := self._calls.take_reply(number)) is None:
                if self.time > end:
                    raise error(f"no answer from {service.value} within {timeout:.1f} s; is its node running?")
                yield script.Wait(end)
        return reply

    def torque_on(self) -> script.Script[None]:
        """Enable the servos at their present position.

        Raises:
            ServoFailure: they were not enabled.
        """
        self.goal_angles = self.observation.angles
        reply = yield from self.ask(Service.TORQUE_ON, codes.ServoFailure, SERVICE_TIMEOUT)
        if not reply.success:
            raise codes.ServoFailure(f"the servos were not enabled: {reply.message}")
        if not (yield from self.until(lambda: self.observation.torque_enabled, self.parameters.age_max)):
            raise codes.ServoFailure("servo_state does not show the torque that was switched on; check servo_node")

    def send(self, service: Service) -> None:
        """Call a service without waiting for its reply."""
        self._request(Request(self._calls.number(awaited=False), service))

    def _request(self, request: Request) -> None:
        self._requests.append(request)
        if request.service not in _QUERIES:
            self._orders[request.number] = request.service, self.time

    def answered(self) -> script.Script[None]:
        """Wait until all orders of earlier goals are answered and servo_state shows it; none falls into this goal.

        After SERVICE_TIMEOUT a missing answer was lost with its node.
        """
        if not self._orders:
            return
        with self.waiting_for(", ".join(sorted({order.value for order, _ in self._orders.values()}))):
            yield from self.until(lambda: not self._orders, SERVICE_TIMEOUT)
        self._orders.clear()
        yield from self.wait(_SHOWN)

    def decide(self, kind: str, text: str, **values: float) -> None:
        """Record a decision and the numbers behind it, for logs and recordings; names of numbers end in the unit."""
        self._decisions.append(Decision(self.observation.time, self.status.state, kind, text, tuple(values.items())))

    @property
    def unexplained_lead(self) -> float:
        """Distance (m) along z by which the command leads the platform beyond what push, friction and speed explain."""
        springs = self.springs
        stiffness = springs.stiffness if springs.is_estimated else _SURELY * springs.stiffness
        speed = self._line[2] if self._line is not None and self.feed.is_under_way(self.time) else 0.0
        x, y, z = self.position
        held = self.kinematics.holding_torque(x, y, z, self.parameters.gravity)
        yields = (
            ((bound - abs(torque)) / stiffness + springs.play) * lever
            for bound, torque, lever in zip(
                self.planner.bound(held), held, self.kinematics.jacobian(x, y, z)[6:], strict=True
            )
        )
        return self.sent[2] - z - sum(yields) - springs.damping / stiffness * speed

    @property
    def sent(self) -> Vector:
        """Where the command is now (m, charger_base)."""
        if self._line is None or not self.feed.is_under_way(self.time):
            return self.commanded
        start, goal, _ = self._line
        return trajectory_feed.between(start, goal, way_done(self.feed.share(self.time)))

    @property
    def beside(self) -> float:
        """Sideways distance (m) of the platform from the line under way; 0 without one."""
        if self._line is None or not self.feed.is_under_way(self.time):
            return 0.0
        start, goal, _ = self._line
        way = [b - a for a, b in zip(start, goal, strict=True)]
        length = sum(part * part for part in way) or 1.0
        done = sum(part * (p - a) for part, p, a in zip(way, self.position, start, strict=True)) / length
        x, y, _ = trajectory_feed.between(start, goal, min(max(done, 0.0), 1.0))
        return math.hypot(self.position[0] - x, self.position[1] - y)

    def pull(self, goal: Vector, bound: Vector, rest: Vector | None = None) -> None:
        """Set the servos' goals (rad) and torque bounds (N·m) at once.

        Unless repeated, the arm soon goes to `rest` (rad, without weight), or stands where it is if that is None.
        """
        geometry, stiffness = self.kinematics.geometry, self.springs.stiffness
        held = self.kinematics.holding_torque(*self.position, self.parameters.gravity)
        place = rest or self.angles
        wanted = (angle + torque / stiffness for angle, torque in zip(place, held, strict=True))
        a, b, c = (min(max(angle, geometry.joint_min), geometry.joint_max) for angle in wanted)
        self.feed.stop()
        self._override, self.goal_angles = trajectory_feed.pull(goal, bound, (a, b, c), self.planner.bound(held)), goal

    def hold(self) -> None:
        """Stop where the arm is."""
        self._override = self.feed.hold(self.time)
        self.feed.stop()
        self.commanded, self.goal_angles = self.position, NAN3

    def follow(self, line: trajectory_feed.Piece, retreats: bool = False) -> None:
        """Begin a line; `retreats` = it leads away from the target."""
        self._retreats, self._override = retreats, None  # it begins even in the tick of a hold
        self.feed.start(line, self.time)
        self.goal_angles = line[-1].angles

    def move(
        self,
        goal: Vector,
        speed: float,
        settle: bool = True,
        until: Callable[[], bool] | None = None,
        spare: Callable[[], float] | None = None,
    ) -> script.Script[bool]:
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
                self.commanded = trajectory_feed.between(start, goal, way_done(self.feed.share(self.time)))
                self._override, self.goal_angles = self.feed.hold(self.time), NAN3
                self.feed.stop()
                return True
            if until is None:
                yield script.Wait(self.feed.end)
            elif spare is None:
                yield script.Wait(self.feed.end, reads=True, nearing=speed)
            else:
                yield script.Wait(min(self.feed.end, self.time + spare()), reads=True)
        if settle:
            yield from self.rest()
        return False

    def read(self) -> script.Script[None]:
        """Refill the contact current's window; if the arm hardly moves, also estimate the servos' springs."""
        before, began = self.observation.angles, self.time
        self.contact.clear()
        yield from self.wait(CONTACT_WINDOW + _READING, reads=True)
        after, span = self.observation.angles, self.time - began
        slow = all(abs(now - then) <= _SLOW for now, then in zip(after, before, strict=True))
        live = math.isfinite(self.goal_angles[0]) and not self.contact.repeats_itself
        if slow and live and not self.is_bound(self.contact.currents):
            a, b, c = ((now - then) / span for now, then in zip(after, before, strict=True))
            self.springs.add_reading(
                self.goal_angles, trajectory_feed.between(before, after, 0.5), (a, b, c), self.contact.currents
            )
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
            raise codes.ServoFailure("the arm's place is unknown, so it was not moved; check servo bus and servo_node")
        return self.position

    def check_moved(self, since: float) -> None:
        """Check that the arm, ordered to move, was seen to do anything since then (s): a held one shows other currents.

        Raises:
            Astray: servo_state repeats one reading.
        """
        if self.contact.changed <= since:
            raise codes.Astray("servo_state repeats one reading, so nothing shows where the arm is; restart servo_node")

    def rest(self) -> script.Script[None]:
        """Wait until the servos have settled and the contact current's window holds only readings at rest.

        Electrodes in contact settle sooner than the arm in free air. While the current drifts, the wait continues.

        Raises:
            ServoFailure: no current was measured within the age allowed for servo_state.
        """
        contact, settle_time = self.contact, self.springs.settle_time
        settled = self.time + settle_time
        touching = self.observation.tactile_contact
        yield from self.wait(min(settle_time, SETTLE_TOUCHING if touching else math.inf))
        while True:
            yield from self.read()
            if self.time > settled or not abs(contact.drift) > max(_DRIFT_MAX, _SIGMAS * contact.currents_error):
                break
        fresh = lambda: math.isfinite(contact.value) and not self.observation.servo_age > PRESS_AGE_MAX  # noqa: E731
        if not (yield from self.until(fresh, self.parameters.age_max)):
            raise codes.ServoFailure("the servos' currents are not measured; check the servo bus and servo_node")


def _measured(angles: Vector, currents: Vector) -> bool:
    """Return whether all numbers of the servos' readings are finite."""
    return all(map(math.isfinite, angles)) and all(map(math.isfinite, currents))
