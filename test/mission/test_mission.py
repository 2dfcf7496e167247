# SPDX-License-Identifier: Apache-2.0
"""Laws of a mission, in virtual time: it ends with a code, undocks before it drives, and returns home if possible."""

import math
from typing import Any

import pytest
from hypothesis import given, settings, strategies as st

from deltacharger_core.frames import Pose, composed
from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_docking.codes import Busy, Canceled, Code, Rejected, State
from deltacharger_docking.mission import dialogue, machine, parameters, places
from deltacharger_docking.observation import BasePose, ElectrodePose

from .missions import (
    FORWARD,
    HOME,
    TARGET,
    Answer,
    Truth,
    World,
    drive,
    ends,
    fails,
    in_turn,
    silent,
    squarely,
    undock,
)

QUICK = parameters.MissionParameters(
    home_x=HOME.x,
    home_y=HOME.y,
    home_yaw=HOME.yaw,
    drive_timeout=60.0,
    charge_timeout=300.0,
)
ROUND = machine.SEARCH_TIMEOUT + 60.0 + machine.DOCK_TIMEOUT + 300.0 + 2 * (machine.UNDOCK_TIMEOUT + 1.0)
LONGEST = 10.0 + (machine.MOVES_MAX + 3) * ROUND + 2 * machine.CANCEL_TIMEOUT + 2 * 60.0
"""Longest time (s) of a mission with QUICK: a search, a move, a docking and two undockings for each move and each
renewed docking, and the final steps."""

angles = st.floats(-math.pi, math.pi)


def quick(answers: dict[dialogue.Task, Answer] | None = None, truth: Truth | None = None, drives: bool = True) -> World:
    return World(truth, QUICK, drives, answers)


def level_mount(heading: float, x: float, y: float, z: float) -> Pose:
    """Return base_pose of a charger_base whose z axis points to `heading`, its y axis up."""
    return composed((x, y, z, 0.0, 0.0, math.sin(0.5 * heading), math.cos(0.5 * heading)), FORWARD)


def test_a_mission_drives_searches_docks_charges_undocks_and_returns() -> None:
    world = quick()
    outcome = world.run(dialogue.MissionGoal(TARGET, stop_energy=1000.0))
    assert outcome.success, outcome
    assert (outcome.code, outcome.returned) == (Code.NONE, True)
    wait, drive, search, dock, charge, undock, home = dialogue.Stage
    assert world.stages == [wait, drive, search, drive, search, dock, charge, undock, home]
    assert world.base.distance(HOME) < 1e-9
    assert [request.task for request in world.requests[-3:]] == [
        dialogue.Task.DOCK,
        dialogue.Task.UNDOCK,
        dialogue.Task.DRIVE,
    ]
    assert world.requests[-3].goal == dialogue.MissionGoal(TARGET, stop_energy=1000.0)


@settings(max_examples=5)
@given(
    heading=angles,
    offset=st.tuples(*[st.floats(-0.5, 0.5)] * 2, st.floats(0.0, 0.5)),
    facing=angles,
    shift=st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05)),
    # Errors of 0.01 m each way and of 0.03 rad at 0.79 m from the base's centre are within REACH.
    miss=st.tuples(st.floats(-0.01, 0.01), st.floats(-0.01, 0.01), st.floats(-0.03, 0.03)),
)
def test_it_docks_with_any_mount_of_the_arm_and_any_direction_of_the_target(
    heading: float,
    offset: tuple[float, float, float],
    facing: float,
    shift: tuple[float, float],
    miss: tuple[float, float, float],
) -> None:
    """The target is not exactly at its given place, and the navigator stops near its goals and reports it."""
    given = places.Place(2.0, 1.0, facing)
    truth = Truth(given.at(*shift), offset[2], miss, level_mount(heading, *offset))
    world = quick(truth=truth)
    outcome = world.run(dialogue.MissionGoal(given))
    assert outcome.success, (outcome, world.stages)
    world.base, believed = world.bases[-1], world.believed[-1]
    assert believed is not None
    assert believed.distance(world.base) < 1e-6, "it uses the place reported by the navigator"
    x, y, z = world.seen().position
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.04)
    assert z == pytest.approx(DOCK_DISTANCE, abs=0.04)
    assert world.machine.status.moves <= machine.MOVES_MAX


def test_a_mount_that_faces_the_ground_or_is_not_a_pose_is_refused() -> None:
    for pose in ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), (0.0,) * 7, (math.nan, *FORWARD[1:]), FORWARD[:6]):
        with pytest.raises(ValueError, match="base_pose"):
            places.BaseMount(pose)


