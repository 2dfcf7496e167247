# SPDX-License-Identifier: Apache-2.0
"""The judge of hostile dockings: each check on a case that breaks its law, and on one that does not."""

import math
import random
from types import SimpleNamespace
from typing import Any

import pytest

from deltacharger_lab.campaigns.judge import LAWS, WorldJudge, broken, lies_wrong, nothing
from deltacharger_sim.circuit import Overlap
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.world import World

LEVEL = (0.0, 0.0, 0.0)
GOOD: dict[str, Any] = nothing() | {
    "code_name": "NONE",
    "ended": "",
    "undocked": "NONE",
    "error": "",
    "allowed": "NONE SERVO_FAULT STUCK",
    "next_code": "NONE",
    "goals": 3,
    "outcomes": 3,
    "outside": 0.004,
    "push_over": 0.09,
    "live_unsafe": 0.01,
    "live_short": 0.0,
    "live_apart": 0.01,
}


def world(
    *,
    place: tuple[float, float, float] = (0.0, 0.0, 0.08),
    touches: bool = True,
    pose: tuple[float, float, float] | None = LEVEL,
    closed: bool = False,
    current: float = 0.0,
    gap: float = 0.0,
    time: float = 1.0,
) -> Any:
    """Return a hand-made world."""
    mechanics = SimpleNamespace(position=place, contact_force=60.0 if touches else 0.0, gap=gap)
    circuit = SimpleNamespace(closed=closed, current=current)
    pose = pose if touches else None
    return SimpleNamespace(mechanics=mechanics, circuit=circuit, misalignment=pose, time=time)


def judged(*worlds: Any, excuses: list[tuple[float, float]] | None = None) -> dict[str, float]:
    """Return what a judge found in these steps of 10 ms."""
    judge = WorldJudge()
    judge.excuses = excuses or []
    for each in worlds:
        judge.look(each, 0.01)
    return judge.found


@pytest.mark.parametrize(
    ("pose", "wrong"),
    [
        ((0.0, 0.0073, 0.0), False),
        ((0.0, 0.0075, 0.0), True),
        ((0.0, 0.0, math.radians(12.0)), False),
        ((0.0, 0.0, math.radians(-12.2)), True),
    ],
)
def test_bars_lie_wrong_where_the_terminal_says(pose: tuple[float, float, float], wrong: bool) -> None:
    assert lies_wrong(pose)[0] is wrong


def test_polygons_agree_with_the_simulations() -> None:
    source = random.Random(3)
    found = set()
    for _ in range(800):
        pose = source.uniform(-0.03, 0.03), source.uniform(-0.012, 0.012), source.uniform(-0.3, 0.3)
        lies = Overlap(*pose)
        wrong, short = lies_wrong(pose)
        assert wrong is (lies.clearance < 0.0)
        assert short is lies.short
        found.add((wrong, short))
    assert {(False, False), (True, True)} <= found


@pytest.mark.parametrize(
    ("place", "outside"),
    [((0.0, 0.0, 0.08), 0.0), ((0.07, 0.0, 0.08), 0.01), ((0.0, -0.063, 0.08), 0.003), ((0.0, 0.0, -0.002), 0.002)],
)
def test_the_box_is_the_published_one(place: tuple[float, float, float], outside: float) -> None:
    assert judged(world(place=place))["outside"] == pytest.approx(outside)


@pytest.mark.parametrize(("limit", "over"), [(0.9, False), (1.5, True)])
def test_the_push_counts_above_its_bound(limit: float, over: bool) -> None:
    real, judge = World(WorldParameters(target=TargetParameters(z=0.0))), WorldJudge()
    for index in range(3):
        real.command(index, True, 0.6, limit)
    for _ in range(60):
        real.step(0.01)
        judge.look(real, 0.01)
    assert (judge.found["push_over"] > 0.1) is over
    assert over or judge.found["push_over"] == 0.0


