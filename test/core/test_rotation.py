# SPDX-License-Identifier: Apache-2.0
"""Signs of lean (yaw about +y, pitch about +x, independent of roll about z), and poses."""

from __future__ import annotations

import math
import random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from deltacharger_core.frames import IDENTITY, Pose, apart, composed, inverted, lean, rotation

angles = st.floats(-1.4, 1.4)


def about(axis: str, angle: float) -> tuple[float, float, float, float]:
    sine = math.sin(0.5 * angle)
    return (*(sine if axis == each else 0.0 for each in "xyz"), math.cos(0.5 * angle))  # type: ignore[return-value]


@given(angles)
def test_a_rotation_about_one_axis_leans_only_about_that_axis(angle: float) -> None:
    assert lean(rotation(*about("y", angle))) == pytest.approx((angle, 0.0), abs=1e-12)
    assert lean(rotation(*about("x", angle))) == pytest.approx((0.0, angle), abs=1e-12)
    assert lean(rotation(*about("z", angle))) == (0.0, 0.0)


def drawn(source: random.Random) -> Pose:
    turn = [source.gauss(0.0, 1.0) for _ in range(4)]
    x, y, z, w = (number / math.hypot(*turn) for number in turn)
    return source.uniform(-2.0, 2.0), source.uniform(-2.0, 2.0), source.uniform(-2.0, 2.0), x, y, z, w


def matrix(pose: Pose) -> np.ndarray[Any, Any]:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation(*pose[3:]), pose[:3]
    return found


def test_poses_compose_and_invert_like_matrices() -> None:
    source = random.Random(5)
    for _ in range(100):
        a, b = drawn(source), drawn(source)
        np.testing.assert_allclose(matrix(composed(a, b)), matrix(a) @ matrix(b), atol=1e-12)
        np.testing.assert_allclose(matrix(inverted(a)), np.linalg.inv(matrix(a)), atol=1e-12)
        assert apart(composed(a, inverted(a)), IDENTITY) == pytest.approx((0.0, 0.0), abs=1e-7)
        turn = source.uniform(0.0, math.pi)
        other = composed(a, (0.3, 0.4, 0.0, 0.0, math.sin(0.5 * turn), 0.0, math.cos(0.5 * turn)))
        assert apart(a, other) == pytest.approx((0.5, turn), abs=1e-7)
