# SPDX-License-Identifier: Apache-2.0
"""Results of extreme inputs, without numpy warnings, alone and inside a batch."""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry, Inverse, KinematicsError, LimbAdjustment, Status
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_kinematics.status import NO_ANSWER

DELTA = Delta()
DOCK = (0.0, 0.0, 0.080)
LIMBS = Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2
# Powers of two, so that the edge of reach is a double: motor axis 0.125 outward of the joint, arm 0.25, rod 0.5.
BINARY = DeltaGeometry(base_radius=0.25, platform_radius=0.125, arm=0.25, rod=0.5, z_offset=0.5)
SQUARE = DeltaGeometry(base_radius=0.25, platform_radius=0.125, arm=0.25, rod=0.25, z_offset=0.5)
LONG_ARM = Delta(DeltaGeometry(arm=0.25, rod=0.125, base_radius=0.25, platform_radius=0.25, z_offset=0.0))

pytestmark = pytest.mark.filterwarnings("error")


@pytest.fixture(autouse=True)
def floating_point_traps() -> Any:
    with np.errstate(all="raise"):
        yield


def alone_and_in_a_batch(delta: Delta, point: tuple[float, float, float]) -> Inverse:
    alone = delta.inverse(point)
    batch = delta.inverse([DOCK, point, DOCK])
    assert np.allclose(batch.angles[1], alone.angles, rtol=0.0, atol=4e-16, equal_nan=True)
    assert np.asarray(batch.status)[1] == alone.status
    assert np.array_equal(np.asarray(batch.margin)[1], alone.margin, equal_nan=True)
    expected = delta.inverse(DOCK)
    for row in (0, 2):
        assert np.allclose(batch.angles[row], expected.angles, rtol=0.0, atol=4e-16, equal_nan=True)
        assert np.asarray(batch.status)[row] == expected.status
    return alone


@pytest.mark.parametrize(
    ("value", "status"),
    [
        *((value, Status.INVALID_INPUT) for value in (math.nan, math.inf, -math.inf)),
        *((value, Status.UNREACHABLE_FAR | LIMBS) for value in (1e200, -1e200, 1e308, -sys.float_info.max)),
    ],
)
@pytest.mark.parametrize("axis", range(3))
def test_non_finite_input_is_invalid_and_overflow_unreachable(value: float, status: Status, axis: int) -> None:
    point = (*DOCK[:axis], value, *DOCK[axis + 1 :])
    solved = alone_and_in_a_batch(DELTA, point)
    assert solved.status == status
    assert np.isnan(solved.angles).all()
    assert np.array_equal(solved.margin, math.nan if status == Status.INVALID_INPUT else -math.inf, equal_nan=True)
    assert np.isnan(ScalarDelta().inverse(*point)).all()


@pytest.mark.parametrize("tiny", [5e-324, -5e-324, 2.2e-308, -0.0, 1e-200])
def test_denormals_and_negative_zero_are_exact(tiny: float) -> None:
    for precise in (False, True):
        solved = DELTA.inverse((tiny, tiny, 0.08), precise=precise)
        assert solved.status == Status.OK
        assert np.array_equal(solved.angles, DELTA.inverse((0.0, 0.0, 0.08), precise=precise).angles)
    assert np.isfinite(alone_and_in_a_batch(DELTA, (tiny, tiny, 0.08)).angles).all()


@pytest.mark.parametrize(
    ("delta", "point", "reason"),
    [
        (DELTA, (0.0, 0.0, 0.5), Status.UNREACHABLE_FAR),
        (DELTA, (0.0, 0.3, 0.0), Status.UNREACHABLE_LATERAL),
        (DELTA, (0.0, 0.0, -0.095), Status.UNREACHABLE_NEAR),
        (DELTA, (0.0, 0.0, 1e5), Status.UNREACHABLE_FAR),
        (LONG_ARM, (0.0, 0.0, 0.1), Status.UNREACHABLE_NEAR),
        (LONG_ARM, (0.0, 0.0, 0.4), Status.UNREACHABLE_FAR),
    ],
)
def test_out_of_reach_states_reason_and_limb(delta: Delta, point: tuple[float, float, float], reason: Status) -> None:
    solved = alone_and_in_a_batch(delta, point)
    limbs = [bool(solved.status & bit) for bit in (Status.LIMB_0, Status.LIMB_1, Status.LIMB_2)]
    assert reason in solved.status
    assert np.isnan(solved.angles).tolist() == limbs
    assert solved.margin < 0.0


@pytest.mark.parametrize(("x", "angle"), [(0.125 + 0.75, 0.0), (0.125 + 0.25, math.pi)])
def test_exactly_at_the_edge_there_is_an_angle_and_no_margin(x: float, angle: float) -> None:
    solved = alone_and_in_a_batch(Delta(BINARY), (x, 0.0, -0.5))
    assert solved.angles[0] == angle
    assert np.isnan(solved.angles[1:]).all() or solved.margin == 0.0
    if solved.margin == 0.0:
        assert Status.NEAR_TYPE_1 | Status.LIMB_0 in solved.status


