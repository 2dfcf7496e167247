# SPDX-License-Identifier: Apache-2.0
"""Where the target is and whether current may flow, from all contacts on it.

Its place along the bars and across them, the yaw of its faces, also without forces; and the clearance of the bars.
"""

import math
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from deltacharger_core.machine import MAGNET_FORCE, MAGNET_WIDTH, PAD_YAW_STIFFNESS
from deltacharger_docking import arm, clearance, observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.place import (
    LOAD_PER_YAW,
    AlongFilter,
    LookAlong,
    MagnetPull,
    TargetPlace,
)

MILLIMETRE, DEGREE = 1e-3, math.radians(1.0)
PARAMETERS = DockingParameters()
PUSH = 17.0  # N
RIGID = 1.0 + PARAMETERS.platform_compliance * PAD_YAW_STIFFNESS


def target_place(parameters: DockingParameters, electrodes: observation.ElectrodePose | None = None) -> TargetPlace:
    """A target's place for an arm that has learnt nothing yet."""
    return TargetPlace(parameters, arm.RemainingShare(parameters), electrodes)


def seen(yaw: float = math.nan, stddev: float = math.nan, roll: float = 0.0) -> observation.ElectrodePose:
    """Electrodes straight ahead, whose yaw (degrees) a camera may have measured."""
    return observation.ElectrodePose((0.0, 0.0, 0.08), roll, yaw=yaw * DEGREE, yaw_stddev=stddev * DEGREE)


def contact(
    x: float, yaw: float = 0.0, across: float = 0.0, angle: float = 0.0, force: bool = True
) -> clearance.MisalignmentEstimate:
    """Estimate of one contact by the model: target off by x and across (m), faces yawed by degrees."""
    left = 0.5 * (float(MagnetPull(MAGNET_FORCE).at(np.array(x), across, angle)[0]) + PUSH)
    along = x + LOAD_PER_YAW * yaw * DEGREE / RIGID
    vertical = (across + along * math.sin(angle)) / math.cos(angle)
    forces = {"left_force": left, "right_force": left} if force else {}
    return clearance.MisalignmentEstimate(
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


def one_pad(left: float, right: float) -> clearance.MisalignmentEstimate:
    return clearance.MisalignmentEstimate(
        0.0, 0.01, 0.0, 1e-3, 0.05, 0.02, in_range=False, left_force=left, right_force=right
    )


def test_a_pad_that_carries_all_means_a_yaw_toward_it_if_both_ridges_are_on_their_pads() -> None:
    place = target_place(PARAMETERS, seen())
    left = place.least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)
    assert left == pytest.approx(-place.least_yaw(one_pad(0.5, 60.0), 0.0, PUSH))
    assert left > 0.0
    assert math.isfinite(place.least_yaw(one_pad(35.0, 0.5), 0.0, PUSH)), "the magnets pull: it is not far aside"
    assert math.isnan(place.least_yaw(one_pad(22.0, 0.5), 0.0, PUSH)), "they do not"
    assert math.isnan(place.least_yaw(one_pad(60.0, 0.5), -0.02, PUSH)), "its place loads that pad as well"
    assert math.isnan(target_place(PARAMETERS).least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)), "the place is unknown"
    parallel = target_place(DockingParameters(yaw_stddev=0.0), seen())
    assert math.isnan(parallel.least_yaw(one_pad(60.0, 0.5), 0.0, PUSH)), "parallel by construction"


@pytest.mark.parametrize("angle", [0.0, 0.05, -0.2])
@pytest.mark.parametrize(("x", "across"), [(0.0, 0.0), (0.003, -0.001), (-0.007, 0.002), (0.012, 0.004)])
def test_derivatives_of_the_pull_match_finite_differences(x: float, across: float, angle: float) -> None:
    pull, slope, by_width = MagnetPull(MAGNET_FORCE).at(np.array(x), across, angle)
    step = 1e-7
    more, less = (MagnetPull(MAGNET_FORCE).at(np.array(x + side * step), across, angle)[0] for side in (1.0, -1.0))
    assert slope == pytest.approx((more - less) / (2 * step), rel=1e-5, abs=1e-4)
    wide, narrow = (
        MagnetPull(MAGNET_FORCE, MAGNET_WIDTH * math.exp(side * 1e-6)).at(np.array(x), across, angle)[0]
        for side in (1.0, -1.0)
    )
    assert by_width == pytest.approx((wide - narrow) / 2e-6, rel=1e-5, abs=1e-4)
    # The distance of the centres, for an end_effector that measures the bars as rotated.
    y = (across + x * math.sin(angle)) / math.cos(angle)
    share = 1.0 / (1.0 + (x * x + y * y) / MAGNET_WIDTH**2)
    assert pull == pytest.approx(MAGNET_FORCE * share)


