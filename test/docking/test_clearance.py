# SPDX-License-Identifier: Apache-2.0
"""When current may flow, and where the target is: laws of the two decisions that keep docking safe."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_docking.clearance import FeltPose, Verdict, clearance, judge
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.touch import PlaceFilter

GAP, LENGTH = 0.0037, 0.035
PARAMETERS = DockingParameters()


def felt(degrees: float, vertical: float = 0.0, sigma_degrees: float = 0.1, sigma: float = 2e-4) -> FeltPose:
    return FeltPose(math.radians(degrees), math.radians(sigma_degrees), vertical, sigma, 0.0, 1e-3)


@pytest.mark.parametrize(("degrees", "vertical"), [(12.07, 0.0), (8.0, 0.0025), (3.9, 0.005)])
def test_clearance_vanishes_where_the_bars_meet(degrees: float, vertical: float) -> None:
    assert clearance(math.radians(degrees), vertical, GAP, LENGTH) == pytest.approx(0.0, abs=3e-5)


def test_clearance_is_even_in_both_errors() -> None:
    for angle, vertical in [(0.1, 0.001), (0.05, 0.003)]:
        values = [clearance(s * angle, t * vertical, GAP, LENGTH) for s in (-1, 1) for t in (-1, 1)]
        assert np.ptp(values) < 1e-15


@pytest.mark.parametrize("degrees", range(8))
def test_a_precise_estimate_up_to_seven_degrees_is_allowed(degrees: int) -> None:
    assert judge(felt(degrees), PARAMETERS) in (Verdict.SAFE, Verdict.PROBABLY_SAFE)


@pytest.mark.parametrize("degrees", [11.7, 12.0, 13.0, 20.0, -12.0, -15.0])
def test_no_estimate_near_critical_is_allowed(degrees: float) -> None:
    assert judge(felt(degrees, sigma_degrees=0.01, sigma=1e-5), PARAMETERS) is Verdict.CRITICAL


def test_a_vertical_error_alone_is_not_called_critical() -> None:
    assert judge(felt(2.0, vertical=0.007), PARAMETERS) is Verdict.TOO_CLOSE


def test_uncertainty_only_ever_makes_the_verdict_stricter() -> None:
    order = [Verdict.SAFE, Verdict.PROBABLY_SAFE, Verdict.TOO_CLOSE, Verdict.CRITICAL]
    for degrees in np.linspace(-14, 14, 29):
        for vertical in np.linspace(-0.008, 0.008, 9):
            ranks = [
                order.index(judge(felt(degrees, vertical, 0.05 * factor, 1e-4 * factor), PARAMETERS))
                for factor in (1, 2, 4, 8, 16)
            ]
            assert ranks == sorted(ranks)


def test_a_lower_critical_angle_counts_and_a_higher_one_does_not() -> None:
    assert judge(felt(5.0), PARAMETERS, math.radians(4.0)) is Verdict.CRITICAL
    assert judge(felt(12.5), PARAMETERS, math.radians(20.0)) is Verdict.CRITICAL


def test_the_filter_averages_the_scatter_of_dockings_away() -> None:
    random = np.random.default_rng(3)
    jitter, target = 0.00095, np.array([0.006, -0.004])
    errors = []
    for _ in range(200):
        tracker = PlaceFilter(DockingParameters(docking_jitter=jitter, gain_error=0.15))
        place = np.zeros(2)
        for _ in range(8):
            felt_offset = target - place + random.normal(0, jitter, 2)
            tracker.update(tuple(place), FeltPose(0, 0.01, felt_offset[1], 1e-4, felt_offset[0], 1e-4))
            place = np.array(tracker.target)
        errors.append(np.hypot(*(place - target)))
    assert np.mean(errors) < 0.6 * jitter


def test_a_far_first_look_does_not_outweigh_near_ones() -> None:
    tracker = PlaceFilter(DockingParameters(docking_jitter=0.0005, gain_error=0.15))
    tracker.update((0.0, 0.0), FeltPose(0, 0, 0.0, 1e-4, 0.010, 1e-4))  # reads 10 mm where the truth is 8
    tracker.update((0.010, 0.0), FeltPose(0, 0, 0.0, 1e-4, -0.002, 1e-4))
    assert tracker.misalignment((0.008, 0.0))[0] == pytest.approx(0.0, abs=3e-4)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("critical_angle", 0.5), ("push_current", -1.0), ("approach", "wild"), ("current_max", 0.4)),
        *(("lift", math.nan), ("clearance_sigmas", 7.0), ("clearance_sigmas_sure", 5.0)),
    ],
)
def test_impossible_parameters_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        DockingParameters(**{name: value})
