# SPDX-License-Identifier: Apache-2.0
"""Laws of the docking machine under any observations: no current without all of its conditions, and no endless goal.

A small cooperative model drives the machine, so that a docking takes a few hundred steps. An adversary spoils its
observations: not measured, too old, contradictory, twice, of another kind, with goals at any time.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deltacharger_core.machine import TORQUE_CONSTANT
from deltacharger_docking.clearance import MisalignmentEstimate, Verdict, judge
from deltacharger_docking.codes import Code, DockingError, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import (
    Command,
    DockGoal,
    ElectrodePose,
    Observation,
    Reply,
    Request,
    Service,
)
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_lab.campaigns.quick_motion import QuickPlanner

TICK = 0.05  # s; coarse, as the model has no dynamics
DEPTH = 0.080  # m, where the target's faces are
LIMITS = DockingParameters(
    gravity_y=0.0, goal_timeout=25.0, locate_timeout=2.0, energise_timeout=4.0, retract_timeout=8.0, restarts_max=1
)
NAN3 = (math.nan, math.nan, math.nan)

# What may follow each state: docs/dock-goals.md.
BACK = {State.RETRACT}
LEGAL: dict[State, set[State]] = {
    State.IDLE: {State.LOCATE, State.APPROACH, State.MEASURE, *BACK},
    State.LOCATE: {State.APPROACH, *BACK},
    State.APPROACH: {State.CONTACT, State.BACK_OFF, *BACK},
    State.CONTACT: {State.MEASURE, *BACK},
    State.BACK_OFF: {State.CONTACT, *BACK},
    State.MEASURE: {State.ALIGN, State.CONTACT, State.ENERGISE, State.IDLE, *BACK},
    State.ALIGN: {State.CONTACT, *BACK},
    State.ENERGISE: {State.CHARGING, *BACK},
    State.CHARGING: {State.IDLE, *BACK},
    State.RETRACT: {State.IDLE, State.LOCATE, State.APPROACH},
}


@dataclass
class Model:
    """A charger without dynamics: the platform is at its command, and pushes by its distance beyond the target."""

    geometry: ScalarDelta = field(default_factory=lambda: ScalarDelta(DeltaGeometry()))
    now: float = 0.0
    goal: Vector = (0.0, 0.0, 0.0)
    way: tuple[Waypoint, ...] = ()
    commanded_at: float = 0.0
    torque: bool = False
    tared: bool = False
    closed: bool = False
    wanted: bool = False
    estimate: MisalignmentEstimate = field(
        default_factory=lambda: MisalignmentEstimate(0.01, 0.004, 0.0002, 0.0002, 0.0003, 0.0004)
    )
    pending: list[tuple[float, Request]] = field(default_factory=list)
    replies: list[Reply] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.goal = self.geometry.inverse(0.0, 0.0, 0.0)

    def follow(self, command: Command) -> None:
        """Carry out a command."""
        if command.trajectory is not None and self.torque:
            self.way, self.commanded_at = command.trajectory, self.now
        for request in command.requests:
            self.pending.append((self.now + 0.1, request))
        self.wanted = command.energise

    def observe(self) -> Observation:
        """Advance by a tick and return the observation."""
        self.now += TICK
        for item in [item for item in self.pending if item[0] <= self.now]:
            self.pending.remove(item)
            self.replies.append(self._serve(item[1]))
        self.closed = self.wanted
        while self.way and self.torque and self.way[0].time <= self.now - self.commanded_at:
            self.goal, self.way = self.way[0].angles, self.way[1:]
        x, y, z = self.geometry.forward(*self.goal)
        touches = z >= DEPTH
        angles = self.geometry.inverse(x, y, DEPTH) if touches else self.goal
        lead = [LIMITS.servo_stiffness * (goal - angle) for goal, angle in zip(self.goal, angles, strict=True)]
        a, b, c = (torque / TORQUE_CONSTANT for torque in lead)
        replies, self.replies = tuple(self.replies), []
        return Observation(
            time=self.now,
            angles=angles,
            currents=(a, b, c) if self.torque else (0.0, 0.0, 0.0),
            servo_age=0.005,
            servos_valid=True,
            torque_enabled=self.torque,
            tactile_age=0.008,
            tactile_contact=touches and self.torque,
            tared=self.tared,
            power_age=0.02,
            contactor_closed=self.closed,
            charge_current=8.0 if self.closed else 0.0,
            target_voltage=24.0,
            battery_voltage=26.0,
            replies=replies,
        )

    def _serve(self, request: Request) -> Reply:
        number, service = request.number, request.service
        if service in (Service.TORQUE_ON, Service.TORQUE_OFF):
            self.torque = service is Service.TORQUE_ON
        if service is Service.TARE:
            self.tared = True
        if service is Service.PROBE:
            return Reply(number, True, resistance=2000.0, target_voltage=24.0)
        if service is Service.ESTIMATE:
            return Reply(number, True, estimate=self.estimate)
        if service is Service.DETECT:
            return Reply(number, True, detection=ElectrodePose((0.0, 0.0, DEPTH), 0.02, 0.01, 0.1))
        return Reply(number, True)


class Judge:
    """Checks every observation and command against the rules, without knowledge of the machine's internals."""

    def __init__(self) -> None:
        self.asked: dict[int, Service] = {}
        self.states = [State.IDLE]
        self.closings = 0
        self._closed = False
        self._forget()

    def _forget(self) -> None:
        self.passed: list[Verdict] = []
        self.probed = False

    def observe(self, observation: Observation) -> None:
        """Store the machine's observation."""
        for reply in observation.replies:
            service = self.asked.pop(reply.number, None)
            if service is Service.ESTIMATE:
                self._judge_estimate(reply)
            elif service is Service.PROBE:
                low, high = LIMITS.target_voltage_min, LIMITS.target_voltage_max
                good = reply.success and LIMITS.probe_resistance_min <= reply.resistance < math.inf
                self.probed = good and low <= reply.target_voltage <= high

    def _judge_estimate(self, reply: Reply) -> None:
        estimate = reply.estimate if reply.success else None
        good = estimate is not None and estimate.complete and estimate.sure and estimate.in_range and estimate.contact
        verdict = judge(estimate, LIMITS) if good and estimate is not None else None
        self.passed = [*self.passed, verdict] if verdict in (Verdict.SAFE, Verdict.PROBABLY_SAFE) else []

    def check_command(self, observation: Observation, command: Command, contact_current: float) -> None:
        """Check the machine's command."""
        for state in command.states:
            assert state in LEGAL[self.states[-1]], f"{self.states[-1].name} → {state.name}"
            self.states.append(state)
        self.asked.update((request.number, request.service) for request in command.requests)
        if command.energise and not self._closed:
            self._check_closing(observation, contact_current)
        if not command.energise and command.trajectory and self.states[-1] is not State.RETRACT:
            self.probed = False  # a new contact needs a new probe
        if (self._closed and not command.energise) or self.states[-1] in (State.ALIGN, State.RETRACT):
            self._forget()
        self._closed = command.energise

    def _check_closing(self, observation: Observation, contact_current: float) -> None:
        self.closings += 1
        assert self.states[-1] is State.ENERGISE
        assert observation.torque_enabled
        assert observation.hardware_error == 0
        assert observation.tactile_contact
        assert contact_current >= LIMITS.contact_lost_current
        assert observation.servo_age <= LIMITS.live_servo_age_max
        assert observation.tactile_age <= LIMITS.tactile_age_max
        assert observation.power_age <= LIMITS.power_age_max
        assert LIMITS.battery_voltage_min <= observation.battery_voltage <= LIMITS.battery_voltage_max
        assert self.probed, "a good probe after the last motion"
        assert self.passed, "the last estimate before it leaves clearance"
        assert Verdict.SAFE in self.passed or len(self.passed) >= 2