def test_electrodes_beside_the_first_view_are_found_from_another() -> None:
    world = quick(truth=Truth(TARGET.at(0.0, 0.25)))
    outcome = world.run()
    assert outcome.success, outcome
    assert world.machine.status.views > 2


FIVE = math.radians(5.0)
SIDEWAYS = level_mount(-2.0, 0.2, -0.1, 0.0)
"""A charger_base that points back and to the right."""
# y along the ground, to the robot's right: so a turn of the robot is a pitch
ON_ITS_SIDE = (0.0, 0.0, 0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)


@pytest.mark.parametrize(
    ("mount", "yaw"), [(FORWARD, FIVE), (SIDEWAYS, -FIVE), (level_mount(2.0, 0.0, 0.1, 0.0), FIVE), (ON_ITS_SIDE, FIVE)]
)
def test_a_target_detected_askew_is_faced_squarely_after_one_move(mount: Pose, yaw: float) -> None:
    """The mission's own search finds it: docking is called once, after the usual move."""
    world = quick(truth=Truth(TARGET.at(0.0, 0.0, yaw), mount=mount, lean_stddev=0.01))
    outcome = world.run()
    assert outcome.success, outcome
    assert (world.machine.status.moves, len(world.bases)) == (1, 1)
    world.base = world.bases[0]
    assert (world.seen().yaw, world.seen().pitch) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert world.seen().position == pytest.approx((0.0, 0.0, DOCK_DISTANCE), abs=1e-9)


@pytest.mark.parametrize(
    ("mount", "yaw", "code"), [(FORWARD, 2.0 * FIVE, Code.LEANING), (SIDEWAYS, -2.0 * FIVE, Code.UNREACHABLE)]
)
def test_the_robot_takes_a_suggested_base_pose_with_its_heading(yaw: float, mount: Pose, code: Code) -> None:
    """The search reports no lean, so the robot faces the target as given until docking reports the error."""
    world = quick({dialogue.Task.DOCK: squarely(FIVE, code)}, Truth(TARGET.at(0.0, 0.0, yaw), mount=mount))
    outcome = world.run()
    assert outcome.success, outcome
    assert (world.machine.status.moves, len(world.bases)) == (2, 2), "to dock at all, and once more"
    world.base = world.bases[0]
    assert world.seen().yaw == pytest.approx(yaw), "+y points up: a target that is turned to the left is yawed by +"
    world.base = world.bases[1]
    assert world.seen().yaw == pytest.approx(0.0, abs=1e-9)
    assert world.seen().position == pytest.approx((0.0, 0.0, DOCK_DISTANCE), abs=1e-9)


def leaning(base: BasePose | None) -> Answer:
    return ends(dialogue.End.FAILED, "askew", 0.2, code=Code.LEANING, suggested=base)


def not_home(world: World, request: dialogue.TaskRequest) -> Any:
    return (ends(dialogue.End.FAILED) if request.place == HOME else drive)(world, request)


