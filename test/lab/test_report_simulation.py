# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report simulation`: its plan and its arithmetic."""

from __future__ import annotations

import math

import pytest

from deltacharger_lab.reports.simulation import impact, stability
from deltacharger_lab.reports.simulation import plan as simulation_plan
from deltacharger_lab.reports.simulation.scenes import LIGHT, docking, rms, world
from deltacharger_sim import stability_map


def test_the_packaged_map_has_the_points_of_the_full_plan() -> None:
    plan = simulation_plan.SimulationPlan()
    assert plan.map_steps == stability_map.STEPS
    assert plan.map_contacts == stability_map.CONTACT_STIFFNESSES
    assert plan.map_servos == stability_map.SERVO_STIFFNESSES


def test_a_path_has_distance_0_from_itself_at_any_sampling() -> None:
    fine = docking(LIGHT, world(), 0.005)["trace"]
    assert rms(fine, fine) == 0.0
    assert rms(fine[1::2], fine) == 0.0
    assert rms([(x, y, z + 1e-3) for x, y, z in fine], fine) == pytest.approx(1e-3)


def test_the_worst_error_of_none_or_of_an_unknown_one_is_unknown() -> None:
    rows = [{"step": 0.01, "contact": 1e5, "percent": each, "grazes": each == 40.0} for each in (3.0, -8.0, 40.0)]
    assert impact.worst(rows[:2], step=0.01) == -8.0
    assert math.isnan(impact.worst(rows, step=0.02))
    assert math.isnan(impact.worst([*rows, {**rows[0], "percent": math.nan}]))
    assert (impact.at_docking(rows), impact.at_docking(rows, grazing=False)) == (40.0, 8.0)


def test_a_diverged_point_is_never_proven() -> None:
    good = {"bounded": True, "force_percent": 0.1, "path_mm": 0.1, "peak_percent": -3.0, "speed": 0.0}
    assert stability._cell(good) == stability.PROVEN
    for change in ({"bounded": False}, {"force_percent": float("nan")}, {"speed": 0.1}, {"speed": float("nan")}):
        assert stability._cell({**good, **change}) == stability.DIVERGED
    assert stability._cell({**good, "force_percent": 0.6}) == stability.FORCE_OFF
    assert stability._cell({**good, "path_mm": 0.4}) == stability.PATH_OFF
    for peak in (-16.0, 16.0, float("nan")):
        assert stability._cell({**good, "peak_percent": peak}) == stability.PEAK_OFF
