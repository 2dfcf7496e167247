# SPDX-License-Identifier: Apache-2.0
"""Estimates from all contacts on a target: its place, the yaw of its faces, also without forces."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.observation import ElectrodePose
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.target_place import TargetPlace
from deltacharger_docking.yielding import RemainingShare

MILLIMETRE, DEGREE = 1e-3, math.radians(1.0)
PARAMETERS = DockingParameters()
PUSH = 17.0  # N
RIGID = 1.0 + PARAMETERS.platform_compliance * PARAMETERS.pad_yaw_stiffness


def target_place(parameters: DockingParameters, electrodes: ElectrodePose | None = None) -> TargetPlace:
    """A target's place for an arm that has learnt nothing yet."""
    return TargetPlace(parameters, RemainingShare(parameters), electrodes)


def seen(yaw: float = math.nan, stddev: float = math.nan, roll: float = 0.0) -> ElectrodePose:
    """Electrodes straight ahead, whose yaw (degrees) a camera may have measured."""
    return ElectrodePose((0.0, 0.0, 0.08), roll, yaw=yaw * DEGREE, yaw_stddev=stddev * DEGREE)


def contact(
    x: float, yaw: float = 0.0, across: float = 0.0, angle: float = 0.0, force: bool = True
) -> MisalignmentEstimate:
    """Estimate of one contact by the model: target off by x and across (m), faces yawed by degrees."""
    left = 0.5 * (float(MagnetPull(PARAMETERS).at(np.array(x), across, angle)[0]) + PUSH)
    along = x + PARAMETERS.load_per_yaw * yaw * DEGREE / RIGID
    vertical = (across + along * math.sin(angle)) / math.cos(angle)
    forces = {"left_force": left, "right_force": left} if force else {}
    return MisalignmentEstimate(
        angle, 0.001, vertical, 2e-4, along, 1.2e-3, across=across, across_stddev=2e-4, **forces
    )


@pytest.mark.parametrize("yaw", [2.0, -2.0, 0.5])
@pytest.mark.parametrize("camera", [0.2, None], ids=["seen", "not seen"])
def test_contacts_beside_the_target_give_the_yaw_with_its_sign(yaw: float, camera: float | None) -> None:
    place = target_place(PARAMETERS, seen() if camera is None else seen(yaw, camera))
    felt = contact(0.0)
    for aside in (0.0, 0.006, -0.006, 0.0):
        felt = contact(aside, yaw)
        place.add(felt, -aside, 0.0, PUSH)
    estimate = place.combined(felt)
    assert math.copysign(1.0, estimate.yaw) == math.copysign(1.0, yaw)
    assert abs(estimate.yaw - yaw * DEGREE) < 2.0 * estimate.yaw_stddev
    assert abs(estimate.yaw) > 0.3 * abs(yaw * DEGREE)
    assert abs(estimate.horizontal) < 2.0 * MILLIMETRE, "a lean is not taken for an offset"
    assert abs(felt.horizontal) > 3.0 * abs(estimate.horizontal)


def test_a_change_of_loads_within_one_contact_is_a_slide_and_not_a_lean() -> None:
    place, felt = target_place(PARAMETERS, seen(2.0, 0.1)), contact(0.0, 2.0)
    place.add(felt, 0.0, 0.0, PUSH)
    before, same = place.combined(felt), place.combined(felt, later=True)
    slid = place.combined(replace(felt, horizontal=felt.horizontal + 0.005), later=True)
    assert same.horizontal == pytest.approx(before.horizontal)
    assert same.horizontal_stddev > before.horizontal_stddev
    assert slid.horizontal - before.horizontal == pytest.approx(0.005)
    assert slid.yaw == before.yaw


@pytest.mark.parametrize("angle", [0.0, 0.12, -0.12])
def test_the_offset_across_is_the_measured_one_and_the_vertical_follows_from_it(angle: float) -> None:
    place, felt = target_place(PARAMETERS, seen(roll=angle)), contact(0.001, 1.0, 0.002, angle)
    place.add(felt, 0.0, 0.0, PUSH)
    estimate = place.combined(felt)
    assert (estimate.across, estimate.across_stddev, estimate.angle) == (felt.across, felt.across_stddev, angle)
    assert estimate.vertical * math.cos(angle) - estimate.horizontal * math.sin(angle) == pytest.approx(felt.across)
    x, y = place.off
    assert y * math.cos(angle) - x * math.sin(angle) == pytest.approx(felt.across)


@pytest.mark.parametrize("force", [math.nan, 0.0])
def test_a_missing_force_is_unknown(force: float) -> None:
    parameters = DockingParameters(yaw_stddev=0.0)
    place = target_place(parameters, seen())
    felt = MisalignmentEstimate(0.0, 0.001, 0.0, 2e-4, 0.003, 7e-4, left_force=force, right_force=force)
    place.add(felt, 0.0, 0.0, PUSH)
    assert not place.contradicts_itself
    assert place.combined(felt).horizontal == pytest.approx(0.003, abs=0.3 * MILLIMETRE)
    assert place.off[0] == pytest.approx(0.003, abs=0.8 * MILLIMETRE)


def test_a_probe_is_made_along_the_bars_and_only_within_reach() -> None:
    angle = 0.1
    place = target_place(PARAMETERS, seen(roll=angle))
    place.add(contact(0.002, 1.5, 0.0, angle), 0.0, 0.0, PUSH)
    place.choose(0, lambda x, y: True)
    assert place.plan.aside != 0.0
    (x, y), (a, b) = place.step(), place.step(place.plan.aside)
    assert (x - a, y - b) == pytest.approx((place.plan.aside, place.plan.aside * math.tan(angle)))
    place.choose(0, lambda x, y: False)
    assert place.plan.aside == 0.0