BLOCKED = ends(dialogue.End.FAILED, "blocked")
FOR_EVER = fails(Code.INTERNAL, after=1e6, charging=True)
WAY_HOME = [dialogue.Stage.UNDOCK, dialogue.Stage.RETURN]
VIEWS = (places.SEARCH_STEPS + 1) * (2 * places.SEARCH_TURNS + 1)
ENDS: list[tuple[dict[dialogue.Task, Answer], Code, bool, bool, list[dialogue.Stage], str]] = [
    # answers, code, retriable, returned, last stages, a word of the message
    (
        {dialogue.Task.DETECT: ends(dialogue.End.FAILED, "no electrodes")},
        Code.ELECTRODES_NOT_FOUND,
        True,
        True,
        [dialogue.Stage.RETURN],
        "no elec",
    ),
    ({dialogue.Task.DOCK: fails(Code.CRITICAL_ANGLE)}, Code.CRITICAL_ANGLE, False, True, WAY_HOME, "CRITICAL_ANGLE"),
    ({dialogue.Task.DOCK: leaning(None)}, Code.LEANING, False, True, [dialogue.Stage.RETURN], "askew"),
    (
        {dialogue.Task.DRIVE: ends(dialogue.End.REFUSED)},
        Code.REJECTED,
        False,
        False,
        [dialogue.Stage.DRIVE, dialogue.Stage.RETURN],
        "then",
    ),
    (
        {dialogue.Task.DRIVE: BLOCKED},
        Code.UNREACHABLE,
        True,
        False,
        [dialogue.Stage.DRIVE, dialogue.Stage.RETURN],
        "then",
    ),
    (
        {dialogue.Task.DRIVE: ends(dialogue.End.LOST)},
        Code.TIMEOUT,
        True,
        False,
        [dialogue.Stage.DRIVE, dialogue.Stage.RETURN],
        "then",
    ),
    ({dialogue.Task.DRIVE: silent}, Code.TIMEOUT, True, False, [dialogue.Stage.DRIVE, dialogue.Stage.RETURN], "60 s"),
    (
        {dialogue.Task.DRIVE: in_turn(drive, BLOCKED, drive)},
        Code.UNREACHABLE,
        True,
        True,
        [dialogue.Stage.RETURN],
        "blocked",
    ),
    ({dialogue.Task.DRIVE: not_home}, Code.UNREACHABLE, False, False, WAY_HOME, "charged"),
    (
        {dialogue.Task.DETECT: silent},
        Code.ELECTRODES_NOT_FOUND,
        True,
        True,
        [dialogue.Stage.RETURN],
        "detect_electrodes",
    ),
    ({dialogue.Task.DOCK: silent}, Code.TIMEOUT, True, True, WAY_HOME, "660 s"),
    ({dialogue.Task.DOCK: FOR_EVER}, Code.TIMEOUT, True, True, WAY_HOME, "300 s"),
    ({dialogue.Task.UNDOCK: fails(Code.STUCK, True)}, Code.STUCK, False, False, [dialogue.Stage.UNDOCK], "stays"),
    ({dialogue.Task.UNDOCK: silent}, Code.TIMEOUT, False, False, [dialogue.Stage.UNDOCK], "60 s"),
    ({dialogue.Task.UNDOCK: in_turn(fails(Code.STUCK, True), undock)}, Code.NONE, False, True, WAY_HOME, ""),
    (  # the first error is kept, and the later one reported
        {dialogue.Task.DOCK: fails(Code.CRITICAL_ANGLE), dialogue.Task.UNDOCK: fails(Code.STUCK)},
        *(Code.CRITICAL_ANGLE, False, False, [dialogue.Stage.UNDOCK], "STUCK"),
    ),
]


@pytest.mark.parametrize(("answers", "code", "retriable", "returned", "last", "word"), ENDS)
def test_a_mission_ends_with_the_code_of_its_first_error_and_if_possible_at_home(
    answers: dict[dialogue.Task, Answer],
    code: Code,
    retriable: bool,
    returned: bool,
    last: list[dialogue.Stage],
    word: str,
) -> None:
    world = quick(answers)
    outcome = world.run()
    assert (outcome.success, outcome.code, outcome.returned) == (code is Code.NONE, code, returned), outcome
    assert outcome.retriable is retriable, outcome
    assert word in outcome.message
    assert world.stages[-len(last) :] == last
    assert (world.base == HOME) is returned
    asked = [request.task for request in world.requests]
    if word == "stays":
        assert asked.count(dialogue.Task.UNDOCK) == machine.UNDOCK_ATTEMPTS
    if code is Code.ELECTRODES_NOT_FOUND and dialogue.Task.DOCK not in asked:
        assert world.machine.status.views in (1, VIEWS)


@pytest.mark.parametrize(
    ("base", "moves"),
    [
        (BasePose(0.0, 0.0, 0.0, 0.2), machine.MOVES_MAX),
        (BasePose.before((0.0, 0.0, DOCK_DISTANCE), 0.9 * machine.GAIN_TURN_MIN), 1),
    ],
    ids=["always askew", "a turn that is not worth it"],
)
def test_leaning_ends_the_mission_if_no_move_is_left_or_would_help(base: BasePose, moves: int) -> None:
    world = quick({dialogue.Task.DOCK: leaning(base)})
    outcome = world.run()
    assert (outcome.code, outcome.retriable, outcome.returned) == (Code.LEANING, False, True)
    assert (world.machine.status.moves, len(world.bases)) == (moves, moves)


@pytest.mark.parametrize("stage", list(dialogue.Stage))
def test_a_cancel_undocks_and_returns_but_during_the_return_it_stops(stage: dialogue.Stage) -> None:
    world = quick()
    if stage is dialogue.Stage.WAIT:
        world.served.discard(dialogue.Task.DOCK)
    outcome = world.run(cancel_in=stage)
    assert (outcome.success, outcome.code) == (False, Code.CANCELED), outcome
    assert not world.attached
    assert outcome.returned is (stage not in (dialogue.Stage.WAIT, dialogue.Stage.RETURN))
    assert (world.base == HOME) is outcome.returned
    assert outcome.retriable is (stage not in (dialogue.Stage.UNDOCK, dialogue.Stage.RETURN)), (
        "what is charged is not charged again"
    )
    if stage in (dialogue.Stage.DOCK, dialogue.Stage.CHARGE):
        assert world.stages[-2:] == [dialogue.Stage.UNDOCK, dialogue.Stage.RETURN]


