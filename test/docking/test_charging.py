# SPDX-License-Identifier: Apache-2.0
"""What ends charging: full, cut off or dirty, by what charger_power shows.

The circuit is a few lines: a stage of constant current and voltage, contacts, a target, 20 times a second.
"""

import math
import random
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from deltacharger_core.machine import ChargeLimits
from deltacharger_docking import charging, codes, context, observation, parameters
from deltacharger_kinematics.geometry import DeltaGeometry

SEVEN = parameters.TargetProfile(19.0, 29.4, 10.0, 0.5)
PERIOD = 0.05


@dataclass
class Target:
    """A battery of `volts` behind `inner` Ω that fills at `rate` V/(A·s), through contacts of `dirt` Ω.

    It takes `most` A. `takes` is the share of a period in which it takes current, `load` (W) what the robot uses.
    """

    volts: float = 24.0
    inner: float = 0.15
    most: float = 99.0
    dirt: float = 0.0
    rate: float = 0.0
    takes: float = 1.0
    load: float = 0.0

    def power(self, limit: float, seconds: float) -> tuple[float, float, float]:
        """Return mean and least current (A), and the voltage (V) at the charger's electrodes."""
        drawn = self.load / 29.4
        driven = min((29.4 - self.volts) / (self.inner + self.dirt) + drawn, limit, self.most)
        current = max(driven, 0.0) * self.takes
        self.volts += max(current - drawn, 0.0) * self.rate * seconds
        least = current if self.takes == 1.0 else 0.0
        if current == 0.0:
            return 0.0, 0.0, 29.4  # the stage's own
        return current, least, self.volts + (driven - drawn) * (self.inner + self.dirt)


class Charge:
    """Charges one target after the other, as docking does after a probe."""

    def __init__(self, profile: parameters.TargetProfile = SEVEN) -> None:
        self.profile = profile
        self.shared = context.Context(parameters.DockingParameters(), DeltaGeometry(), profiles={"one": profile})
        self.now = 0.0

    def run(self, target: Target, seconds: float, change: Callable[[float], None] = lambda at: None) -> str:
        """Return how charging ends; '' = it goes on. `change` may change the target at each time (s)."""
        live = math.nan if self.profile.port == "dead" else target.volts
        self.shared.limits = ChargeLimits(self.profile.current, self.profile.full_voltage)
        self.shared.closing = context.Live(self.now, live)
        self._show(target)
        self.charged, self.limits, begun = charging.Charged(self.shared, self.profile), [], self.now
        while self.now < begun + seconds:
            change(self.now - begun)
            self._show(target)
            self.limits.append(self.shared.limits.current)
            if why := self.charged.judge():
                return why
        return ""

    def _show(self, target: Target) -> None:
        self.now += PERIOD
        mean, least, volts = target.power(self.shared.limits.current, PERIOD)
        seen = {"contactor_closed": True, "charge_current": mean, "least_current": least, "target_voltage": volts}
        self.shared.observe(observation.Observation(self.now, power_age=0.0, battery_voltage=26.0, **seen))


def noisy(target: Target, source: random.Random) -> Target:
    """Return the target as measured with 10 mV, 10 mA and steps of 10 mV; the least of 50 readings is lower."""
    power = target.power

    def measured(limit: float, seconds: float) -> tuple[float, float, float]:
        mean, least, volts = power(limit, seconds)
        mean = abs(mean + source.gauss(0.0, 0.01))
        return mean, least - source.uniform(0.06, 0.12), 0.01 * round(100.0 * (volts + source.gauss(0.0, 0.01)))

    target.power = measured  # type: ignore[method-assign]
    return target


def set_at(target: Target, when: float, **values: Any) -> Callable[[float], None]:
    """Return a change of the target's values from this time (s) on."""

    def change(at: float) -> None:
        if at >= when:
            vars(target).update(values)

    return change


def test_a_battery_is_full_when_its_current_has_tapered_off_at_full_voltage() -> None:
    charge, target = Charge(), Target(24.0, rate=0.002)
    assert charge.run(target, 900.0) == "current below 0.5 A"
    assert target.volts > 29.2
    assert len([one for one in charge.limits if one < 10.0]) < 0.03 * len(charge.limits), "dips are short"
    assert charge.charged.rise == 0.0
    assert charge.shared.limits.current == 10.0


@pytest.mark.parametrize("profile", [SEVEN, replace(SEVEN, end_current=0.15, current=2.0)])
def test_noise_ends_nothing_and_hides_neither_a_full_battery_nor_a_film(profile: parameters.TargetProfile) -> None:
    target = noisy(Target(28.5, rate=0.0006), random.Random(1))
    assert Charge(profile).run(target, 3000.0) == f"current below {profile.end_current} A"
    assert target.volts > 29.3
    for volts in (19.5, 24.0, 27.0):
        for dirt in (20.0, 60.0):
            target = noisy(Target(volts), random.Random(2))
            with pytest.raises(codes.NoChargeCurrent):
                Charge(profile).run(target, 90.0, set_at(target, 20.0, dirt=dirt))


