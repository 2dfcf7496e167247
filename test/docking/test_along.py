# SPDX-License-Identifier: Apache-2.0
"""Laws of the filter for the target's place along its bars, with a lean that loads the pads like an offset."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_docking.along import AlongFilter, LookAlong, empty_pad_offset
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.parameters import DockingParameters

MILLIMETRE = 1e-3
PARAMETERS = DockingParameters()
PUSH = 17.0  # N
BIAS = 0.0081  # m, load bias of a yaw of 1.2° on a platform of the usual compliance
FLAT = 0.2  # m; a prior without information within the grid


@pytest.mark.parametrize("angle", [0.0, 0.05, -0.2])
@pytest.mark.parametrize(("x", "across"), [(0.0, 0.0), (0.003, -0.001), (-0.007, 0.002), (0.012, 0.004)])
def test_derivatives_of_the_pull_match_finite_differences(x: float, across: float, angle: float) -> None:
    pull, slope, by_width = MagnetPull(PARAMETERS).at(np.array(x), across, angle)
    step = 1e-7
    more, less = (MagnetPull(PARAMETERS).at(np.array(x + side * step), across, angle)[0] for side in (1.0, -1.0))
    assert slope == pytest.approx((more - less) / (2 * step), rel=1e-5, abs=1e-4)
    wide, narrow = (
        MagnetPull(DockingParameters(magnet_width=PARAMETERS.magnet_width * math.exp(side * 1e-6))).at(
            np.array(x), across, angle
        )[0]
        for side in (1.0, -1.0)
    )
    assert by_width == pytest.approx((wide - narrow) / 2e-6, rel=1e-5, abs=1e-4)
    # The distance of the centres, for an end_effector that measures the bars as rotated.
    y = (across + x * math.sin(angle)) / math.cos(angle)
    share = 1.0 / (1.0 + (x * x + y * y) / PARAMETERS.magnet_width**2)
    assert pull == pytest.approx(PARAMETERS.magnet_force * share)


def test_far_away_only_the_floor_of_the_pull_remains_and_gives_no_place() -> None:
    pull, slope, by_width = MagnetPull(PARAMETERS).at(np.array([-0.03, 0.03]), 0.0, 0.1)
    assert pull == pytest.approx(PARAMETERS.magnet_force * PARAMETERS.magnet_floor)
    assert np.all(slope == 0.0)
    assert np.all(by_width == 0.0)


class Target:
    """A target drawn from the filter's own model, and the measurements of contacts on it.

    Attributes:
        place: m, where it is.
        landed: m, offset of its centre in the last contact.
    """

    def __init__(self, random: np.random.Generator, bias_stddev: float, place_stddev: float = 0.005) -> None:
        p, self._random = PARAMETERS, random
        self.place = random.normal(0.0, place_stddev)
        self._bias = random.normal(0.0, math.hypot(bias_stddev, p.horizontal_shared))
        self._gain = random.normal(0.0, p.gain_error)
        self._scale = 1.0 + random.normal(0.0, p.force_error)
        width = p.magnet_width * (1.0 + random.normal(0.0, p.magnet_width_error))
        force = p.magnet_force * (1.0 + random.normal(0.0, p.magnet_error))
        self._pull = MagnetPull(DockingParameters(magnet_width=width, magnet_force=force))
        self.landed = math.nan

    def look(self, platform: float, stddev: float = 0.0006) -> LookAlong:
        """A contact of the platform commanded to a place (m); `stddev` is its own standard deviation, m."""
        random = self._random
        self.landed = x = self.place - platform + random.normal(0.0, PARAMETERS.docking_jitter)
        load = x * (1.0 + self._gain) + self._bias + random.normal(0.0, stddev)
        pressed = float(self._pull.at(np.array(x), 0.0, 0.0)[0]) + PUSH
        spread = PARAMETERS.force_repeatability * pressed / math.sqrt(2.0)
        force = self._scale * pressed + random.normal(0.0, spread)
        return LookAlong(platform, load, stddev, force, spread, PUSH, 0.0, 0.0)


def known(bias_stddev: float = BIAS, place_stddev: float = PARAMETERS.place_stddev) -> AlongFilter:
    """A filter that expects a target at 0."""
    return AlongFilter(PARAMETERS, 0.0, place_stddev, 0.0, bias_stddev)


def simulated(count: int, asides: tuple[float, ...], bias_stddev: float = BIAS) -> list[tuple[Target, AlongFilter]]:
    """Targets and filters after contacts at these offsets (m) from the expected place."""
    random = np.random.default_rng(7)
    found = []
    for _ in range(count):
        target, tracker = Target(random, bias_stddev), known(bias_stddev)
        for aside in asides:
            tracker.update(target.look(-aside))
        found.append((target, tracker))
    return found


def test_with_parallel_faces_one_contact_gives_the_place_by_its_load() -> None:
    tracker = AlongFilter(PARAMETERS, 0.0, FLAT)
    pull = float(MagnetPull(PARAMETERS).at(np.array(0.003), 0.0, 0.0)[0])
    tracker.update(LookAlong(0.001, 0.003, 1e-4, pull + PUSH, 1e3, PUSH, 0.0, 0.0))
    assert tracker.contact.mean == pytest.approx(0.003, abs=0.2 * MILLIMETRE)
    assert tracker.target == pytest.approx(0.004, abs=0.2 * MILLIMETRE)
    assert tracker.contact.stddev < 1.2 * math.hypot(PARAMETERS.horizontal_shared, 0.003 * PARAMETERS.gain_error)


def test_with_an_unknown_lean_one_contact_does_not_change_the_expected_place() -> None:
    tracker = known(bias_stddev=0.1)
    tracker.update(LookAlong(0.0, 0.015, 1e-4, 60.0 + PUSH, 1e3, PUSH, 0.0, 0.0))
    assert abs(tracker.target) < 0.1 * MILLIMETRE
    assert tracker.contact.stddev == pytest.approx(
        math.hypot(PARAMETERS.place_stddev, PARAMETERS.docking_jitter), rel=0.1
    )


def test_contacts_beside_the_target_locate_it_within_the_reported_error() -> None:
    one, three = (simulated(200, asides, bias_stddev=0.02) for asides in ((0.0,), (0.0, 0.006, -0.006)))
    scores = [(target.landed - each.contact.mean) / each.contact.stddev for target, each in three]
    assert 0.8 < math.sqrt(np.mean(np.square(scores))) < 1.2
    assert abs(np.mean(scores)) < 0.25
    before, after = (np.median([each.contact.stddev for _, each in found]) for found in (one, three))
    assert after < 0.5 * before
    biases = [(each.bias, each.bias_stddev) for _, each in three]
    truths = [target._bias for target, _ in three]
    errors = [(estimate - true) / spread for (estimate, spread), true in zip(biases, truths, strict=True)]
    assert 0.75 < math.sqrt(np.mean(np.square(errors))) < 1.25


def test_the_risk_matches_the_observed_frequency() -> None:
    found = simulated(600, (0.0, 0.006, -0.006))
    predicted = [each.risk(0.002) for _, each in found]
    observed = [abs(target.landed) > 0.002 for target, _ in found]
    assert 0.05 < np.mean(observed) < 0.95
    assert np.mean(predicted) == pytest.approx(np.mean(observed), abs=0.06)


def test_the_risk_matches_samples_of_the_mixture() -> None:
    ((_, tracker),) = simulated(1, (0.0, 0.006))
    random = np.random.default_rng(2)
    means = random.choice(tracker._means, 200_000, p=tracker._weights)
    sampled = np.mean(np.abs(means + random.normal(0.0, tracker._spread, len(means))) > 0.004)
    assert tracker.risk(0.004) == pytest.approx(sampled, abs=0.005)


def test_no_probe_is_planned_that_would_leave_a_pad_empty() -> None:
    force = 60.0 / (1.0 + (0.006 / 0.008) ** 2) + PUSH
    most = empty_pad_offset(PARAMETERS, force)
    for bias in (0.0, most - 0.005, most - 0.007):
        tracker = AlongFilter(PARAMETERS, 0.0, 0.005, bias, 1e-4)
        tracker.update(LookAlong(0.0, bias, 1e-4, 60.0 + PUSH, 3.0, PUSH, 0.0, 0.0))
        for plan in tracker.plans(0.004):
            pull = float(MagnetPull(PARAMETERS).at(np.array(plan.aside), 0.0, 0.0)[0])
            limit = empty_pad_offset(PARAMETERS, pull + PUSH)
            assert not plan.aside or abs(tracker.bias + plan.aside) <= limit
        asides = {plan.aside for plan in tracker.plans(0.004)}
        assert (PARAMETERS.probe_offset in asides) == (tracker.bias + PARAMETERS.probe_offset < most)
        assert -PARAMETERS.probe_offset in asides


def test_estimates_that_contradict_the_arms_moves_are_detected() -> None:
    honest = [each for _, each in simulated(200, (0.0, 0.006, -0.006))]
    assert not any(each.contradicts_itself for each in honest)
    frozen = known()
    for platform in (0.0, -0.006, 0.006, 0.012):  # the pads repeat their first reading
        frozen.update(LookAlong(platform, 0.004, 3e-4, 60.0 + PUSH, 2.0, PUSH, 0.0, 0.0))
    assert frozen.contradicts_itself


def test_another_contact_gains_nothing_at_a_known_place_and_much_if_a_lean_hides_it() -> None:
    sure = known(bias_stddev=0.0, place_stddev=1e-4)
    sure.update(LookAlong(0.0, 0.0, 1e-4, 60.0 + PUSH, 2.0, PUSH, 0.0, 0.0))
    assert sure.risk(0.004) < 1e-3
    assert all(plan.gain < 1e-3 for plan in sure.plans(0.004))
    hidden = known(bias_stddev=0.02)
    hidden.update(LookAlong(0.0, 0.0, 1e-4, 50.0 + PUSH, 2.0, PUSH, 0.0, 0.0))
    plans = hidden.plans(0.004)
    assert hidden.risk(0.004) > 0.1
    assert max(plan.gain for plan in plans if plan.aside) > 0.05
    assert max(plans, key=lambda plan: plan.gain).contacts > 1, "force beside the target informs most"
    assert all(0.0 <= plan.gain <= hidden.risk(0.004) for plan in plans)