Spoil = Callable[[Observation, random.Random], Observation]
FLAGS = ("sure", "in_range", "contact")


def _replies(change: Callable[[Reply, random.Random], Iterator[Reply]]) -> Spoil:
    def spoil(seen: Observation, source: random.Random) -> Observation:
        return replace(seen, replies=tuple(each for reply in seen.replies for each in change(reply, source)))

    return spoil


def _twice(reply: Reply, source: random.Random) -> Iterator[Reply]:
    yield reply
    yield replace(reply, success=not reply.success)


def _unknown(reply: Reply, source: random.Random) -> Iterator[Reply]:
    yield replace(reply, number=reply.number + source.choice((-3, 1, 2, 1000)))
    yield reply


def _failed(reply: Reply, source: random.Random) -> Iterator[Reply]:
    yield Reply(reply.number, source.random() < 0.5, "out of order")


def _other(reply: Reply, source: random.Random) -> Iterator[Reply]:
    """A reply like that of another service, or one with invalid numbers."""
    value = source.choice((math.nan, math.inf, 0.2, -24.0, 5.0, 1e9, 24.0))
    felt = reply.estimate
    if felt is not None:
        number, flag = source.choice(("angle", "angle_stddev", "vertical", "vertical_stddev")), source.choice(FLAGS)
        wrong = {number: source.choice((math.nan, 0.25, -0.25, -1.0, 0.02))}
        felt = replace(felt, **(wrong if source.random() < 0.5 else {flag: False}))
    yield replace(reply, resistance=value, target_voltage=source.choice((24.0, value)), estimate=felt, detection=None)