@pytest.mark.parametrize("distance", [0.0, 5e-324, 1e-170, 1e-30, 1e-20])
def test_a_platform_joint_on_its_motor_axis_turns_freely(distance: float) -> None:
    limbs = (LimbAdjustment(radius_offset=distance), LimbAdjustment(), LimbAdjustment())
    geometry, point = dataclasses.replace(SQUARE, limbs=limbs), (0.125, 0.0, -0.5)
    solved = alone_and_in_a_batch(Delta(geometry), point)
    assert solved.status == Status.INDETERMINATE | Status.LIMB_0
    assert math.isnan(solved.angles[0])
    assert math.isnan(solved.margin)
    if not distance:
        assert np.isnan(ScalarDelta(geometry).inverse(*point)).all()
        assert np.isnan(Delta(geometry).jacobian(point).matrix).all()


@pytest.mark.parametrize("kind", [np.float32, np.float16, np.int64, np.uint8, ">f8", np.longdouble, object])
def test_other_number_types_and_layouts_are_computed_in_doubles(kind: Any) -> None:
    points = np.random.default_rng(1).uniform(0.0, 0.05, (4, 5, 3)).astype(kind)
    expected = DELTA.inverse(points.astype(float).reshape(-1, 3)).angles.reshape(points.shape)
    wide = np.zeros((4, 5, 6), dtype=kind)
    wide[..., ::2] = points
    points.flags.writeable = False
    for layout in (points, np.asfortranarray(points), wide[..., ::2], points[::-1][::-1], points.tolist()):
        solved = DELTA.inverse(layout)
        assert solved.angles.dtype == np.float64
        assert np.array_equal(solved.angles, expected)
    assert np.allclose(DELTA.inverse(points[0, 0]).angles, expected[0, 0], rtol=0.0, atol=4e-16)


def test_empty_batches_stay_empty() -> None:
    for shape in ((0, 3), (2, 0, 3)):
        empty = np.empty(shape)
        solved, met = DELTA.inverse(empty), DELTA.forward(empty)
        assert solved.angles.shape == met.position.shape == shape
        assert np.shape(solved.status) == np.shape(solved.margin) == np.shape(met.determinant) == shape[:-1]
        assert DELTA.jacobian(empty).matrix.shape == (*shape, 3)
        assert DELTA.contact_force(empty, empty).shape == shape


@pytest.mark.parametrize(
    "bad",
    [
        *(["1", "2", "3"], "abc", None, [None, 0.0, 0.0], [1j, 0.0, 0.0], [True, False, False]),
        *(np.zeros(3, dtype="datetime64[s]"), [10**400, 0, 0], [1.0, 2.0], np.zeros((5, 4)), 0.1, []),
        *([[1.0, 2.0, 3.0], [1.0, 2.0]], {"x": 0.0}),
    ],
    ids=repr,
)
def test_an_invalid_array_is_refused_by_name(bad: Any) -> None:
    calls: list[tuple[str, Any, tuple[Any, ...]]] = [
        *(("position", call, (bad,)) for call in (DELTA.inverse, DELTA.jacobian)),
        ("position", DELTA.torque, (bad, DOCK)),
        ("angles", DELTA.forward, (bad,)),
        ("force", DELTA.torque, (DOCK, bad)),
        ("torque", DELTA.force, (DOCK, bad)),
        ("gravity", DELTA.holding_torque, (DOCK, bad)),
        ("current", DELTA.contact_force, (DOCK, bad)),
    ]
    for name, function, values in calls:
        with pytest.raises(ValueError, match=f"^{name}: "):
            function(*values)


def test_mismatched_shapes_are_refused_by_name() -> None:
    with pytest.raises(ValueError, match=r"^force: shape \(5, 3\) does not fit \(4, 3\)"):
        DELTA.torque(np.zeros((4, 3)), np.zeros((5, 3)))
    assert DELTA.torque(np.zeros((4, 1, 3)), np.zeros((5, 3))).shape == (4, 5, 3)


def test_masked_and_nan_values_are_unknown() -> None:
    points = np.ma.masked_array([DOCK, DOCK], mask=[[0, 0, 0], [0, 1, 0]])
    assert np.asarray(DELTA.inverse(points).status).tolist() == [0, Status.INVALID_INPUT]
    assert np.isnan(DELTA.torque(DOCK, (math.nan, 0.0, 0.0))).any()
    assert np.isnan(DELTA.torque((0.0, 0.0, 0.8), (0.0, 0.0, 1.0))).all()
    assert np.isnan(DELTA.force((0.0, 0.0, 0.8), (0.1, 0.1, 0.1))).all()
    assert np.isnan(DELTA.contact_force((math.nan, 0.0, 0.0), (0.1, 0.1, 0.1))).all()
    assert np.isfinite(DELTA.torque(DOCK, (1e300, 0.0, 0.0))).all()


