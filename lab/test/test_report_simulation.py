# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report simulation`: its converged reference (kinematics, energy, statics), and arithmetic."""

import math
from dataclasses import replace

import pytest

from deltacharger_lab.reports.simulation import impact, models, reference, scenes
from deltacharger_sim.parameters import WorldParameters
from test.marks import rest


@pytest.mark.parametrize("z", [0.0, 0.0199, 0.0201, 0.05, 0.08, 0.1])
def test_its_kinematics_equal_the_deltas(z: float) -> None:
    theta, first, second = reference.angle(z)
    assert theta == pytest.approx(scenes.DELTA.inverse(0.0, 0.0, z)[0], abs=1e-12)
    assert first == pytest.approx(1.0 / (3.0 * scenes.DELTA.jacobian(0.0, 0.0, z)[6]), rel=1e-8)
    assert second == pytest.approx((reference.angle(z + 1e-5)[1] - reference.angle(z - 1e-5)[1]) / 2e-5, rel=1e-4)


def without_viscosity(parameters: WorldParameters) -> WorldParameters:
    return replace(parameters, servo=replace(parameters.servo, viscosity=0.0))


@pytest.mark.parametrize("contact", [1e5, 1e6, 1e8])
def test_the_spring_stores_the_magnets_work_at_the_peak(contact: float) -> None:
    parameters = without_viscosity(impact.axis_world(contact, 15.0))
    gap, magnets, geometry = 0.003, parameters.magnets, scenes.DELTA.geometry
    found = reference.on_axis(
        parameters, parameters.target.z - gap, [(0.0, 0.0, 0.0)], 0.1
    )  # bound 0: the servos are limp
    work = magnets.force * magnets.range * (1.0 - 1.0 / (1.0 + gap / magnets.range))
    k = 2.0 * contact
    # ½ K x² = W + F x
    depth = (magnets.force + math.sqrt(magnets.force**2 + 2.0 * k * work)) / k
    assert depth < parameters.contact.hard_stop
    assert found.peak == pytest.approx(k * depth, rel=1e-6)
    rotors = 3.0 * parameters.servo.inertia * reference.angle(parameters.target.z)[1] ** 2
    mass = geometry.platform_mass + 1.5 * geometry.rod_mass + rotors
    assert 0.5 * mass * found.speed**2 == pytest.approx(work, rel=1e-5)


@pytest.mark.parametrize("contact", [1e3, 1e5, rest(1e7)])
def test_it_converges_and_comes_to_rest_where_springs_and_magnets_balance(contact: float) -> None:
    parameters = impact.axis_world(contact, 15.0)
    orders = [(0.0, reference.angle(0.086)[0], 4.1)]
    rough, fine = (reference.on_axis(parameters, 0.07, orders, 1.0, tolerance=each) for each in (1e-6, 1e-9))
    assert rough.peak == pytest.approx(fine.peak, rel=1e-5)
    assert fine.force == pytest.approx(scenes.settled_exactly(parameters, 0.086), rel=1e-5)
    assert fine.left < 1e-5
    assert fine.peak > fine.force


@pytest.mark.rest
@pytest.mark.parametrize(("contact", "steps"), [(1e6, (0.001, 0.005, 0.01, 0.02)), (1e3, (0.01,))])
def test_peaks_in_steps_of_docking_are_within_the_stated_limits(contact: float, steps: tuple[float, ...]) -> None:
    rows = impact.strikes(contact, 15.0, steps)
    assert {row["strike"] for row in rows if not row["grazes"]} == {strike.name for strike in impact.STRIKES}
    for row in rows:
        assert abs(row["percent"]) < 15.0 or row["grazes"]


def test_a_diverged_point_is_never_proven() -> None:
    good = {"bounded": True, "force_percent": 0.1, "path_mm": 0.1, "peak_percent": -3.0, "speed": 0.0}
    assert models._cell(good) == models.PROVEN
    for change in ({"bounded": False}, {"force_percent": float("nan")}, {"speed": 0.1}, {"speed": float("nan")}):
        assert models._cell({**good, **change}) == models.DIVERGED
    assert models._cell({**good, "force_percent": 0.6}) == models.FORCE_OFF
    assert models._cell({**good, "path_mm": 0.4}) == models.PATH_OFF
    for peak in (-16.0, 16.0, float("nan")):
        assert models._cell({**good, "peak_percent": peak}) == models.PEAK_OFF
