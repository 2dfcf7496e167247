# SPDX-License-Identifier: Apache-2.0
"""Rates and lateness for the diagnostics."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltacharger_driver.rate_meter import Lateness, RateMeter


class Clock:
    """A clock set by the test."""

    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_the_rate_counts_since_the_last_call() -> None:
    clock = Clock()
    meter = RateMeter(clock)
    for _ in range(50):
        meter.count()
    clock.now += 0.5
    assert meter.rate() == pytest.approx(100.0)
    clock.now += 2.0
    assert meter.rate() == 0.0
    meter.count()
    clock.now += 0.1
    assert meter.rate() == pytest.approx(10.0)


def test_late_events_are_counted_since_the_start() -> None:
    clock = Clock()
    meter = RateMeter(clock)
    for late in (True, False, True):
        meter.count(late=late)
    clock.now += 1.0
    meter.rate()
    assert meter.late == 2


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=512), st.floats(0.0, 1.0))
def test_a_percentile_is_a_value_that_its_share_does_not_exceed(values: list[float], share: float) -> None:
    lateness = Lateness()
    for value in values:
        lateness.note(value)
    found = lateness.percentile(share)
    assert found in values
    assert sum(value <= found for value in values) >= share * len(values) - 1e-9
    assert lateness.percentile(1.0) == lateness.largest == max(values)


def test_old_values_are_dropped_but_the_largest_is_kept() -> None:
    lateness = Lateness()
    lateness.note(1.0)
    for _ in range(600):
        lateness.note(0.001)
    assert lateness.percentile(1.0) == 0.001
    assert lateness.largest == 1.0