def rests(after: float) -> Answer:
    """Return docking without a contactor (power: none): it rests on the target and measures no current."""

    def answer(world: World, request: dialogue.TaskRequest) -> Any:
        world.attached, world.docking = True, dialogue.DockingReport(State.IDLE, docked=True)
        return ends(dialogue.End.DONE, "it hangs on the battery", after)(world, request)

    return answer


def test_an_unmeasured_charge_is_not_claimed_and_has_the_time_limit_of_charging() -> None:
    world = quick({dialogue.Task.DOCK: rests(200.0)})
    outcome = world.run()
    assert (outcome.success, outcome.returned) == (True, True)
    assert dialogue.Stage.CHARGE not in world.stages
    assert "charged" not in outcome.message
    assert outcome.notice == "it hangs on the battery"
    outcome = quick({dialogue.Task.DOCK: rests(400.0)}).run()
    assert (outcome.code, outcome.returned) == (Code.TIMEOUT, True)
    assert "300 s" in outcome.message


@pytest.mark.parametrize("task", list(dialogue.Task))
def test_missing_nodes_are_named_before_anything_moves(task: dialogue.Task) -> None:
    world = quick()
    world.served.discard(task)
    outcome = world.run()
    assert (outcome.code, outcome.retriable, outcome.returned) == (Code.REJECTED, True, False)
    assert task.value in outcome.message
    assert world.requests == []


@pytest.mark.parametrize(
    "docking",
    [
        dialogue.DockingReport(State.CHARGING, True, True),
        dialogue.DockingReport(State.IDLE, True),
        dialogue.DockingReport(State.APPROACH),
        None,
    ],
)
def test_a_docked_charger_is_not_driven(docking: dialogue.DockingReport | None) -> None:
    world = quick()
    world.docking = docking
    outcome = world.run()
    assert (outcome.code, outcome.retriable) == (Code.REJECTED, True)
    assert world.requests == []


def test_a_second_mission_and_impossible_goals_are_refused() -> None:
    world = quick()
    observation = world._observe(())
    wrong = (
        dialogue.MissionGoal(TARGET, stop_energy=math.nan),
        dialogue.MissionGoal(TARGET, stop_after=-1.0),
        dialogue.MissionGoal(None),
    )
    for busy in (False, True):
        assert world.machine.busy is busy
        for goal in wrong:
            with pytest.raises(Rejected) as caught:
                world.machine.start(goal, observation)
            assert not caught.value.retriable, "it can never be served"
        if not busy:
            world.machine.start(dialogue.MissionGoal(TARGET), observation)
    with pytest.raises(Busy) as caught:
        world.machine.start(dialogue.MissionGoal(TARGET), observation)
    assert caught.value.retriable


def test_a_stationary_charger_waits_for_its_target_and_does_not_drive() -> None:
    there = ElectrodePose((0.0, 0.0, 0.08), 0.0)
    comes = in_turn(
        *[ends(dialogue.End.FAILED, "nothing", 0.1)] * 5, ends(dialogue.End.DONE, after=0.1, electrodes=there)
    )
    world = quick({dialogue.Task.DETECT: comes}, drives=False)
    world.base = places.BaseMount(FORWARD).before(TARGET, DOCK_DISTANCE)
    outcome = world.run(dialogue.MissionGoal(None))
    assert (outcome.success, outcome.returned) == (True, True), outcome
    assert world.stages == [
        dialogue.Stage.WAIT,
        dialogue.Stage.SEARCH,
        dialogue.Stage.DOCK,
        dialogue.Stage.CHARGE,
        dialogue.Stage.UNDOCK,
    ]
    assert all(request.task is not dialogue.Task.DRIVE for request in world.requests)


def test_a_stationary_charger_gives_up_in_time_and_suggests_a_base_pose() -> None:
    world = quick({dialogue.Task.DETECT: ends(dialogue.End.FAILED, "nothing")}, drives=False)
    outcome = world.run(dialogue.MissionGoal(None), limit=machine.SEARCH_TIMEOUT + 30.0)
    assert (outcome.code, outcome.returned) == (Code.ELECTRODES_NOT_FOUND, True)
    world = quick(drives=False)
    world.base = places.BaseMount(FORWARD).before(TARGET, 0.3)
    outcome = world.run(dialogue.MissionGoal(None))
    assert (outcome.code, outcome.returned) == (Code.UNREACHABLE, True)


