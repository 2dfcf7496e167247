# SPDX-License-Identifier: Apache-2.0
"""Ages of stamps although the computer's clock is set; what docking makes of them is tested in test_inputs."""

from itertools import count

import pytest

from deltacharger_core.real_time import HostClock

LEAD = 1.79e9  # s


class Times:
    """Both clocks of a computer, in s; the test moves them."""

    def __init__(self) -> None:
        self.now, self.lead = 100.0, LEAD
        self.clock = HostClock(lambda: round(1e9 * (self.now + self.lead)), lambda: round(1e9 * self.now))

    def age_of(self, sent: float, lead: float) -> float:
        """Return the age of an order sent at `sent` (s, monotonic), while the clock led by `lead` s."""
        return self.clock.age(sent + lead)


@pytest.mark.parametrize("step", [-5.0, 5.0])
def test_an_order_keeps_its_age_when_the_clock_is_set(step: float) -> None:
    times = Times()
    for times.now in (100.0, 103.0):
        times.clock.lead()
    times.now, times.lead = 103.1, LEAD + step
    assert times.age_of(102.9, LEAD) == pytest.approx(0.2)
    assert times.age_of(100.0, LEAD) == pytest.approx(3.1)
    assert times.age_of(103.05, LEAD + step) == pytest.approx(0.05)


def test_of_two_possible_ages_the_larger_counts() -> None:
    """The process was suspended while the clock was set, so an order may have been sent before that or after it."""
    times = Times()
    times.now, times.lead = 110.0, LEAD + 5.0
    assert times.age_of(104.0, LEAD + 5.0) == pytest.approx(6.0)


def test_a_reading_that_is_interrupted_between_the_clocks_is_no_step() -> None:
    readings = count()

    def monotonic() -> int:
        return 10**9 * next(readings)  # a second passes at each reading

    clock = HostClock(lambda: round(1e9 * (LEAD + next(readings))), monotonic)
    for _ in range(20):
        clock.lead()
    assert (clock.steps, clock.problem()) == (0, "")
