# SPDX-License-Identifier: Apache-2.0
"""Laws of the two decisions that keep docking safe: whether current may flow, and where the target is."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from deltacharger_docking.clearance import MisalignmentEstimate, Verdict, clearance, judge
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.place import AxisFilter

GAP, LENGTH = 0.0037, 0.035
PARAMETERS = DockingParameters()
LEVEL = [item for item in fields(MisalignmentEstimate) if item.name not in ("across", "across_stddev", "classes")]
"""Fields of estimates from before the offset across existed."""


def felt(
    degrees: float, vertical: float = 0.0, sigma_degrees: float = 0.1, sigma: float = 2e-4
) -> MisalignmentEstimate:
    return MisalignmentEstimate(math.radians(degrees), math.radians(sigma_degrees), vertical, sigma, 0.0, 1e-3)


@pytest.mark.parametrize(("degrees", "vertical"), [(12.07, 0.0), (8.0, 0.0025), (3.9, 0.005)])
def test_clearance_vanishes_where_the_bars_meet(degrees: float, vertical: float) -> None:
    assert clearance(math.radians(degrees), vertical, GAP, LENGTH) == pytest.approx(0.0, abs=3e-5)


def test_uncertainty_only_makes_the_verdict_stricter() -> None:
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


def test_an_unknown_offset_across_follows_from_the_pose_with_both_errors() -> None:
    angle = math.radians(10.0)
    pose = MisalignmentEstimate(angle, 0.002, 0.003, 2e-4, 0.004, 1e-3)
    assert pose.across == pytest.approx(0.003 * math.cos(angle) - 0.004 * math.sin(angle))
    random = np.random.default_rng(4)
    y, x = 0.003 + 2e-4 * random.standard_normal(100_000), 0.004 + 1e-3 * random.standard_normal(100_000)
    assert pose.across_stddev == pytest.approx(np.std(y * math.cos(angle) - x * math.sin(angle)), rel=0.02)
    assert MisalignmentEstimate.of(SimpleNamespace(**{item.name: getattr(pose, item.name) for item in LEVEL})) == pose
    assert not MisalignmentEstimate(math.nan, math.nan, math.nan, math.nan, math.nan, math.nan).complete


@pytest.mark.parametrize("off", [0.005, -0.005])
@pytest.mark.parametrize("degrees", [10.0, -10.0])
def test_a_lean_that_looks_like_an_offset_along_the_bars_changes_no_verdict(degrees: float, off: float) -> None:
    """It leaks into the vertical offset by the roll, but not into the offset across the bars."""
    angle, across = math.radians(degrees), 2e-4
    for spread in (5e-5, 1e-4, 2e-4, 4e-4):
        level, leaning = (
            MisalignmentEstimate(
                *(angle, 5e-4, (across + x * math.sin(angle)) / math.cos(angle), 5e-4, x, 1e-3),
                across=across,
                across_stddev=spread,
            )
            for x in (0.001, 0.001 + off)
        )
        assert abs(level.vertical - leaning.vertical) > 8e-4
        assert judge(level, PARAMETERS) is judge(leaning, PARAMETERS)
        # An offset across that is calculated from the pose is equal, and less sure.
        worked_out = replace(leaning, across=math.nan, across_stddev=math.nan)
        assert worked_out.across == pytest.approx(across)
        # A publisher that does not know the fields leaves zeros: they do not mean an exact offset of 0.
        assert replace(leaning, across=0.0, across_stddev=0.0).across == pytest.approx(across)


def test_a_known_pitch_only_makes_the_verdict_stricter_and_an_unknown_one_changes_nothing() -> None:
    order = [Verdict.SAFE, Verdict.PROBABLY_SAFE, Verdict.TOO_CLOSE, Verdict.CRITICAL]
    for degrees in (0.0, 5.0, 8.0):
        for vertical in np.linspace(-0.006, 0.006, 13):
            pose = felt(degrees, vertical)
            seen = [
                replace(pose, pitch=sign * pitch, pitch_stddev=0.01) for pitch in (0.0, 0.05, 0.3) for sign in (1, -1)
            ]
            ranks = [order.index(judge(each, PARAMETERS)) for each in [pose, *seen]]
            assert ranks == sorted(ranks)
            assert judge(replace(pose, pitch=0.3), PARAMETERS) is judge(pose, PARAMETERS)
            assert judge(replace(pose, pitch_stddev=0.3), PARAMETERS) is judge(pose, PARAMETERS)


def axis(jitter: float = 0.00095) -> AxisFilter:
    return AxisFilter(DockingParameters(docking_jitter=jitter, gain_error=0.15))


def test_a_far_first_contact_does_not_outweigh_near_ones() -> None:
    tracker = axis(jitter=0.0005)
    tracker.update(0.0, 0.010, 1e-4)  # reads 10 mm, truth 8 mm
    tracker.update(0.010, -0.002, 1e-4)
    assert tracker.target == pytest.approx(0.008, abs=3e-4)


def contacts(count: int, reported: float) -> list[tuple[float, AxisFilter]]:
    """The true offset of the last of three contacts, and the filter, of `count` dockings."""
    random = np.random.default_rng(8)
    dockings = []
    for _ in range(count):
        tracker, place, true = axis(), 0.0, 0.0
        for _ in range(3):
            true = 0.003 - place + random.normal(0.0, 0.00095)
            tracker.update(place, true + random.normal(0.0, math.hypot(reported, 0.15 * true)), reported)
            place = tracker.target
        dockings.append((true, tracker))
    return dockings


@pytest.mark.parametrize("reported", [2e-4, 1.3e-3])
def test_the_offset_of_a_contact_has_its_true_error(reported: float) -> None:
    scores = [(true - tracker.contact.mean) / tracker.contact.stddev for true, tracker in contacts(600, reported)]
    assert np.std(scores) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(scores)) < 0.12


def test_the_risk_of_a_contact_matches_the_observed_frequency() -> None:
    dockings = contacts(600, 1.3e-3)
    predicted = [tracker.contact.beyond(0.0015) for _, tracker in dockings]
    observed = [abs(true) > 0.0015 for true, _ in dockings]
    assert np.mean(predicted) == pytest.approx(np.mean(observed), abs=0.05)


def test_another_contact_pays_if_this_one_is_off() -> None:
    near, far = axis(), axis()
    near.update(0.0, 0.0002, 1e-4)
    far.update(0.0, 0.0028, 1e-4)
    assert near.gain(0.0025) < 1e-3
    assert far.gain(0.0025) > 0.5


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("critical_angle", 0.5),
        ("approach", "wild"),
        ("current_max", 0.4),
        ("lift", math.nan),
        ("clearance_sigmas", 7.0),
    ],
)
def test_impossible_parameters_are_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        DockingParameters(**{name: value})
