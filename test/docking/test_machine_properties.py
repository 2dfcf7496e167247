# SPDX-License-Identifier: Apache-2.0
"""Laws of the docking machine under any observations: no current without all of its conditions, and no endless goal.

A charger in virtual time drives the machine. An adversary spoils its observations: not measured, too old,
contradictory, twice, of another kind, with goals at any time.
"""

import math
import random
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from deltacharger_docking import algorithm, clearance, codes, contact, parameters, release
from deltacharger_docking.observation import Command, DockGoal, Observation, Reply, Service
from deltacharger_sim.virtual.virtual_charger import GOAL

from .. import quick
from .dockings import quick_charger

GOAL_TIMEOUT, LOCATE_TIMEOUT, RETRACT_TIMEOUT = 25.0, 2.0, 8.0
LIMITS = parameters.DockingParameters(**quick.STEPS, goal_timeout=GOAL_TIMEOUT)
NAN3 = (math.nan, math.nan, math.nan)

# What may follow each state: docs/dock-goals.md.
BACK = {codes.State.RETRACT}
LEGAL: dict[codes.State, set[codes.State]] = {
    codes.State.IDLE: {codes.State.LOCATE, codes.State.APPROACH, codes.State.MEASURE, *BACK},
    codes.State.LOCATE: {codes.State.APPROACH, *BACK},
    codes.State.APPROACH: {codes.State.CONTACT, *BACK},
    codes.State.CONTACT: {codes.State.MEASURE, *BACK},
    codes.State.MEASURE: {codes.State.ALIGN, codes.State.CONTACT, codes.State.ENERGISE, codes.State.IDLE, *BACK},
    codes.State.ALIGN: {codes.State.CONTACT, *BACK},
    codes.State.ENERGISE: {codes.State.CHARGING, *BACK},
    codes.State.CHARGING: {codes.State.IDLE, *BACK},
    codes.State.RETRACT: {codes.State.IDLE},
}


@pytest.fixture(autouse=True, scope="module")
def short_phases() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(algorithm, "_LOCATE_TIMEOUT", LOCATE_TIMEOUT)
        patch.setattr(release, "RETRACT_TIMEOUT", RETRACT_TIMEOUT)
        yield


