# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report simulation`: the measured laws of the simulated charger, and the command's contract."""

from __future__ import annotations

import importlib.util
import math
from typing import Any

import pytest

from deltacharger_lab.reports.simulation import extremes as simulation_extremes
from deltacharger_lab.reports.simulation import impact, lean, stability
from deltacharger_lab.reports.simulation import plan as simulation_plan
from deltacharger_lab.reports.simulation.parts import PADS, PARTS
from deltacharger_lab.reports.simulation.scenes import LIGHT, docking, rms, world
from deltacharger_sim import stability_map
from deltacharger_sim.proven import proven

from .conftest import Quick

WITH_MUJOCO = importlib.util.find_spec("mujoco") is not None

REPORT = ("simulation",)
MEASURES_WITH = ("matplotlib",)


def test_targets_independent_of_the_machine_are_met(quick_report: Quick) -> None:
    verdicts = {target["name"]: target["met"] for target in quick_report[2]["targets"]}
    lean_speed = "light model at 10 ms with lean and compliance, in motion, slowest"
    machine = {"light model at 10 ms, in motion", lean_speed, "run time of this report"}
    assert machine < set(verdicts)
    assert all(met for name, met in verdicts.items() if name not in machine), verdicts


def test_every_model_has_a_row_for_every_step_and_the_light_one_an_answer(quick_report: Quick) -> None:
    figures = quick_report[2]
    found = {(row["model"], row["step"]): row for row in figures["errors"]}
    assert set(found) == {(name, step) for name in figures["models"] for step in figures["steps"]}
    errors = [found[LIGHT, step]["rms_mm"] for step in figures["steps"]]
    assert errors == sorted(errors)
    assert all(abs(found[LIGHT, step]["force_percent"]) < 1e-3 for step in figures["steps"])


@pytest.mark.skipif(not WITH_MUJOCO, reason="the reference of the simulation is deltacharger[sim]")
def test_the_reference_confirms_the_light_model_and_knows_where_others_diverge(quick_report: Quick) -> None:
    figures = quick_report[2]
    assert figures["references_apart_mm"] < 0.05
    fast = [point["cell"] for point in figures["map"] if point["model"] == simulation_plan.MUJOCO_FAST]
    assert stability.DIVERGED in fast
    usual = [point for point in figures["map"] if point["model"] == simulation_plan.MUJOCO_USUAL]
    lost = [point for point in usual if point["cell"] == stability.DIVERGED]
    assert len(lost) < fast.count(stability.DIVERGED)  # its guard softens contacts that would diverge
    codes = {row["code"] for row in figures["dockings"] if row["docking"] == 1}
    assert codes == {"NONE"}


def test_every_extreme_and_every_part_is_listed(quick_report: Quick) -> None:
    _, _, figures, page = quick_report
    for scene in simulation_extremes.SCENES:
        assert f"| {scene.name} |" in page
    assert {row["part"] for row in figures["costs"]} == {*PARTS, PADS}
    docked = {row["part"] for row in figures["parts"]}
    assert docked == set(list(PARTS)[: simulation_plan.QUICK.parts])
    assert all(row["step_us"] > 0.0 and row["memory_kb"] > 0.0 for row in figures["costs"])


def test_leaning_contacts_are_listed_and_rest_like_the_reference(quick_report: Quick) -> None:
    _, _, figures, page = quick_report
    assert "## Leaning contacts" in page
    cases = lean.cases(simulation_plan.QUICK)
    assert {(row["name"], row["step"]) for row in figures["lean"]} == {
        (case.name, step) for case in cases for step in lean.STEPS
    }
    assert {row["case"] for row in figures["lean_times"]} == {"level", *(row["case"] for row in figures["lean"])}
    for row in figures["lean"]:
        assert abs(row["force_percent"]) < 3.0
        assert row["tilt_deg"] < 0.2
        assert abs(row["share_percent"]) < 1.0
    for row in figures["lean_remains"]:
        rest = [point["rest"] for point in row["yaws"]]
        assert rest == sorted(rest)
        assert all(point["rest"] < point["yaw"] or row["compliance"] == 0.0 for point in row["yaws"])
    # With both bars flat, force and compliance give the pitch at which one lifts: F/(2 k up) + c F up.
    for row in figures["lean_remains"]:
        force, up = 80.0, 0.0087
        lifts = math.degrees(force / (2.0 * row["contact"] * up) + row["compliance"] * force * up)
        assert row["bar_lifts"] == pytest.approx(lifts, rel=0.05)


def test_peaks_are_right_when_those_of_steps_ends_are_not(quick_report: Quick) -> None:
    rows = quick_report[2]["strikes"]
    assert {row["strike"] for row in rows} == {strike.name for strike in impact.STRIKES}
    assert {row["contact"] for row in rows} == set(simulation_plan.QUICK.strike_contacts)
    for row in rows:
        assert row["grazes"] or abs(row["percent"]) <= 15.0, row
    stiff = [row for row in rows if row["contact"] >= 1e6 and row["step"] >= 0.005]
    assert all(row["ends_percent"] < -20.0 for row in stiff)


def test_the_complete_model_in_tiny_steps_converges_to_the_references_peak(quick_report: Quick) -> None:
    for row in quick_report[2]["tiny_steps"]:
        assert 0.8 < row["order"] < 1.2, row
        assert all(abs(percent) < 5.0 for percent in row["percent"].values()), row
        if row["name"] == "on the axis":
            assert row["limit"] == pytest.approx(row["exact"], rel=0.01)


def test_energy_only_falls_and_its_losses_are_complete(quick_report: Quick) -> None:
    for row in quick_report[2]["energy"]:
        assert row["gain"] < 0.01 * row["released"], row["scene"]
        for part in ("servos' damping", "gears' friction", "electrodes' friction"):
            assert row["lost"][part] > -1e-3 * row["released"], (row["scene"], part)


def test_the_packages_map_agrees_with_the_report(quick_report: Quick) -> None:
    points = [point for point in quick_report[2]["map"] if point["model"] == LIGHT]
    assert points
    for point in points:
        servo = stability_map.SERVO_STIFFNESSES.index(point["servo"])
        contact = stability_map.CONTACT_STIFFNESSES.index(point["contact"])
        step = stability_map.STEPS.index(point["step"])
        assert proven(servo, contact, step) == (point["cell"] == stability.PROVEN), point
    text = (quick_report[0] / stability.MODULE).read_text("utf-8")
    written: dict[str, Any] = {}
    exec(compile(text, stability.MODULE, "exec"), written)
    assert written["STEPS"] == simulation_plan.QUICK.map_steps
    assert [len(rows) for rows in written["CELLS"]] == [len(written["CONTACT_STIFFNESSES"])]


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
