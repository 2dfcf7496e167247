# SPDX-License-Identifier: Apache-2.0
"""Lean that is known before contact, in virtual time: a sure lean beyond the limit is refused before anything moves."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import BasePose, DockGoal, DockingOutcome, ElectrodePose, Service
from deltacharger_lab.campaigns.virtual_charger import VirtualCharger

from .dockings import MILLIMETRE, charger

DEGREE = math.radians(1.0)
UNKNOWN = math.nan


def leaning(yaw: float, pitch: float, stddev: float = 0.5, age: float = 0.0) -> ElectrodePose:
    """Electrodes before the arm whose faces lean, in degrees."""
    return ElectrodePose(
        (0.002, 0.001, 0.080), 0.0, 0.004, age, yaw * DEGREE, pitch * DEGREE, stddev * DEGREE, stddev * DEGREE
    )


def dock_at(pose: ElectrodePose, seen: bool, **parameters: float) -> tuple[VirtualCharger, DockingOutcome]:
    """Dock at electrodes that the goal gives, or that the camera sees."""
    run = charger(parameters=parameters)
    run.answer[Service.DETECT] = lambda reply: replace(reply, detection=pose)
    return run, run.dock(DockGoal(None if seen else pose))


def assert_nothing_was_moved(run: VirtualCharger) -> None:
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE
    assert State.APPROACH not in run.states
    assert run.world.record.contacts == 0
    assert run.world.record.energised == 0.0


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize(("yaw", "side"), [(6.5, "left"), (-6.5, "right")])
def test_a_large_yaw_is_refused_before_moving_with_a_suggested_base_pose(yaw: float, side: str, seen: bool) -> None:
    pose = leaning(yaw, 0.0)
    run, outcome = dock_at(pose, seen)
    assert (outcome.code, outcome.retriable) == (Code.LEANING, False)
    for part in (f"yawed by {yaw:+.1f}°", "more than 5.0°", f"turn it by 6.5° to the {side}"):
        assert part in outcome.message
    assert_nothing_was_moved(run)
    base = outcome.suggested_base
    assert base is not None
    assert base.yaw == pose.yaw
    # From there the electrodes are straight ahead: R_y(yaw)ᵀ (electrodes − base).
    x, y, z = (a - b for a, b in zip(pose.position, (base.x, base.y, base.z), strict=True))
    sine, cosine = math.sin(base.yaw), math.cos(base.yaw)
    assert (cosine * x - sine * z, y, sine * x + cosine * z) == pytest.approx((0.0, 0.0, 0.080))


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize("yaw", [0.0, 9.0])
def test_a_large_pitch_is_refused_before_anything_moves_without_a_suggested_base_pose(yaw: float, seen: bool) -> None:
    run, outcome = dock_at(leaning(yaw, -6.5), seen)
    assert (outcome.code, outcome.retriable, outcome.suggested_base) == (Code.LEANING, False, None)
    for part in ("pitched by -6.5°", "more than 5.0°", "level the target or the charger", "floor", "suspension"):
        assert part in outcome.message
    assert_nothing_was_moved(run)


@pytest.mark.parametrize(
    ("pose", "refused"),
    [
        (leaning(5.9, 5.9), False),
        (leaning(6.1, 5.9), True),
        (leaning(5.9, 6.1), True),
        (leaning(-6.1, 0.0), True),
        (leaning(UNKNOWN, UNKNOWN), False),
        (leaning(12.0, 12.0, stddev=UNKNOWN), False),
        (leaning(12.0, 12.0, stddev=math.inf), False),
    ],
    ids=["within two sigmas", "yaw", "pitch", "to the right", "unknown", "of unknown error", "of endless error"],
)
def test_only_a_sure_lean_beyond_the_limits_is_refused_and_the_pads_check_the_rest(
    pose: ElectrodePose, refused: bool
) -> None:
    run, outcome = dock_at(pose, seen=True)
    if refused:
        assert outcome.code is Code.LEANING
        assert_nothing_was_moved(run)
    else:
        assert outcome.success, outcome


def test_the_parameter_sets_the_number_of_sigmas() -> None:
    assert dock_at(leaning(6.0, 0.0), True, lean_sigmas=0.0)[1].code is Code.LEANING
    assert dock_at(leaning(8.0, 0.0, stddev=1.0), True, lean_sigmas=4.0)[1].success


def test_the_suggested_base_pose_faces_electrodes_of_known_yaw_squarely() -> None:
    far = replace(leaning(8.0, 0.0), position=(0.0, 0.02, 0.5))
    _, outcome = dock_at(far, seen=True)
    assert outcome.code is Code.UNREACHABLE
    assert outcome.suggested_base == BasePose.before(far.position, far.yaw)
    assert "turn it by 8.0° to the left" in outcome.message
    assert outcome.suggested_base.electrodes == pytest.approx(far.position)
    _, outcome = dock_at(replace(far, yaw_stddev=math.nan), seen=True)
    assert outcome.suggested_base == BasePose(0.0, 0.02, 0.42, 0.0)


def test_a_stale_normal_is_not_judged() -> None:
    run, outcome = dock_at(leaning(9.0, 9.0, age=9.0), seen=True)
    assert outcome.code is Code.DETECTION_STALE
    assert_nothing_was_moved(run)