@pytest.mark.parametrize(("volts", "full"), [(29.15, True), (28.0, False)])
def test_a_battery_management_that_cuts_off_is_full_only_at_full_voltage(volts: float, full: bool) -> None:
    """After the cut the stage's own voltage shows, and before it what the current adds."""
    charge, target = Charge(), Target(volts, inner=0.04)
    if full:
        assert charge.run(target, 30.0, set_at(target, 10.0, takes=0.0)) == "cut by the target"
    else:
        with pytest.raises(codes.NoChargeCurrent, match=r"current ended at 28\.0 V of 29\.4 V: not full"):
            charge.run(target, 30.0, set_at(target, 10.0, takes=0.0))


def test_pulses_at_full_voltage_are_full_and_others_are_gaps() -> None:
    def pulse(target: Target) -> Callable[[float], None]:
        return lambda at: vars(target).update(takes=0.0 if at % 2.0 > 1.9 else 1.0)

    target = Target(29.2)
    assert Charge().run(target, 60.0, pulse(target)) == "cut by the target"
    target = Target(26.0)
    assert Charge().run(target, 60.0, pulse(target)) == ""


def test_contact_bounces_and_gaps_within_gap_time_are_tolerated() -> None:
    target = Target(25.0)
    bounces: Callable[[float], None] = lambda at: vars(target).update(takes=1.0 if at % 1.0 > 0.1 else 0.6)  # noqa: E731
    assert Charge().run(target, 60.0, bounces) == ""
    slow = Target(25.0)
    gaps: Callable[[float], None] = lambda at: vars(slow).update(takes=1.0 if at % 30.0 < 21.0 else 0.0)  # noqa: E731
    assert Charge(replace(SEVEN, gap_time=10.0)).run(slow, 120.0, gaps) == ""


def test_a_robot_that_stays_on_is_full_by_its_standing_load() -> None:
    steady, told = Target(29.4, load=17.0), replace(SEVEN, standing_load=17.0)
    assert Charge(told).run(steady, 120.0) == "current below 1.08 A"
    charge = Charge()
    assert charge.run(steady, 590.0) == ""
    assert Charge().run(Target(29.4, load=17.0), 650.0) == "steady load"


def test_a_regulated_input_whose_port_shows_no_battery_is_full_only_by_a_small_current() -> None:
    """It takes the same power from full voltage all the time; switched off, it looks like a battery that is full."""
    dead = replace(SEVEN, port="dead")
    assert Charge(dead).run(Target(29.4, load=60.0), 900.0) == ""
    assert Charge(dead).run(Target(29.4, load=10.0), 60.0) == "current below 0.5 A"
    target = Target(29.4, load=60.0)
    with pytest.raises(codes.NoChargeCurrent, match="whether the target is full is unknown"):
        Charge(dead).run(target, 60.0, set_at(target, 40.0, load=0.0))
    target = Target(29.4, load=60.0)
    tapers: Callable[[float], None] = lambda at: vars(target).update(load=max(60.0 - 2.0 * at, 0.0))  # noqa: E731
    assert Charge(dead).run(target, 60.0, tapers) == "cut by the target"
    diode = Target(26.0, rate=0.002, load=17.0)
    assert Charge(dead).run(diode, 1500.0) == "steady load"


@pytest.mark.parametrize("current", [0.3, 0.1])
def test_a_battery_too_cold_to_charge_is_not_full(current: float) -> None:
    target = Target(24.5)
    with pytest.raises(
        codes.NoChargeCurrent, match=f"only {current:.2f} A flow at 2[46].. V of 29.4 V: not full; .*cold"
    ):
        Charge().run(target, 60.0, set_at(target, 5.0, most=current))
    assert Charge(replace(SEVEN, least_current=0.05)).run(Target(24.5, most=current), 60.0) == ""


def test_dirt_lowers_the_current_and_never_shows_a_full_battery() -> None:
    charge, target = Charge(), Target(24.0)
    grow: Callable[[float], None] = lambda at: vars(target).update(dirt=0.2 if at > 40.0 else 0.0)  # noqa: E731
    assert charge.run(target, 200.0, grow) == ""
    assert charge.charged.rise == pytest.approx(0.2, abs=0.02)
    assert charge.limits[-1] == pytest.approx(math.sqrt(10.0 / 0.2), rel=0.05)
    hot = [limit for at, limit in enumerate(charge.limits) if PERIOD * at > 40.0 and limit**2 * 0.2 > 11.5]
    assert len(hot) * PERIOD < 10.0, "the voltage's rise calls for an early dip"


def test_a_contact_that_is_dirty_from_the_start_shows_against_the_cleanest_one() -> None:
    charge = Charge()
    assert charge.run(Target(24.0), 20.0) == ""
    assert charge.run(Target(24.0, dirt=0.4), 20.0) == ""
    assert charge.limits[-1] == pytest.approx(5.0, rel=0.05)
    with pytest.raises(codes.NoChargeCurrent, match=r"contact resistance rose to \d+ mΩ: clean the electrodes"):
        charge.run(Target(19.0, dirt=12.0), 60.0)
