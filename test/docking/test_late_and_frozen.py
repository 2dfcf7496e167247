# SPDX-License-Identifier: Apache-2.0
"""Late, double and repeated answers, and sensors that repeat their readings with new stamps.

A late answer belongs to the goal that requested it, or is dropped. Docking does not search for a frozen sensor, whose
readings may really be constant. This file shows the consequences: the push stays bounded, nothing is energised that
the other sensors do not confirm, and while current flows any two of the three inputs detect a target that leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import DockGoal, Observation, Reply, Request, Service
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_lab.campaigns.servo_load import Effort
from deltacharger_lab.campaigns.virtual_charger import GOAL

from .dockings import quick_charger
from .silences import Faulty

_PUSH_BOUND = 30.0  # N; limit by the servos' current bound at the dock, for any command


class Repeating(Faulty):
    """A charger that can delay answers, and repeat them in every following tick."""

    held: Service | None = None

    def __init__(self) -> None:
        super().__init__()
        self.echoes: list[Reply] = []
        self.twice = False
        self.asked: list[Request] = []

    def _accept(self, request: Request) -> None:
        self.asked.append(request)
        super()._accept(request)

    def _serve(self) -> None:
        super()._serve()
        asked = {request.number: request.service for request in self.asked}
        late = [reply for reply in self._replies if asked.get(reply.number) is self.held]
        if self.twice:
            self._replies += self.echoes
            self.echoes += [reply for reply in self._replies if reply not in self.echoes]
        elif late:
            self.echoes += late
            self._replies = [reply for reply in self._replies if reply not in late]


BAD = MisalignmentEstimate(math.radians(11.0), 0.001, 0.0, 0.0003, 0.0, 0.0003)


@pytest.mark.parametrize(
    ("service", "first", "own", "code"),
    [
        (Service.DETECT, Code.ELECTRODES_NOT_FOUND, {"success": False}, Code.ELECTRODES_NOT_FOUND),
        (Service.TORQUE_ON, Code.SERVO_FAULT, {"success": False}, Code.SERVO_FAULT),
        (Service.TARE, Code.TACTILE_STALE, {"success": False}, Code.TACTILE_STALE),
        (Service.ESTIMATE, Code.TACTILE_STALE, {"estimate": BAD}, Code.CRITICAL_ANGLE),
        (Service.PROBE, Code.POWER_STALE, {"resistance": 0.1}, Code.SHORT_CIRCUIT),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_an_answer_that_arrives_in_the_next_goal_is_ignored(
    service: Service, first: Code, own: dict[str, object], code: Code
) -> None:
    """The late answer is good and repeated in every tick of the next goal, whose own answer is bad."""
    run = Repeating()
    goal = DockGoal(None if service is Service.DETECT else GOAL)
    run.held = service
    assert run.dock(goal).code is first
    run.run(4.0)
    run.held = None
    run._torque = False  # as after manual handling, so that it is requested again
    assert run.echoes
    late = run.echoes
    run.distort = lambda observation, base=run.distort: replace(
        base(observation), replies=(*late, *observation.replies, *late)
    )
    run.answer[service] = lambda reply: replace(reply, message="out of order", **own)
    assert run.dock(goal).code is code
    run.assert_never_hurt()


def test_every_answer_twice_and_then_in_every_tick_changes_nothing() -> None:
    once, often = Repeating(), Repeating()
    often.twice = True
    outcomes = [run.dock(DockGoal(None)) for run in (once, often)]
    assert outcomes[0].success, outcomes[0].message
    assert outcomes[0] == outcomes[1]
    assert once.states == often.states
    assert once.undock().success
    assert often.undock().success
    assert [each.service for each in once.asked] == [each.service for each in often.asked], "nothing was repeated"


NOT_NOTICED = None


@pytest.mark.parametrize(
    ("phase", "servo", "pads", "power"),
    [
        (State.APPROACH, Code.NO_CONTACT, Code.NO_TACTILE_CONTACT, Code.NO_CHARGE_CURRENT),
        (State.CONTACT, Code.NO_CONTACT, Code.NO_TACTILE_CONTACT, Code.NO_CHARGE_CURRENT),
        (State.ALIGN, Code.NO_CONTACT, Code.NO_TACTILE_CONTACT, Code.NO_CHARGE_CURRENT),
        (State.ENERGISE, NOT_NOTICED, NOT_NOTICED, Code.NO_CHARGE_CURRENT),
        (State.CHARGING, NOT_NOTICED, NOT_NOTICED, NOT_NOTICED),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
@pytest.mark.parametrize("frozen", ["servo_state", "tactile_frame", "charger_power"])
def test_a_sensor_that_repeats_itself(
    phase: State, servo: Code | None, pads: Code | None, power: Code | None, frozen: str
) -> None:
    expected = {"servo_state": servo, "tactile_frame": pads, "charger_power": power}[frozen]
    run = Faulty()
    run.reach(phase)
    run.frozen = (frozen,)
    tick, push = run.tick, Effort(run)

    def watched() -> None:
        tick()
        push.look()

    run.tick = watched  # type: ignore[method-assign]
    run.run(5.0) if expected is None else run.until(lambda: run.outcome is not None, 60.0)
    if expected is not None:
        assert run.outcome is not None
        assert run.outcome.code is expected, run.outcome.message
        run.run(0.5)
        assert not run.closed
        assert not run.has_torque
    else:
        assert run.machine.status.charging, "not noticed, and nothing wrong: it charges as it did"
    assert push.most < _PUSH_BOUND
    run.assert_never_hurt()


def drag_off(run: Faulty) -> None:
    """Move the platform away from the target by force, as if the robot were rolled away."""
    home = run.machine.parameters.home
    run._follow = lambda command: run.plant.open_contactor(True) if not command.energise else None  # type: ignore[assignment]
    angles = run.machine._context.kinematics.inverse(*home)
    run._trajectory, run._started = (Waypoint(0.0, angles, (6.0, 6.0, 6.0)),), run.now


@pytest.mark.parametrize("frozen", ["", "servo_state", "tactile_frame", "charger_power"])
def test_one_frozen_sensor_does_not_hide_a_target_that_leaves(frozen: str) -> None:
    run = Faulty()
    run.reach(State.CHARGING)
    run.frozen = (frozen,)
    start = run.now
    drag_off(run)
    run.until(lambda: not run.closed, 1.0)
    assert run.now - start <= 0.35
    assert run.machine.status.code in (Code.NO_CONTACT, Code.NO_CHARGE_CURRENT, Code.OVERCURRENT)


def test_power_that_repeats_itself_as_closed_keeps_the_arm_where_it_is() -> None:
    """The contactor may still be closed: pulling could draw an arc."""
    run = Faulty()
    run.reach(State.CHARGING)
    run.frozen = ("charger_power",)
    assert run.undock().code is Code.CONTACTOR_WELDED
    assert not run.closed
    assert run.has_torque
    run.assert_never_hurt()


def test_pads_with_the_same_reading_everywhere_never_energise() -> None:
    """The first estimate, 6 mm off, answers every request: the arm follows it to its limit."""
    run = Faulty(landing_limit=0.0025, overlap_loss_max=0.004)
    felt: list[MisalignmentEstimate] = []

    def again(reply: Reply) -> Reply:
        assert reply.estimate is not None
        felt.append(felt[0] if felt else reply.estimate)
        return replace(reply, estimate=felt[0])

    answer: Callable[[Reply], Reply | None] = again
    run.answer[Service.ESTIMATE] = answer
    outcome = run.dock()
    assert len(felt) > 1
    ends = (Code.MISALIGNED, Code.UNREACHABLE, Code.NO_TACTILE_CONTACT, Code.NO_CONTACT, Code.ESTIMATE_UNSURE)
    assert outcome.code in ends, outcome
    assert State.ENERGISE not in run.states
    run.assert_never_hurt()


def test_an_immediate_next_goal_is_not_misled_by_a_servo_state_from_before_torque_off() -> None:
    run = quick_charger()
    seen: list[bool] = []

    def late(observation: Observation) -> Observation:
        seen.append(observation.torque_enabled)
        return replace(observation, torque_enabled=seen[max(len(seen) - 6, 0)])  # six ticks old

    run.distort = late
    for _ in range(2):
        assert run.dock(DockGoal(GOAL, start_charging=False)).success
        assert run.undock().success
