# SPDX-License-Identifier: Apache-2.0
"""Docking scenarios in virtual time, also at targets whose faces lean: what happens and how it ends."""

import math
from dataclasses import replace

import pytest

from deltacharger_docking import algorithm
from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import BasePose, DockGoal, DockingOutcome, ElectrodePose, Reply, Service
from deltacharger_sim.parameters import ContactParameters, PlatformParameters, TargetParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, VirtualCharger

from ..marks import rest
from .dockings import MILLIMETRE, assert_safe_at_home, charger, quick_charger

REFUSED = {Code.CRITICAL_ANGLE, Code.ESTIMATE_UNSURE, Code.NO_TACTILE_CONTACT}
CHARGED, EITHER = {Code.NONE}, {Code.NONE, Code.CRITICAL_ANGLE, Code.MISALIGNED}


def test_it_finds_docks_charges_and_undocks() -> None:
    run = quick_charger(parameters={"overlap_loss_max": 0.004, "landing_limit": 0.0025}, coarse=True)
    outcome = run.dock(DockGoal(None))
    assert outcome.success, outcome.message
    assert outcome.code is Code.NONE
    assert outcome.charge_current > 0.5
    assert 0.4 <= outcome.contact_current <= 0.5
    truth = run.world.snapshot()
    assert truth.contactor_closed
    horizontal, vertical = truth.misalignment[:2]
    assert abs(vertical) < 2.5 * MILLIMETRE, "tolerance and half a millimetre of estimate, and a millimetre of jitter"
    assert abs(horizontal) < 5.0 * MILLIMETRE, "tolerance and three standard deviations of the estimate"
    contacts, start = run.world.record.contacts, run.now
    assert run.dock().success, "docking when docked"
    assert (run.world.record.contacts, run.now - start < 0.1) == (contacts, True)
    assert run.undock().success
    assert run.states[0] is State.LOCATE
    assert run.states[-4:] == [State.ENERGISE, State.CHARGING, State.RETRACT, State.IDLE]
    assert run.undock().success, "undocking when undocked"
    assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("degrees", "codes"),
    [
        *((0, CHARGED), (7, CHARGED), (11.5, EITHER), (12, REFUSED), (-24, REFUSED)),
        *(rest(degrees, CHARGED) for degrees in (1, -2, 3, -4, 5, -6, -7)),
        *(rest(degrees, EITHER) for degrees in (8, -9, 10, -11)),
        *(rest(degrees, REFUSED) for degrees in (-12, 13, -15, 19)),
    ],
)
def test_a_tilt_is_charged_up_to_seven_degrees_refused_from_twelve_and_never_shorts(
    degrees: float, codes: set[Code]
) -> None:
    run = charger(degrees=degrees, seed=12, coarse=True)
    outcome = run.dock()
    assert outcome.code in codes, outcome.message
    assert run.world.record.energised_shorts == 0
    assert run.world.record.energised_unsafe == 0.0
    if not outcome.success:
        assert not outcome.aligned
        assert run.world.record.energised == 0.0
        assert_safe_at_home(run)


@pytest.mark.parametrize(
    ("reply", "code"),
    [
        (Reply(0, True, detection=ElectrodePose((0, 0, 0.08), 0.0, 0.0, 9.0)), Code.DETECTION_STALE),
        (Reply(0, True, detection=ElectrodePose((0, 0.2, 0.3), 0.0)), Code.UNREACHABLE),
        (None, Code.ELECTRODES_NOT_FOUND),
    ],
)
def test_an_invalid_detection_moves_nothing(monkeypatch: pytest.MonkeyPatch, reply: Reply | None, code: Code) -> None:
    monkeypatch.setattr(algorithm, "_LOCATE_TIMEOUT", 2.0)
    run = quick_charger()
    run.answer[Service.DETECT] = lambda asked: None if reply is None else replace(reply, number=asked.number)
    outcome = run.dock(DockGoal(None))
    assert outcome.code is code
    assert math.dist(run.world.snapshot().position, run.parameters.home) < MILLIMETRE
    if code is Code.UNREACHABLE:
        assert outcome.suggested_base == BasePose(0.0, 0.2, pytest.approx(0.22))


STIFF = 1e6  # N/m; softer bars both press in spite of 2° of pitch


def leaning(
    place: tuple[float, float, float],
    yaw: float = 0.0,
    pitch: float = 0.0,
    compliance: float = 0.02,
    stiffness: float = 1e5,
    seed: int = 1,
) -> VirtualCharger:
    """A charger whose target differs from the goal's by (mm, mm, degrees) and leans, in degrees."""
    x, y, roll = place
    tilt = {"tilt_x": math.radians(pitch), "tilt_y": math.radians(yaw)}
    target = TargetParameters(x=x * MILLIMETRE, y=y * MILLIMETRE, roll=math.radians(roll), **tilt)
    contact, platform = ContactParameters(stiffness=stiffness), PlatformParameters(compliance=compliance)
    return charger(seed=seed, coarse=True, target=target, contact=contact, platform=platform)


def dock(run: VirtualCharger, pitch: float = math.nan) -> DockingOutcome:
    """Dock at the goal's place; `pitch` (degrees) as a camera measures it within 0.5°."""
    stddev = math.radians(0.5) if math.isfinite(pitch) else math.nan
    return run.dock(DockGoal(replace(GOAL, pitch=math.radians(pitch), pitch_stddev=stddev)))


@pytest.mark.parametrize(("pitch", "compliance"), [(2.0, 0.0), rest(-2.0, 0.005)])
@pytest.mark.parametrize(("camera", "code"), [(False, Code.NO_CHARGE_CURRENT), (True, Code.LEANING)])
def test_a_pitch_that_lifts_a_bar_is_never_energised_and_reported_if_a_camera_saw_it(
    camera: bool, code: Code, pitch: float, compliance: float
) -> None:
    run = leaning((1.0, 0.0, 1.0), pitch=pitch, compliance=compliance, stiffness=STIFF)
    outcome = dock(run, pitch if camera else math.nan)
    assert outcome.code is code, outcome.message
    assert ("pitched" in outcome.message) is camera
    assert outcome.suggested_base is None, "no stand mends a pitch"
    assert run.world.record.contacts > 0
    assert run.world.record.energised == 0.0
    assert run.world.record.lifted_live == 0
    assert_safe_at_home(run)


DEGREE = math.radians(1.0)


def leaning_at(yaw: float, pitch: float, stddev: float = 0.5, age: float = 0.0) -> ElectrodePose:
    """Electrodes before the arm whose faces lean, in degrees."""
    return ElectrodePose(
        (0.002, 0.001, 0.080), 0.0, 0.004, age, yaw * DEGREE, pitch * DEGREE, stddev * DEGREE, stddev * DEGREE
    )


def dock_at(pose: ElectrodePose, seen: bool) -> tuple[VirtualCharger, DockingOutcome]:
    """Dock at electrodes that the goal gives, or that the camera sees."""
    run = quick_charger(coarse=True)
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
    pose = leaning_at(yaw, 0.0)
    run, outcome = dock_at(pose, seen)
    assert (outcome.code, outcome.retriable) == (Code.LEANING, False)
    assert f"to the {side}" in outcome.message
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
    run, outcome = dock_at(leaning_at(yaw, -6.5), seen)
    assert (outcome.code, outcome.retriable, outcome.suggested_base) == (Code.LEANING, False, None)
    assert "pitched" in outcome.message
    assert_nothing_was_moved(run)