SPOILS: dict[str, Spoil] = {
    "nan angles": lambda seen, source: replace(seen, angles=NAN3, servos_valid=source.random() < 0.5),
    "nan currents": lambda seen, source: replace(seen, currents=NAN3),
    "invalid": lambda seen, source: replace(seen, servos_valid=False),
    "servo age": lambda seen, source: replace(seen, servo_age=source.choice((0.15, 0.4, 5.0, math.inf))),
    "tactile age": lambda seen, source: replace(seen, tactile_age=source.choice((0.15, 0.6, math.inf))),
    "power age": lambda seen, source: replace(seen, power_age=source.choice((0.3, 0.6, math.inf))),
    "no touch": lambda seen, source: replace(seen, tactile_contact=not seen.tactile_contact),
    "torque": lambda seen, source: replace(seen, torque_enabled=not seen.torque_enabled),
    "error": lambda seen, source: replace(seen, hardware_error=source.choice((1, 32))),
    "fault": lambda seen, source: replace(seen, power_fault=source.choice(range(1, 12))),
    "contactor": lambda seen, source: replace(seen, contactor_closed=not seen.contactor_closed),
    "charge": lambda seen, source: replace(seen, charge_current=source.choice((math.nan, -3.0, 0.0, 0.3, 25.0))),
    "battery": lambda seen, source: replace(seen, battery_voltage=source.choice((math.nan, 0.0, 20.0, 35.0))),
    "push": lambda seen, source: replace(seen, currents=(source.uniform(-2.0, 2.0),) * 3),
    "reserve": lambda seen, source: replace(seen, thermal_reserve=source.choice((0.0, math.nan))),
    "refused": lambda seen, source: replace(seen, contactor_refusal="refused"),
    "twice": _replies(_twice),
    "unknown": _replies(_unknown),
    "failed": _replies(_failed),
    "other": _replies(_other),
    "nothing": lambda seen, source: replace(seen, replies=()),
}


