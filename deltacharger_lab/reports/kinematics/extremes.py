# SPDX-License-Identifier: Apache-2.0
"""Stiff and extreme inputs one by one: what comes back, by a single call and in an array, against 60 digits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from deltacharger_kinematics import Delta, DeltaGeometry, KinematicsError, Status
from deltacharger_lab.reports.kinematics.measure import KinematicsPlan
from deltacharger_lab.reports.kinematics.reference import ExactDelta
from deltacharger_lab.reports.kinematics.sets import near_type_2

Array = NDArray[np.float64]
_ANGLE_BOUND = 1e-15  # rad; what a good answer may miss the exact one by, relative beyond 1 rad
_LIMBS = Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2
_NAN = math.nan
_WRONG = "not what must come back"
# Lengths that are sums of few powers of two, so that the edge of reach falls on doubles.
_STRETCHED = DeltaGeometry(base_radius=0.1875, platform_radius=0.03125, arm=0.15625, rod=0.25, z_offset=0.0)
_FOLDED = DeltaGeometry(base_radius=0.1875, platform_radius=0.03125, arm=0.09375, rod=0.5, z_offset=0.0)
_EQUAL = DeltaGeometry(base_radius=0.05, platform_radius=0.05, arm=0.1, rod=0.1, z_offset=0.0)
_MEETING = DeltaGeometry(base_radius=0.0625, platform_radius=0.1875, arm=0.125, rod=0.25)
_FAR_APART = DeltaGeometry(base_radius=0.4)


@dataclass(frozen=True)
class Case:
    """One input and what must come back.

    Attributes:
        name: of the row.
        given: the point (m) or the arm angles (rad).
        wanted: bits that the status must have; any one of them where `either` is set.
        answered: whether numbers must come back, for all limbs.
        geometry: of the robot.
        margin: that must come back exactly; None = not checked.
        either: one of the `wanted` bits is enough.
    """

    name: str
    given: ArrayLike
    wanted: Status = Status.OK
    answered: bool = True
    geometry: DeltaGeometry = field(default_factory=DeltaGeometry)
    margin: float | None = None
    either: bool = False


def inverse_cases(plan: KinematicsPlan) -> list[Case]:
    """Return the points that have broken inverse kinematics of others, or could."""
    above = math.nextafter
    near_singular = near_type_2(DeltaGeometry(), plan.generator(9), 16).points
    singular = near_singular[np.abs(Delta().jacobian(near_singular).determinant).argmin()]
    invalid, far, near = Status.INVALID_INPUT, Status.UNREACHABLE_FAR, Status.UNREACHABLE_NEAR
    type_1 = Status.NEAR_TYPE_1
    return [
        Case("NaN in one coordinate", (_NAN, 0.0, 0.05), invalid, False),
        Case("+inf", (0.0, math.inf, 0.05), invalid, False),
        Case("−inf", (0.0, 0.0, -math.inf), invalid, False),
        Case("1e5 m", (1e5, 0.0, 0.05), far, False),
        Case("1e200 m", (1e200, 0.0, 0.05), far, False),
        Case("1e308 m in all coordinates", (1e308, -1e308, 1e308), far, False),
        Case("denormal, 5e-324 m", (5e-324, -5e-324, 0.05)),
        Case("−0.0", (-0.0, -0.0, 0.05)),
        Case("integers", (0, 0, 0)),
        Case("float32", np.array([0.012, -0.021, 0.064], dtype=np.float32)),
        Case("Q = 0 exactly, all limbs stretched", (0.0, 0.0, 0.375), type_1, True, _STRETCHED, 0.0),
        Case("one unit in the last place inside of that", (0.0, 0.0, above(0.375, 0.0)), type_1, True, _STRETCHED),
        Case("one unit in the last place outside of that", (0.0, 0.0, above(0.375, 1.0)), far, False, _STRETCHED),
        Case("Q = 0 exactly, all limbs folded", (0.0, 0.0, 0.375), type_1, True, _FOLDED, 0.0),
        Case("one unit in the last place inside of that", (0.0, 0.0, above(0.375, 1.0)), type_1, True, _FOLDED),
        Case("one unit in the last place outside of that", (0.0, 0.0, above(0.375, 0.0)), near, False, _FOLDED),
        Case("a = L, u = w = 0", (0.0, 0.0, 0.0), Status.INDETERMINATE, False, _EQUAL),
        Case("a = L, u = 0, w = 1e-30 m", (0.0, 0.0, 1e-30), type_1, True, _EQUAL),
        Case("a = L, u = 0, w = 1e-200 m, its square 0", (0.0, 0.0, 1e-200), Status.INDETERMINATE, False, _EQUAL),
        Case("too far sideways for limb 0", (0.0, 0.5, 0.05), Status.UNREACHABLE_LATERAL, False),
        Case("too near", (0.0, 0.0, -0.08), near, False),
        Case("rods nearly in a plane", singular, Status.NEAR_TYPE_2),
        Case("behind the motors", (0.0, 0.0, -0.25), Status.WRONG_ASSEMBLY),
        Case("outside the workspace box", (0.0, 0.0, 0.12), Status.OUTSIDE_WORKSPACE),
    ]


def forward_cases() -> list[Case]:
    """Return arm angles that have broken forward kinematics of others, or could."""
    line = math.acos(-0.15), math.acos(0.15), math.acos(0.15)
    apart, degenerate = Status.NOT_ASSEMBLABLE, Status.DEGENERATE
    return [
        Case("forward: NaN", (_NAN, 0.0, 0.0), Status.INVALID_INPUT, False),
        Case("forward: inf", (math.inf, 0.0, 0.0), Status.INVALID_INPUT, False),
        Case("forward: spheres that do not meet", (0.0, 0.0, 0.0), apart, False, _FAR_APART),
        Case("forward: all elbows in one point", (0.0, 0.0, 0.0), degenerate, False, _MEETING),
        Case("forward: elbows in a line, but for rounding", line, apart | degenerate, False, either=True),
        Case("forward: arms level", (0.0, 0.0, 0.0)),
        Case("forward: 1e6 rad", (1e6, 1e6, 1e6 + 0.1)),
        Case("forward: denormal", (5e-324, -5e-324, 0.0)),
    ]


def run_cases(plan: KinematicsPlan) -> list[dict[str, Any]]:
    """Return for each case what came back, its error, and whether it is what must come back."""
    rows = [_guarded(_inverse_row, case) for case in inverse_cases(plan)]
    rows += [_guarded(_forward_row, case) for case in forward_cases()]
    return [*rows, _bad_row_in_batch(), _strict_row(), _empty_row(), _shape_row(), _geometry_row()]


def _guarded(run: Callable[[Case], dict[str, Any]], case: Case) -> dict[str, Any]:
    try:
        return run(case)
    except Exception as error:  # no input may raise; one that does belongs into the table
        return _law(case.name, f"{type(error).__name__}: {error}", False)


def _inverse_row(case: Case) -> dict[str, Any]:
    delta, exact = Delta(case.geometry), ExactDelta(case.geometry)
    (one, many), warned = _quietly(lambda: (delta.inverse(case.given), delta.inverse(np.asarray(case.given)[None])))
    status, angles = Status(int(one.status)), np.asarray(one.angles, dtype=np.float64)
    error = trip = _NAN
    if np.isfinite(angles).all():
        point = np.asarray(case.given, dtype=np.float64)[None]
        error = float(exact.inverse(point).angles.angle_error(np.stack([angles, many.angles[0]])).max())
        mirrored = -1 if Status.WRONG_ASSEMBLY in status else 1
        back = ExactDelta(case.geometry, assembly=mirrored).forward(angles[None])
        trip = float(back.distance(point)[0])
    margin = float(one.margin)
    fits = _fits(case, status, angles, error) and (case.margin is None or margin == case.margin)
    remark = _remark(fits, _agree(status, angles, many.status[0], many.angles[0]), warned)
    return _row(case.name, _show(angles, 1.0, "rad"), remark, name_status(status), margin, error, "rad", trip)


def _forward_row(case: Case) -> dict[str, Any]:
    delta, exact = Delta(case.geometry), ExactDelta(case.geometry)
    (one, many), warned = _quietly(lambda: (delta.forward(case.given), delta.forward(np.asarray(case.given)[None])))
    status, position = Status(int(one.status)), np.asarray(one.position, dtype=np.float64)
    error = _NAN
    if np.isfinite(position).all():
        truth = exact.forward(np.asarray(case.given, dtype=np.float64)[None])
        error = float(truth.distance(np.stack([position, many.position[0]])).max())
    fits = _fits(case, status, position, error)
    remark = _remark(fits, _agree(status, position, many.status[0], many.position[0]), warned)
    return _row(case.name, _show(position, 1e3, "mm"), remark, name_status(status), _NAN, error, "m")


def _agree(status: Status, numbers: Array, other_status: Any, others: Array) -> bool:
    return int(other_status) == int(status) and np.array_equal(np.isnan(others), np.isnan(numbers))


def _row(
    name: str,
    answer: str,
    remark: str,
    status: str = "",
    margin: float = _NAN,
    error: float = _NAN,
    unit: str = "",
    round_trip: float = _NAN,
) -> dict[str, Any]:
    """Return a row of the table; what is as wanted has no remark."""
    figures = {"margin": margin, "error": error, "unit": unit, "round_trip": round_trip}
    return {"name": name, "status": status, "answer": answer, **figures, "ok": not remark, "remark": remark}


def _fits(case: Case, status: Status, numbers: Array, error: float) -> bool:
    has = bool(status & case.wanted) if case.either else (status & case.wanted) == case.wanted
    good = not case.answered or error <= _ANGLE_BOUND
    return has and bool(np.isfinite(numbers).all()) == case.answered and good


def _quietly(call: Callable[[], Any]) -> tuple[Any, bool]:
    """Return what a call returns and whether it warned."""
    with warnings.catch_warnings(record=True) as caught, np.errstate(all="warn"):
        warnings.simplefilter("always")
        result = call()
    return result, bool(caught)


def _remark(fits: bool, agree: bool, warned: bool) -> str:
    notes = ((not fits, _WRONG), (not agree, "single call and array differ"), (warned, "numpy warned"))
    return "; ".join(note for is_so, note in notes if is_so)


def _bad_row_in_batch() -> dict[str, Any]:
    delta = Delta()
    good = np.array([[0.0, 0.0, 0.05], [0.01, 0.02, 0.06]])
    bad = np.array([[_NAN, 0.0, 0.0], [1e308, 0.0, 0.0], [0.0, 0.0, 1.0]])
    mixed, warned = _quietly(lambda: delta.inverse(np.concatenate([good[:1], bad, good[1:]])))
    same = np.array_equal(mixed.angles[[0, 4]], delta.inverse(good).angles)
    fits = same and bool((mixed.status[1:4] != 0).all()) and bool((mixed.status[[0, 4]] == 0).all())
    return _law("three bad rows among two good ones", "the good rows as if alone", fits and not warned)


def _strict_row() -> dict[str, Any]:
    points = [[0.0, 0.0, 0.05], [_NAN, 0.0, 0.0], [0.0, 0.0, 1.0]]
    try:
        Delta().inverse(points, strict=True)
    except KinematicsError as error:
        return _law(
            "strict=True with rows 1 and 2 bad", f"KinematicsError, indices {error.indices}", error.indices == [1, 2]
        )
    return _law("strict=True with rows 1 and 2 bad", "no error", False)


def _empty_row() -> dict[str, Any]:
    solved = Delta().inverse(np.empty((0, 3)))
    return _law("empty array (0, 3)", f"angles of shape {solved.angles.shape}", solved.angles.shape == (0, 3))


def _shape_row() -> dict[str, Any]:
    try:
        Delta().inverse([[1.0, 2.0]])
    except ValueError as error:
        return _law("two coordinates instead of three", f"ValueError: {error}", True)
    return _law("two coordinates instead of three", "no error", False)


def _geometry_row() -> dict[str, Any]:
    refused = 0
    values = (0.0, -0.1, _NAN, math.inf)
    for value in values:
        try:
            DeltaGeometry(arm=value)
        except ValueError:
            refused += 1
    return _law("arm of 0, −0.1, NaN or inf m", f"ValueError for {refused} of {len(values)}", refused == len(values))


def _law(name: str, answer: str, holds: bool) -> dict[str, Any]:
    return _row(name, answer, "" if holds else _WRONG)


def name_status(status: Status) -> str:
    """Return the names of the bits, the limbs as a list of their numbers."""
    names = [bit.name or "" for bit in Status if bit.value and bit in status and not bit & _LIMBS]
    limbs = [str(index) for index, bit in enumerate((Status.LIMB_0, Status.LIMB_1, Status.LIMB_2)) if bit in status]
    return " ".join(names) + (f" (limb {', '.join(limbs)})" if limbs else "") if names else "OK"


def _show(values: Array, scale: float, unit: str) -> str:
    if np.isnan(values).all():
        return "NaN"
    return "(" + ", ".join("NaN" if math.isnan(each) else f"{scale * each:.6g}" for each in values) + f") {unit}"