def test_parallel_faces_are_never_probed_for_their_lean() -> None:
    place = target_place(DockingParameters(yaw_stddev=0.0), seen())
    place.add(contact(0.0), 0.0, 0.0, PUSH)
    place.choose(0, lambda x, y: True)
    assert place.plan.gain <= 0.0


def test_a_second_estimate_of_one_contact_replaces_the_first() -> None:
    place, felt = target_place(PARAMETERS, seen()), contact(0.003, 1.0)
    place.add(felt, 0.0, 0.0, PUSH)
    risk, estimate = place.risk, place.combined(felt).horizontal_stddev
    for _ in range(5):
        place.add(felt, 0.0, 0.0, PUSH, again=True)
    assert place.combined(felt).horizontal_stddev == pytest.approx(estimate)
    assert place.risk == pytest.approx(risk, abs=1e-3)


def test_the_remaining_share_is_learnt_once_per_target_and_only_from_its_contacts() -> None:
    share = RemainingShare(PARAMETERS)
    untouched = TargetPlace(PARAMETERS, share, seen(2.0, 0.05))
    before = share.value, share.stddev
    untouched.learn()
    assert (share.value, share.stddev) == before, "no contact"
    place = TargetPlace(PARAMETERS, share, seen(2.0, 0.05))
    for aside in (0.0, 0.006, -0.006, 0.0):
        place.add(contact(aside, 2.0), -aside, 0.0, PUSH)
    place.learn()
    once = share.value, share.stddev
    assert once[1] < before[1]
    place.learn()
    assert (share.value, share.stddev) == once


def test_the_learnt_share_has_its_true_error() -> None:
    random, scores = np.random.default_rng(4), []
    for true in 0.0676 * np.exp(random.normal(0.0, 0.3, 60)):
        share = RemainingShare(PARAMETERS)
        for _ in range(6):
            yaw = random.normal(0.0, 2.0)
            place = TargetPlace(PARAMETERS, share, seen(yaw, 0.05))
            for aside in (0.0, 0.006, -0.006):
                landed = aside + random.normal(0.0, PARAMETERS.docking_jitter)
                felt = contact(landed, yaw * true * RIGID)
                noise = random.normal(0.0, 1e-3)
                place.add(replace(felt, horizontal=felt.horizontal + noise), -aside, 0.0, PUSH)
            place.learn()
        scores.append((share.value - true) / share.stddev)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5


def one_pad(left: float, right: float) -> MisalignmentEstimate:
    return MisalignmentEstimate(0.0, 0.01, 0.0, 1e-3, 0.05, 0.02, in_range=False, left_force=left, right_force=right)


def test_a_pad_that_carries_all_means_a_yaw_toward_it_if_both_ridges_are_on_their_pads() -> None:
    place = target_place(PARAMETERS, seen())
    left = place.least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)
    assert left == pytest.approx(-place.least_yaw(one_pad(0.5, 60.0), 0.0, PUSH))
    assert left > 0.0
    assert math.isfinite(place.least_yaw(one_pad(35.0, 0.5), 0.0, PUSH)), "the magnets pull: it is not far aside"
    assert math.isnan(place.least_yaw(one_pad(22.0, 0.5), 0.0, PUSH)), "they do not"
    assert math.isnan(place.least_yaw(one_pad(6.0, 0.5), 0.0, 0.0)), "too little information"
    assert math.isnan(place.least_yaw(one_pad(40.0, 20.0), 0.0, PUSH)), "both bear"
    assert math.isnan(place.least_yaw(one_pad(60.0, 0.5), -0.02, PUSH)), "its place loads that pad as well"
    assert math.isnan(target_place(PARAMETERS).least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)), "the place is unknown"
    parallel = target_place(DockingParameters(yaw_stddev=0.0), seen())
    assert math.isnan(parallel.least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)), "parallel by construction"


def test_an_unsure_offset_points_along_the_bars_only_as_far_as_no_lean_explains_it() -> None:
    far = MisalignmentEstimate(0.0, 0.01, 0.0, 1e-3, 0.02, 1e-3, left_force=60.0, right_force=4.0)
    parallel = target_place(DockingParameters(yaw_stddev=0.0), seen())
    assert parallel.pointed_at(far, 0.0)[0] == pytest.approx(0.02, rel=0.02)
    assert target_place(PARAMETERS).pointed_at(far, 0.0)[0] == 0.02, "the place is unknown"
    leaning = target_place(DockingParameters(yaw_stddev=3.0 * DEGREE), seen())
    assert abs(leaning.pointed_at(far, 0.0)[0]) < 0.003
    assert parallel.pointed_at(one_pad(60.0, 0.5), 0.0) == (0.0, 0.0), "out of range"


def test_each_further_contact_has_to_gain_more() -> None:
    place = target_place(DockingParameters(yaw_stddev=0.0), seen())
    place.add(contact(0.005), 0.0, 0.0, PUSH)
    gains = []
    for moves in (0, 4, 8):
        place.choose(moves, lambda x, y: True)
        gains.append(place.plan.gain)
    first = PARAMETERS.redocking_gain_min
    assert gains[0] > 0.0
    assert gains[0] - gains[1] == pytest.approx(first * (1.5**4 - 1.0))
    assert gains[0] - gains[2] == pytest.approx(first * (1.5**8 - 1.0))