class Run:
    """A machine, the model, the adversary and the judge."""

    def __init__(self, seed: int, spoiled: tuple[str, ...], rate: float) -> None:
        self.model, self.judge = Model(), Judge()
        geometry = DeltaGeometry()
        self.machine = DockingMachine(LIMITS, geometry, QuickPlanner(LIMITS, geometry))
        self._source = random.Random(seed)
        self._spoiled, self._rate, self._left = spoiled, rate, 0
        self._how: Spoil = lambda seen, source: seen
        self.codes: list[Code] = []

    def _observe(self) -> Observation:
        seen, source = self.model.observe(), self._source
        if self._left <= 0 and self._spoiled and source.random() < self._rate:
            self._left = source.choice((1, 1, 2, 5, 40))
            self._how = SPOILS[source.choice(self._spoiled)]
        if self._left > 0:
            self._left -= 1
            seen = self._how(seen, source)
        return seen

    def step(self) -> None:
        """One tick of everything."""
        observation = self._observe()
        self.judge.observe(observation)
        command = self.machine.step(observation)
        self.judge.check_command(observation, command, self.machine.status.contact_current)
        self.model.follow(command)
        outcome, self.machine.outcome = self.machine.outcome, None
        if outcome is not None:
            assert outcome.success == (outcome.code is Code.NONE)
            assert outcome.message
            self.codes.append(outcome.code)

    def goal(self, goal: DockGoal | None) -> None:
        """Send a goal, None = undock; refusals have codes too."""
        try:
            seen = replace(self.model.observe(), replies=())
            if goal is None:
                self.machine.start_undock("", seen)
            else:
                self.machine.start_dock(goal, seen)
        except DockingError as error:
            self.codes.append(error.code)

    def finish(self, limit: float) -> None:
        """Step until the goal has its outcome."""
        count, end = len(self.codes), self.model.now + limit
        while len(self.codes) == count:
            assert self.model.now < end, f"no outcome within {limit} s in {self.machine.status.state.name}"
            self.step()

    def settle(self) -> None:
        """Let the machine end its own actions without the adversary."""
        self._spoiled, self._left = (), 0
        quiet, end = 0, self.model.now + ENOUGH
        while quiet < 20:
            assert self.model.now < end, f"not at rest within {ENOUGH} s, {self.machine.status.state.name}"
            self.step()
            rests = self.machine.status.state in (State.IDLE, State.CHARGING)
            quiet = quiet + 1 if rests and not self.machine.busy else 0


# The goal's deadline twice, since docking restarts once, plus retracting and the time by which the clock was set back.
ENOUGH = 2.0 * (LIMITS.goal_timeout + LIMITS.retract_timeout + 5.0)
ADVERSARIES = st.tuples(
    st.integers(0, 2**32),
    st.lists(st.sampled_from(sorted(SPOILS)), min_size=1, max_size=3, unique=True).map(tuple),
    st.sampled_from((0.0, 0.003, 0.02, 0.2)),
)
GOALS = st.builds(
    DockGoal,
    st.sampled_from((ElectrodePose((0.0, 0.0, DEPTH), 0.0), None)),
    critical_angle=st.sampled_from((0.0, 0.0, 0.15)),
    start_charging=st.sampled_from((True, True, False)),
    stop_after=st.sampled_from((0.0, 1.0)),
    hold=st.just(False),
)
SETTINGS = settings(
    max_examples=150, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)


def test_the_cooperative_model_is_docked_charged_and_undocked() -> None:
    run = Run(1, (), 0.0)
    run.goal(DockGoal(None))
    run.finish(ENOUGH)
    assert run.codes == [Code.NONE]
    assert run.judge.closings == 1
    run.goal(None)
    run.finish(ENOUGH)
    assert run.codes == [Code.NONE, Code.NONE]
    assert not run.model.torque


@pytest.mark.rest
@SETTINGS
@given(adversary=ADVERSARIES, goals=st.lists(GOALS, min_size=1, max_size=3), undock=st.booleans())
def test_the_contactor_closes_only_under_its_conditions_and_every_goal_ends(
    adversary: tuple[int, tuple[str, ...], float], goals: list[DockGoal], undock: bool
) -> None:
    run = Run(*adversary)
    for goal in goals:
        known = len(run.codes)
        run.goal(goal)
        if len(run.codes) == known:  # it was not refused at once, as one is while the arm is on its way back
            run.finish(ENOUGH)
        for _ in range(40):
            run.step()
    if undock:
        run.goal(None)
    run.settle()
    assert run.machine.busy is False
    assert run.machine.status.state is (State.CHARGING if run.model.wanted else State.IDLE)
