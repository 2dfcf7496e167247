# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report kinematics`: its reference, and its headline on few points."""

import dataclasses

import numpy as np
import pytest

from deltacharger_kinematics import DeltaGeometry
from deltacharger_lab.reports.kinematics import reference, report, sets


@pytest.mark.parametrize("geometry", [DeltaGeometry(), DeltaGeometry(limbs=sets.ADJUSTED)], ids=["plain", "adjusted"])
def test_the_reference_brings_points_back_to_30_digits(geometry: DeltaGeometry) -> None:
    """Inverse and forward are independent code, so they agree only if both are right."""
    exact = reference.ExactDelta(geometry)
    points = sets.interior(geometry, np.random.default_rng(3), 20).points
    solved = exact.inverse(points).angles
    nudge = exact.forward(solved.high)
    # The angles are rounded to doubles before the way back, so the error is of that rounding.
    assert nudge.distance(points).max() < 2e-16
    assert (solved.angle_error(solved.high) <= 3e-16).all()


def test_the_frozen_headline_holds_on_few_points() -> None:
    """docs/reports/kinematics.md, version 1.0.0, seed 1: errors at rounding, no wrong decision on reach."""
    plan = dataclasses.replace(report.make_plan(1, True), points=50)
    exact, solvers = reference.ExactDelta(), report.inverse_solvers(DeltaGeometry())
    samples = report.inverse_samples(exact, plan)
    for solver in solvers:
        for sample in samples:
            error, missing, wrong = report.inverse_errors(sample, solver.solve(sample.points.points))
            assert not missing.any()
            assert not wrong.any()
            assert error.max() <= 1e-15, (solver.name, sample.points.name)
    _, decisions = report.reach_decisions(solvers, exact, samples[1].points, plan)
    assert {count for row in decisions.values() for count in row.values()} == {0}