class Judge:
    """Checks every observation and command against the rules, without knowledge of the machine's internals."""

    def __init__(self) -> None:
        self.asked: dict[int, Service] = {}
        self.states = [codes.State.IDLE]
        self.closings = 0
        self._closed = False
        self._forget()

    def _forget(self) -> None:
        self.passed: list[clearance.Verdict] = []
        self.probed = False

    def observe(self, observation: Observation) -> None:
        """Store the machine's observation."""
        for reply in observation.replies:
            service = self.asked.pop(reply.number, None)
            if service is Service.ESTIMATE:
                self._judge_estimate(reply)
            elif service is Service.PROBE:
                self.probed = reply.success and math.isnan(reply.resistance) and 19.0 <= reply.target_voltage <= 29.4

    def _judge_estimate(self, reply: Reply) -> None:
        estimate = reply.estimate if reply.success else None
        good = estimate is not None and estimate.complete and estimate.sure and estimate.in_range and estimate.contact
        verdict = clearance.judge(estimate, LIMITS) if good and estimate is not None else None
        self.passed = (
            [*self.passed, verdict] if verdict in (clearance.Verdict.SAFE, clearance.Verdict.PROBABLY_SAFE) else []
        )

    def check_command(
        self, observation: Observation, command: Command, state: codes.State, contact_current: float
    ) -> None:
        """Check the machine's command."""
        if state is not self.states[-1]:
            assert state in LEGAL[self.states[-1]], f"{self.states[-1].name} → {state.name}"
            self.states.append(state)
        self.asked.update((request.number, request.service) for request in command.requests)
        if command.energise and not self._closed:
            self._check_closing(observation, contact_current)
            assert command.limits is not None
            assert (command.limits.current, command.limits.voltage, command.limits.dead) == (10.0, 29.4, False)
        if not command.energise and command.trajectory and self.states[-1] is not codes.State.RETRACT:
            self.probed = False  # a new contact needs a new probe
        if (self._closed and not command.energise) or self.states[-1] in (codes.State.ALIGN, codes.State.RETRACT):
            self._forget()
        self._closed = command.energise

    def _check_closing(self, observation: Observation, contact_current: float) -> None:
        self.closings += 1
        assert self.states[-1] is codes.State.ENERGISE
        assert observation.torque_enabled
        assert observation.hardware_error == 0
        assert observation.tactile_contact
        assert contact_current >= contact.CONTACT_LOST_CURRENT
        assert observation.servo_age <= LIMITS.live_servo_age_max
        assert observation.tactile_age <= LIMITS.age_max
        assert observation.power_age <= LIMITS.age_max
        assert LIMITS.battery_voltage_start <= observation.battery_voltage <= LIMITS.battery_voltage_max
        assert self.probed, "a good probe after the last motion"
        assert self.passed, "the last estimate before it leaves clearance"
        assert clearance.Verdict.SAFE in self.passed or len(self.passed) >= 2


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
    "least": lambda seen, source: replace(seen, least_current=source.choice((math.nan, -9.0, 0.0, 99.0))),
    "target": lambda seen, source: replace(seen, target_voltage=source.choice((math.nan, -24.0, 0.0, 12.0, 31.0))),
    "stage": lambda seen, source: replace(seen, stage_steps_up=False, stage_voltage=source.choice((math.nan, 30.0))),
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
    """A charger, the adversary and the judge."""

    def __init__(self, seed: int, spoiled: tuple[str, ...], rate: float) -> None:
        self.charger = quick_charger(parameters={"goal_timeout": GOAL_TIMEOUT}, coarse=True)
        self.machine, self.judge = self.charger.machine, Judge()
        self._source = random.Random(seed)
        self._spoiled, self._rate, self._left = spoiled, rate, 0
        self._how: Spoil = lambda seen, source: seen
        self._follow = self.charger._follow
        self.charger.distort, self.charger._follow = self._show, self._check  # type: ignore[method-assign]
        self.codes: list[codes.Code] = []

    def _show(self, seen: Observation) -> Observation:
        source = self._source
        if self._left <= 0 and self._spoiled and source.random() < self._rate:
            self._left = source.choice((1, 1, 2, 5, 40))
            self._how = SPOILS[source.choice(self._spoiled)]
        if self._left > 0:
            self._left -= 1
            seen = self._how(seen, source)
        self._seen = seen
        self.judge.observe(seen)
        return seen

    def _check(self, command: Command) -> None:
        status = self.machine.status
        self.judge.check_command(self._seen, command, status.state, status.contact_current)
        self._follow(command)

    def step(self) -> None:
        """One step of everything."""
        self.charger.tick()
        outcome, self.charger.outcome = self.charger.outcome, None
        if outcome is not None:
            assert outcome.success == (outcome.code is codes.Code.NONE)
            assert outcome.message
            self.codes.append(outcome.code)

    def goal(self, goal: DockGoal | None) -> None:
        """Send a goal, None = undock; refusals have codes too."""
        try:
            if goal is None:
                self.machine.start_undock("", self.charger.observe())
            else:
                self.charger.begin(goal)
        except codes.DockingError as error:
            self.codes.append(error.code)

    def finish(self) -> None:
        """Step until the goal has its outcome."""
        count, end = len(self.codes), self.charger.now + ENOUGH
        while len(self.codes) == count:
            assert self.charger.now < end, f"no outcome within {ENOUGH} s in {self.machine.status.state.name}"
            self.step()

    def settle(self) -> None:
        """Let the machine end its own actions without the adversary."""
        self._spoiled, self._left = (), 0
        quiet, end = 0, self.charger.now + ENOUGH
        while quiet < 20:
            assert self.charger.now < end, f"not at rest within {ENOUGH} s, {self.machine.status.state.name}"
            self.step()
            rests = self.machine.status.state is (codes.State.CHARGING if self.charger._energised else codes.State.IDLE)
            quiet = quiet + 1 if rests and not self.machine.busy else 0


ENOUGH = GOAL_TIMEOUT + RETRACT_TIMEOUT + 5.0  # s for a goal and the way home
ADVERSARIES = st.tuples(
    st.integers(0, 2**32),
    st.lists(st.sampled_from(sorted(SPOILS)), min_size=1, max_size=3, unique=True).map(tuple),
    st.sampled_from((0.0, 0.003, 0.02, 0.2)),
)
GOALS = st.builds(
    DockGoal,
    st.sampled_from((GOAL, None)),
    critical_angle=st.sampled_from((0.0, 0.0, 0.15)),
    start_charging=st.sampled_from((True, True, False)),
    stop_after=st.sampled_from((0.0, 1.0)),
    hold=st.just(False),
)
SETTINGS = settings(max_examples=100, suppress_health_check=[HealthCheck.too_slow])


def test_without_an_adversary_it_docks_charges_and_undocks() -> None:
    run = Run(1, (), 0.0)
    run.goal(DockGoal(None))
    run.finish()
    assert run.codes == [codes.Code.NONE]
    assert run.judge.closings == 1
    run.goal(None)
    run.finish()
    assert run.codes == [codes.Code.NONE, codes.Code.NONE]
    assert not run.charger.observe().torque_enabled


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
            run.finish()
        for _ in range(40):
            run.step()
    if undock:
        run.goal(None)
    run.settle()
