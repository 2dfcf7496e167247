# SPDX-License-Identifier: Apache-2.0
"""A campaign adds the scene's errors to estimates, and records estimates with the truth."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from deltacharger_docking import clearance, observation, parameters
from deltacharger_lab.campaigns import disturbances, docking, estimates, keys, published
from deltacharger_lab.campaigns.scene import parse_campaign_scene

from .campaigns import QUICK

STDDEV = {"angle_stddev": 0.002, "vertical_stddev": 0.0002, "horizontal_stddev": 0.0012, "across_stddev": 0.0002}
ACROSS = 0.001 * math.cos(0.05) + 0.003 * math.sin(0.05)
ESTIMATE = clearance.MisalignmentEstimate(angle=0.05, vertical=0.001, horizontal=-0.003, across=ACROSS, **STDDEV)
TRUTH = (-0.002, 0.0012, 0.052)


def charger(truth: tuple[float, float, float] | None = TRUTH) -> Any:
    """Return a charger with what `EstimateLog` needs."""
    world = SimpleNamespace(misalignment=truth, snapshot=lambda: SimpleNamespace(clearance=0.004))
    return SimpleNamespace(world=world, answer={}, model=None, parameters=parameters.DockingParameters())


def answers(
    errors: keys.EstimatorErrors, count: int, seed: int = 1
) -> tuple[estimates.EstimateLog, list[clearance.MisalignmentEstimate]]:
    """Return the changed `ESTIMATE`, this many times."""
    stand_in = charger()
    log = estimates.EstimateLog(stand_in, errors, seed)
    replies = [
        stand_in.answer[observation.Service.ESTIMATE](observation.Reply(1, True, estimate=ESTIMATE))
        for _ in range(count)
    ]
    return log, [reply.estimate for reply in replies]


def test_without_errors_an_estimate_is_unchanged_and_bias_and_scale_are_exact() -> None:
    log, found = answers(keys.EstimatorErrors(), 2)
    assert found == [ESTIMATE, ESTIMATE]
    assert (log.count, log.last.clearance) == (2, 0.004)
    assert log.last.error == pytest.approx({"horizontal": -0.001, "vertical": -0.0002, "angle": -0.002})
    assert log.last.stddev == {axis: getattr(ESTIMATE, f"{axis}_stddev") for axis in estimates.AXES}
    errors = keys.EstimatorErrors(bias_horizontal=0.0005, bias_vertical=-0.0005, bias_angle=0.01, stddev_scale=0.5)
    _, (one,) = answers(errors, 1)
    assert [one.horizontal, one.vertical, one.angle] == pytest.approx([-0.0025, 0.0005, 0.06])
    assert one.horizontal_stddev == pytest.approx(0.0006)
    assert (one.sure, one.in_range, one.contact) == (ESTIMATE.sure, ESTIMATE.in_range, ESTIMATE.contact)


def test_a_row_has_the_values_at_rest_and_the_estimates_with_the_truth() -> None:
    scene = parse_campaign_scene(QUICK, "quick")
    row = docking.dock_once(scene, 3, 1)
    assert (row["charged"], row["ended"], set(row)) == (True, "", set(docking.columns(scene)))
    assert 0.4 <= row["rest_current"] <= 0.5
    servos = [row[f"servo_current_{index}"] for index in (1, 2, 3)]
    assert row["servo_current_hottest"] == max(servos)
    assert row["rest_current"] / 2 < sum(servos) / 3 < 2 * row["rest_current"]
    assert 10.0 < row["rest_push"] <= row["servo_push"] <= 25.0
    assert row["energised"] > disturbances.SECONDS
    assert row["last_vertical_error"] == pytest.approx(row["estimated_vertical"] - row["final_vertical"], abs=1e-4)
    assert row["last_clearance"] == pytest.approx(row["clearance"], abs=3e-4)
    assert row["estimates"] > row["moves"]
    refused = docking.dock_once(parse_campaign_scene({"shift": {"roll": 0.25}}, "x"), 3, 0)
    assert (math.isnan(refused["rest_current"]), refused["energised"]) == (True, 0.0)
    assert math.isfinite(refused["first_angle_error"])


def test_the_papers_classes_are_those_of_the_packaged_cnn() -> None:
    content = {"estimator": {"paper": True}}
    row = docking.dock_once(parse_campaign_scene({**QUICK, **content}, "x"), 3, 0)
    assert row["error"] == ""
    assert {row[f"{name}_stddev"] for name in ("first_angle", "last_horizontal", "last_vertical")} == {0.0}
    assert math.degrees(row["estimated_angle"]) == pytest.approx(round(math.degrees(row["estimated_angle"])))
    classes = published.PaperClasses().predict(*np.random.default_rng(1).uniform(0.0, 4.0, (2, 10, 10)))
    assert {classes.horizontal, classes.vertical} <= {-0.01, -0.005, 0.0, 0.005, 0.01}


def test_as_published_the_cnns_classes_move_the_arm_and_charge_whatever_clearance_they_leave() -> None:
    content = {**QUICK, "estimator": {"paper": True, "bias_angle": 0.1}, "published": True}
    row = docking.dock_once(parse_campaign_scene(content, "x"), 3, 0)
    assert (row["error"], row["charged"], row["undocked"]) == ("", True, "")
    assert row["energised"] > 0.0
    content["estimator"] = {"paper": True, "position_stddev": 0.0002}  # never exactly zero
    row = docking.dock_once(parse_campaign_scene(content, "x"), 3, 0)
    assert (row["charged"], row["moves"], row["aligned"]) == (True, 15, False)