def test_live_electrodes_without_clearance_count_outside_the_excuses() -> None:
    askew = world(pose=(0.0, 0.009, 0.0), closed=True)
    assert judged(world(closed=True), world(pose=(0.0, 0.009, 0.0)))["live_unsafe_all"] == 0.0
    found = judged(askew, askew)
    assert (found["live_unsafe"], found["live_short"]) == pytest.approx((0.02, 0.02))
    found = judged(askew, world(pose=(0.0, 0.009, 0.0), closed=True, time=1.2), excuses=[(0.9, 1.05)])
    assert (found["live_unsafe"], found["live_unsafe_all"]) == pytest.approx((0.01, 0.02))


def test_parting_and_touching_while_live_count() -> None:
    lies, away = world(closed=True, current=8.0), world(closed=True, touches=False, gap=0.01)
    found = judged(world(), lies, away, away)
    assert (found["live_apart"], found["left_live"], found["touched_live"]) == (pytest.approx(0.02), 1, 0)
    assert judged(world(), lies, away, excuses=[(0.9, 1.05)])["left_live"] == 0
    found = judged(world(), lies, away, lies)
    assert found["touched_live"] == 1
    assert judged(world(), lies, away, lies, excuses=[(0.9, 1.05)])["touched_live"] == 0
    bounce = world(closed=True, touches=False, gap=0.0005)
    assert judged(world(), lies, bounce, lies)["touched_live"] == 0
    found = judged(world(touches=False, gap=0.01), world(), lies, world(), world(touches=False, gap=0.01))
    assert (found["live_apart_all"], found["touched_live"], found["left_live"]) == (0.0, 0, 0)


@pytest.mark.parametrize(
    ("between", "then", "count"),
    [
        (None, LEVEL, 0),
        (None, (0.001, 0.0005, 0.01), 0),
        (None, (0.0, 0.002, 0.0), 1),
        (None, (0.0, 0.0, 0.05), 1),
        (world(touches=False, gap=0.005), LEVEL, 1),
        (world(touches=False, gap=0.0003), LEVEL, 0),
    ],
)
def test_closing_needs_an_estimate_of_this_contact(between: Any, then: Any, count: int) -> None:
    judge = WorldJudge()
    judge.look(world(), 0.01)
    judge.measured(world())
    if between is not None:
        judge.look(between, 0.01)
    judge.closing(world(pose=then))
    assert judge.found["closed_unmeasured"] == count


@pytest.mark.parametrize(
    ("changes", "law"),
    [
        ({}, ""),
        ({"code_name": "CRASHED", "error": "Traceback\nZeroDivisionError: x"}, "crashed"),
        ({"code_name": "CRASHED", "error": "Traceback\nTimeoutError: no outcome"}, "outcome"),
        ({"outcomes": 4}, "outcome"),
        ({"code_name": "OVERCURRENT"}, "code"),
        ({"undocked": "TIMEOUT"}, "code"),
        ({"undocked": "STUCK"}, ""),
        ({"next_code": "CRITICAL_ANGLE"}, "next"),
        ({"next_code": "NO_CONTACT", "ended": "SERVO_FAULT"}, ""),
        ({"outside": 0.006}, "box"),
        ({"push_over": 0.11}, "push"),
        ({"closed_unmeasured": 1}, "unmeasured"),
        ({"live_unsafe": 0.02}, "clearance"),
        ({"live_short": 0.02}, "short"),
        ({"live_apart": 0.02}, "apart"),
        ({"touched_live": 1}, "touched"),
        ({"left_live": 1}, "lifted"),
        ({"probed_live": 1}, "probed"),
    ],
)
def test_each_law_is_broken_alone(changes: dict[str, Any], law: str) -> None:
    assert broken({**GOOD, **changes}, ["NONE", "LEANING"]) == ([law] if law else [])


def test_every_law_has_a_case_that_breaks_it() -> None:
    cases = {law for _, law in test_each_law_is_broken_alone.pytestmark[0].args[1] if law}
    assert cases == set(LAWS)