def test_elbows_in_a_line_or_too_far_apart() -> None:
    level = Delta(DeltaGeometry(base_radius=0.05, platform_radius=0.05))
    straight_up = (math.pi / 2,) * 3  # the three elbows coincide
    apart = Delta(DeltaGeometry(base_radius=0.4, rod=0.11))
    for delta, arms, status in (
        (level, straight_up, Status.DEGENERATE),
        (apart, (0.0, 0.0, 0.0), Status.NOT_ASSEMBLABLE),
        (DELTA, (math.nan, 0.0, 0.0), Status.INVALID_INPUT),
        (DELTA, (math.inf, 0.0, 0.0), Status.INVALID_INPUT),
    ):
        batch = delta.forward([arms, (0.1, 0.2, 0.3)])
        for met in (delta.forward(arms), batch):
            assert np.ravel(met.status)[0] == status
            assert np.isnan(met.position.reshape(-1, 3)[0]).all()
            assert math.isnan(np.ravel(met.determinant)[0])
        assert np.ravel(batch.status)[1] == delta.forward((0.1, 0.2, 0.3)).status
    assert np.isnan(ScalarDelta(level.geometry).forward(*straight_up)).all()
    assert np.isnan(ScalarDelta(apart.geometry).forward(0.0, 0.0, 0.0)).all()


@pytest.mark.parametrize("turn", [1e3, 1e15, 1e308])
def test_angles_of_many_turns_are_equivalent(turn: float) -> None:
    wound = DELTA.forward((turn, 0.1, 0.1))
    plain = DELTA.forward((math.atan2(math.sin(turn), math.cos(turn)), 0.1, 0.1))
    assert np.allclose(wound.position, plain.position, atol=1e-15, equal_nan=True)
    assert wound.status & ~(Status.JOINT_LIMIT | LIMBS) == plain.status & ~(Status.JOINT_LIMIT | LIMBS)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize(("arm", "rod"), [(0.1, 0.1001), (0.1, 0.18), (0.01, 1.0), (0.001, 1.0), (0.18, 0.17)])
def test_round_trips_of_robots_large_and_small(scale: float, arm: float, rod: float) -> None:
    """The round-trip error grows only with 1/|det|, as expected from rounded angles."""
    geometry = DeltaGeometry(base_radius=0.055, platform_radius=0.05, arm=arm, rod=rod, z_offset=0.1)
    lengths = ("base_radius", "platform_radius", "arm", "rod", "z_offset")
    delta = Delta(dataclasses.replace(geometry, **{name: scale * getattr(geometry, name) for name in lengths}))
    arms = np.random.default_rng(6).uniform(-1.2, 1.2, (1000, 3))
    points = delta.forward(arms).position
    solved = delta.inverse(points)
    good = (np.asarray(solved.status) & (NO_ANSWER | Status.WRONG_ASSEMBLY | Status.NEAR_TYPE_1)) == 0
    assert good.sum() > 25
    points = points[good]
    error = np.linalg.norm(delta.forward(solved.angles[good]).position - points, axis=1)
    determinant = np.abs(delta.jacobian(points).determinant)
    assert (error <= 1e-15 * (arm + rod) * scale / determinant).all()


def test_a_singular_pose_is_flagged_and_does_not_affect_its_neighbours() -> None:
    """All rods in one plane: the platform at the height of the elbows, in the middle."""
    geometry = DeltaGeometry(base_radius=0.125, platform_radius=0.0625, arm=0.125, rod=0.1875, z_offset=0.0)
    delta = Delta(geometry)
    point = (0.0, 0.0, 0.0)
    solved = delta.inverse([point, (0.0, 0.0, 0.1)])
    assert Status.NEAR_TYPE_2 in Status(int(np.asarray(solved.status)[0]))
    jacobian = delta.jacobian([point, (0.0, 0.0, 0.1)])
    assert np.asarray(jacobian.condition)[0] > 1e12
    assert np.isfinite(jacobian.matrix[1]).all()


def test_strict_names_exactly_the_bad_indices() -> None:
    points = [DOCK, (0.0, 0.0, 9.0), (math.nan, 0.0, 0.0), DOCK]
    with pytest.raises(KinematicsError, match=r"point 1: .*FAR.*point 2: INVALID_INPUT") as caught:
        DELTA.inverse(points, strict=True)
    assert caught.value.indices == [1, 2]
    with pytest.raises(KinematicsError, match="point 0: OUTSIDE_WORKSPACE"):
        DELTA.inverse((0.0, 0.0, 0.115), strict=True)
    with pytest.raises(KinematicsError, match="JOINT_LIMIT"):
        DELTA.forward((1.5, 0.0, 0.0), strict=True)
    assert DELTA.inverse(DOCK, strict=True).status == Status.OK


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("working_mode", mode) for mode in ((1, 1), [-1, -1, -1], (0, 1, 1), "out", None)),
        *(("assembly", assembly) for assembly in (0, 2, None, "ahead")),
        ("geometry", {"arm": 0.1}),
    ],
)
def test_unknown_modes_and_other_types_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        Delta(**{name: value})
