# SPDX-License-Identifier: Apache-2.0
"""Targets whose faces lean, in virtual time: which are charged, and which are refused with a remedy."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from deltacharger_docking.codes import Code
from deltacharger_docking.observation import DockGoal, DockingOutcome
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.quick_charger import QuickCharger
from deltacharger_lab.campaigns.virtual_charger import GOAL
from deltacharger_sim.parameters import ContactParameters, PlatformParameters, TargetParameters, WorldParameters
from deltacharger_tactile.source import ContactSource

from .dockings import MILLIMETRE, assert_safe_at_home

STIFF = 1e6  # N/m; softer bars both press in spite of 2° of pitch


def leaning(
    place: tuple[float, float, float],
    yaw: float = 0.0,
    pitch: float = 0.0,
    compliance: float = 0.02,
    stiffness: float = 1e5,
    seed: int = 1,
) -> QuickCharger:
    """A charger whose target differs from the goal's by (mm, mm, degrees) and leans, in degrees."""
    x, y, roll = place
    target = TargetParameters(
        x=x * MILLIMETRE,
        y=y * MILLIMETRE,
        roll=math.radians(roll),
        tilt_x=math.radians(pitch),
        tilt_y=math.radians(yaw),
    )
    contact, platform = ContactParameters(stiffness=stiffness), PlatformParameters(compliance=compliance)
    world = WorldParameters(target=target, contact=contact, platform=platform)
    docking = DockingParameters(servo_stiffness=world.servo.stiffness)
    return QuickCharger(world, docking, ContactSource(None, 900, seed), seed, 900)


def dock(run: QuickCharger, pitch: float = math.nan) -> DockingOutcome:
    """Dock at the goal's place; `pitch` (degrees) as a camera measures it within 0.5°."""
    stddev = math.radians(0.5) if math.isfinite(pitch) else math.nan
    return run.dock(DockGoal(replace(GOAL, pitch=math.radians(pitch), pitch_stddev=stddev)))


@pytest.mark.parametrize("yaw", [2.0, -2.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_faces_yawed_by_two_degrees_are_charged_and_aligned_only_within_the_overlap(yaw: float, seed: int) -> None:
    run = leaning((2.0, -1.0, 2.0), yaw=yaw, seed=seed)
    outcome = dock(run)
    assert outcome.success, outcome.message
    truth = run.world.misalignment
    assert truth is not None
    if outcome.aligned:
        assert abs(truth[0]) < run.parameters.overlap_loss_max
    assert abs(truth[1] * math.cos(truth[2]) - truth[0] * math.sin(truth[2])) < run.parameters.landing_limit
    felt = outcome.estimate
    assert felt is not None
    assert math.copysign(1.0, felt.yaw) == math.copysign(1.0, yaw)
    assert abs(felt.yaw - math.radians(yaw)) < 3.0 * felt.yaw_stddev
    assert abs(felt.horizontal - truth[0]) < 3.0 * felt.horizontal_stddev
    assert run.world.record.energised_shorts == run.world.record.lifted_live == 0


@pytest.mark.parametrize(("place", "yaw"), [((2.0, -1.0, 2.0), 5.0), ((-2.0, 1.0, -3.0), -5.0)])
def test_a_yaw_that_empties_a_pad_ends_with_its_angle_and_a_suggested_base_pose(
    place: tuple[float, float, float], yaw: float
) -> None:
    run = leaning(place, yaw=yaw, compliance=0.01)
    outcome = dock(run)
    assert (outcome.code, outcome.retriable) == (Code.LEANING, False)
    base = outcome.suggested_base
    assert base is not None
    assert math.copysign(1.0, base.yaw) == math.copysign(1.0, yaw)
    assert math.radians(2.0) < abs(base.yaw) < math.radians(6.0)
    assert f"yawed by {math.degrees(base.yaw):+.1f}° or more" in outcome.message
    assert run.world.record.energised == 0.0
    assert_safe_at_home(run)


@pytest.mark.parametrize("compliance", [0.0, 0.005])
@pytest.mark.parametrize("pitch", [2.0, -2.0])
@pytest.mark.parametrize(("camera", "code"), [(False, Code.NO_CHARGE_CURRENT), (True, Code.LEANING)])
def test_a_pitch_that_lifts_a_bar_is_never_energised_and_reported_if_a_camera_saw_it(
    camera: bool, code: Code, pitch: float, compliance: float
) -> None:
    run = leaning((1.0, 0.0, 1.0), pitch=pitch, compliance=compliance, stiffness=STIFF)
    outcome = dock(run, pitch if camera else math.nan)
    assert outcome.code is code, outcome.message
    assert "open circuit" in outcome.message
    assert (f"pitched by {pitch:+.1f}°" in outcome.message) is camera
    assert outcome.suggested_base is None, "no stand mends a pitch"
    assert run.world.record.contacts > 0
    assert run.world.record.energised == 0.0
    assert run.world.record.lifted_live == 0
    assert_safe_at_home(run)


def test_a_known_pitch_also_counts_while_charging() -> None:
    run = leaning((1.0, 0.0, 1.0), pitch=0.5)
    outcome = dock(run, 0.5)
    assert outcome.success, outcome.message
    seen = math.radians(0.5)
    for seconds in (0.0, run.parameters.clearance_period + 1.0):
        run.run(seconds)
        felt = run.machine.status.estimate
        assert run.machine.status.charging
        assert felt is not None
        assert (felt.pitch, felt.pitch_stddev) == (seen, math.radians(0.5))