@pytest.mark.parametrize(
    ("task", "again"), [(dialogue.Task.DRIVE, True), (dialogue.Task.DOCK, True), (dialogue.Task.UNDOCK, False)]
)
def test_an_emergency_cancels_open_requests_and_ends_the_goal_with_its_time(task: dialogue.Task, again: bool) -> None:
    """A charged target needs no second mission."""
    world = quick()
    world.machine.start(dialogue.MissionGoal(TARGET), world._observe(()))
    while task not in [request.task for request in world.requests]:
        world.step()
    assert world.machine.emergency().cancels == (world.requests[-1].number,)
    assert not world.machine.busy
    outcome = world.machine.ended_by(Canceled("mission_node was shut down"), world.time + 1.0)
    assert (outcome.code, outcome.retriable, outcome.returned) == (Code.CANCELED, again, False)
    assert outcome.elapsed == pytest.approx(world.machine.status.elapsed + 1.0)
    assert outcome.elapsed > 1.0


WAYS = ("done",) * 12 + ("failed", "retriable", "refused", "canceled", "lost", "silent")


def _drawn(draw: st.DataObject) -> Answer:
    """Return a server whose answers are drawn at random."""

    def answer(world: World, request: dialogue.TaskRequest) -> tuple[float, dialogue.TaskReply] | None:
        way = draw.draw(st.sampled_from(WAYS))
        after = draw.draw(st.sampled_from((0.0, 1.0, 15.0)))
        if request.task is dialogue.Task.DOCK:
            stage = draw.draw(st.sampled_from((State.APPROACH, State.CONTACT, State.CHARGING)))
            world.attached = stage is not State.APPROACH
            charging = stage is State.CHARGING
            world.docking = dialogue.DockingReport(stage, charging, charging)
        if way == "silent":
            return None
        ending = {
            "done": dialogue.End.DONE,
            "refused": dialogue.End.REFUSED,
            "canceled": dialogue.End.CANCELED,
            "lost": dialogue.End.LOST,
        }
        end = ending.get(way, dialogue.End.FAILED)
        code = Code.NONE if end is dialogue.End.DONE else draw.draw(st.sampled_from([c for c in Code if c]))
        yaw = draw.draw(st.sampled_from((0.0, 0.1, -3.0)))
        suggested = BasePose(0.1, 0.0, 0.05, yaw) if code in (Code.UNREACHABLE, Code.LEANING) else None
        seen = ElectrodePose((0.05, 0.0, 0.09), 0.0, yaw=yaw, yaw_stddev=0.01)
        electrodes = seen if request.task is dialogue.Task.DETECT and end is dialogue.End.DONE else None
        return after, dialogue.TaskReply(
            request.number, end, code, way, way == "retriable", electrodes=electrodes, suggested=suggested
        )

    return answer


@settings(max_examples=25)
@given(st.data(), st.one_of(st.none(), st.integers(0, 3000)), st.booleans())
def test_a_mission_ends_in_time_with_a_code_for_any_answers(
    data: st.DataObject, cancel_at: int | None, drives: bool
) -> None:
    """World asserts at each drive that nothing holds the robot; here: an end, a code, bounds, a true `returned`."""
    world = quick(dict.fromkeys(dialogue.Task, _drawn(data)), drives=drives)
    start = world.time
    world.machine.start(dialogue.MissionGoal(TARGET if drives else None), world._observe(()))
    ticks = 0
    while world.machine.outcome is None:
        world.step()
        ticks += 1
        if ticks == cancel_at:
            world.machine.cancel()
        assert world.time - start < LONGEST
    outcome, status = world.machine.outcome, world.machine.status
    assert outcome.success is (outcome.code is Code.NONE)
    assert outcome.code in set(Code)
    assert outcome.message
    assert status.moves <= machine.MOVES_MAX
    assert status.views <= (machine.MOVES_MAX + 1) * VIEWS or not drives
    docks = sum(request.task is dialogue.Task.DOCK for request in world.requests)
    assert docks <= machine.MOVES_MAX + 1
    if outcome.returned:
        assert not world.attached
        assert not drives or world.base.distance(HOME) < 1e-9
    if outcome.success:
        assert docks
        assert outcome.returned