def known(bias_stddev: float = 0.0081, place_stddev: float = PARAMETERS.place_stddev) -> AlongFilter:
    """A filter that expects a target at 0."""
    return AlongFilter(PARAMETERS, 0.0, place_stddev, 0.0, bias_stddev)


def test_estimates_that_contradict_the_arms_moves_are_detected() -> None:
    honest, frozen = known(), known()
    for platform in (0.0, -0.006, 0.006, 0.012):  # the frozen pads repeat their first reading
        pull = float(MagnetPull(MAGNET_FORCE).at(np.array(0.004 - platform), 0.0, 0.0)[0])
        honest.update(LookAlong(platform, 0.004 - platform, 3e-4, pull + PUSH, 2.0, PUSH, 0.0, 0.0))
        frozen.update(LookAlong(platform, 0.004, 3e-4, 60.0 + PUSH, 2.0, PUSH, 0.0, 0.0))
    assert (honest.contradicts_itself, frozen.contradicts_itself) == (False, True)


LEVEL = [
    item for item in fields(clearance.MisalignmentEstimate) if item.name not in ("across", "across_stddev", "classes")
]
"""Fields of estimates without an offset across."""


def felt(
    degrees: float, vertical: float = 0.0, sigma_degrees: float = 0.1, sigma: float = 2e-4
) -> clearance.MisalignmentEstimate:
    return clearance.MisalignmentEstimate(
        math.radians(degrees), math.radians(sigma_degrees), vertical, sigma, 0.0, 1e-3
    )


def test_uncertainty_only_makes_the_verdict_stricter() -> None:
    order = [
        clearance.Verdict.SAFE,
        clearance.Verdict.PROBABLY_SAFE,
        clearance.Verdict.TOO_CLOSE,
        clearance.Verdict.CRITICAL,
    ]
    for degrees in np.linspace(-14, 14, 29):
        for vertical in np.linspace(-0.008, 0.008, 9):
            ranks = [
                order.index(clearance.judge(felt(degrees, vertical, 0.05 * factor, 1e-4 * factor), PARAMETERS))
                for factor in (1, 2, 4, 8, 16)
            ]
            assert ranks == sorted(ranks)


def test_a_lower_critical_angle_counts_and_a_higher_one_does_not() -> None:
    assert clearance.judge(felt(5.0), PARAMETERS, math.radians(4.0)) is clearance.Verdict.CRITICAL
    assert clearance.judge(felt(12.5), PARAMETERS, math.radians(20.0)) is clearance.Verdict.CRITICAL


def test_an_unknown_offset_across_follows_from_the_pose_with_both_errors() -> None:
    angle = math.radians(10.0)
    pose = clearance.MisalignmentEstimate(angle, 0.002, 0.003, 2e-4, 0.004, 1e-3)
    assert pose.across == pytest.approx(0.003 * math.cos(angle) - 0.004 * math.sin(angle))
    assert pose.across_stddev == pytest.approx(math.hypot(2e-4 * math.cos(angle), 1e-3 * math.sin(angle)))
    assert (
        clearance.MisalignmentEstimate.of(SimpleNamespace(**{item.name: getattr(pose, item.name) for item in LEVEL}))
        == pose
    )
    assert not clearance.MisalignmentEstimate(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan).complete


def test_a_known_pitch_only_makes_the_verdict_stricter_and_an_unknown_one_changes_nothing() -> None:
    order = [
        clearance.Verdict.SAFE,
        clearance.Verdict.PROBABLY_SAFE,
        clearance.Verdict.TOO_CLOSE,
        clearance.Verdict.CRITICAL,
    ]
    for degrees in (0.0, 5.0, 8.0):
        for vertical in np.linspace(-0.006, 0.006, 13):
            pose = felt(degrees, vertical)
            seen = [
                replace(pose, pitch=sign * pitch, pitch_stddev=0.01) for pitch in (0.0, 0.05, 0.3) for sign in (1, -1)
            ]
            ranks = [order.index(clearance.judge(each, PARAMETERS)) for each in [pose, *seen]]
            assert ranks == sorted(ranks)
            assert clearance.judge(replace(pose, pitch=0.3), PARAMETERS) is clearance.judge(pose, PARAMETERS)
            assert clearance.judge(replace(pose, pitch_stddev=0.3), PARAMETERS) is clearance.judge(pose, PARAMETERS)
