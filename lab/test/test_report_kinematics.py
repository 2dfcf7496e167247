# SPDX-License-Identifier: Apache-2.0
"""`deltacharger report kinematics`: its reference, its sets of points, and the compared forms."""

from __future__ import annotations

import numpy as np
import pytest

from deltacharger_kinematics import DeltaGeometry
from deltacharger_lab.reports.kinematics import sets
from deltacharger_lab.reports.kinematics.forms import INVERSE_FORMS, inverse_array, inverse_one
from deltacharger_lab.reports.kinematics.geometries import ADJUSTED
from deltacharger_lab.reports.kinematics.reference import ExactDelta


@pytest.mark.parametrize("geometry", [DeltaGeometry(), DeltaGeometry(limbs=ADJUSTED)], ids=["plain", "adjusted"])
def test_the_reference_brings_points_back_to_30_digits(geometry: DeltaGeometry) -> None:
    """Inverse and forward are independent code, so they agree only if both are right."""
    exact = ExactDelta(geometry)
    points = sets.interior(geometry, np.random.default_rng(3), 20).points
    solved = exact.inverse(points).angles
    nudge = exact.forward(solved.high)
    # The angles are rounded to doubles before the way back, so the error is of that rounding.
    assert nudge.distance(points).max() < 2e-16
    assert (solved.angle_error(solved.high) <= 3e-16).all()


@pytest.mark.parametrize("name", INVERSE_FORMS)
def test_every_closed_form_is_right_inside_the_workspace(name: str) -> None:
    geometry = DeltaGeometry()
    points = sets.interior(geometry, np.random.default_rng(5), 50).points
    truth = ExactDelta(geometry).inverse(points).angles
    form = INVERSE_FORMS[name]
    assert truth.angle_error(inverse_array(form, geometry, points)).max() < 1e-10
    one_by_one = np.array([inverse_one(form, geometry, *point) for point in points.tolist()])
    assert truth.angle_error(one_by_one).max() < 1e-10
