# SPDX-License-Identifier: Apache-2.0
"""Stiff and extreme inputs one by one: answers of a single call and of an array, against 60 digits."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core.arrays import Array
from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_lab.reports.kinematics.measure import KinematicsPlan
from deltacharger_lab.reports.kinematics.reference import ExactDelta
from deltacharger_lab.reports.kinematics.sets import near_type_2

_ANGLE_BOUND = 1e-15  # rad; largest error of a good answer, relative beyond 1 rad
_LIMBS = Status.LIMB_0 | Status.LIMB_1 | Status.LIMB_2
_NAN = math.nan
_WRONG = "wrong answer"
# Lengths are sums of few powers of two, so that the edge of reach falls on doubles.
_STRETCHED = DeltaGeometry(base_radius=0.1875, platform_radius=0.03125, arm=0.15625, rod=0.25, z_offset=0.0)
_FOLDED = DeltaGeometry(base_radius=0.1875, platform_radius=0.03125, arm=0.09375, rod=0.5, z_offset=0.0)
_EQUAL = DeltaGeometry(base_radius=0.05, platform_radius=0.05, arm=0.1, rod=0.1, z_offset=0.0)
_MEETING = DeltaGeometry(base_radius=0.0625, platform_radius=0.1875, arm=0.125, rod=0.25)
_FAR_APART = DeltaGeometry(base_radius=0.4)


@dataclass(frozen=True)
class Case:
    """One input and its required answer.

    Attributes:
        name: of the row.
        given: the point (m), or the arm angles (rad) if `forward`.
        wanted: required bits of the status; any one of them if `either`.
        answered: whether all limbs must have numbers.
        geometry: of the robot.
        margin: required exactly; None = not checked.
        either: one of the `wanted` bits is enough.
        forward: whether to use forward kinematics.
    """

    name: str
    given: ArrayLike
    wanted: Status = Status.OK
    answered: bool = True
    geometry: DeltaGeometry = field(default_factory=DeltaGeometry)
    margin: float | None = None
    either: bool = False
    forward: bool = False


def inverse_cases(plan: KinematicsPlan) -> list[Case]:
    """Return the points that have broken other inverse kinematics, or could."""
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
    """Return arm angles that have broken other forward kinematics, or could."""
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
    """Return for each case the answer, its error, and whether it is as required."""
    cases = inverse_cases(plan) + [replace(case, forward=True) for case in forward_cases()]
    return [_guarded(case) for case in cases] + _laws()


def _guarded(case: Case) -> dict[str, Any]:
    try:
        return _case_row(case)
    except Exception as error:  # no input may raise; one that does belongs in the table
        return _law(case.name, f"{type(error).__name__}: {error}", False)


def _case_row(case: Case) -> dict[str, Any]:
    delta = Delta(case.geometry)
    solve, answer = (delta.forward, "position") if case.forward else (delta.inverse, "angles")
    (one, many), warned = _quietly(lambda: (solve(case.given), solve(np.asarray(case.given)[None])))
    status, numbers, others = Status(int(one.status)), np.asarray(getattr(one, answer)), getattr(many, answer)[0]
    error, trip = _errors(case, status, np.stack([numbers, others])) if np.isfinite(numbers).all() else (_NAN, _NAN)
    agree = int(many.status[0]) == int(status) and np.array_equal(np.isnan(others), np.isnan(numbers))
    margin = _NAN if case.forward else float(one.margin)
    has = bool(status & case.wanted) if case.either else (status & case.wanted) == case.wanted
    fits = has and bool(np.isfinite(numbers).all()) == case.answered
    fits &= (not case.answered or error <= _ANGLE_BOUND) and (case.margin is None or margin == case.margin)
    notes = ((not fits, _WRONG), (not agree, "single call and array differ"), (warned, "numpy warned"))
    remark = "; ".join(note for is_so, note in notes if is_so)
    shown, unit = (_show(numbers, 1e3, "mm"), "m") if case.forward else (_show(numbers, 1.0, "rad"), "rad")
    figures = {"margin": margin, "error": error, "round_trip": trip}
    return _row(case.name, shown, remark, name_status(status), unit, **figures)


def _errors(case: Case, status: Status, answers: Array) -> tuple[float, float]:
    """Return the largest error of answers (n, 3), and how far the angles of the first lead from the point, m."""
    given = np.asarray(case.given, dtype=np.float64)[None]
    exact = ExactDelta(case.geometry)
    if case.forward:
        return float(exact.forward(given).distance(answers).max()), _NAN
    mirrored = ExactDelta(case.geometry, assembly=-1 if Status.WRONG_ASSEMBLY in status else 1)
    trip = float(mirrored.forward(answers[:1]).distance(given)[0])
    return float(exact.inverse(given).angles.angle_error(answers).max()), trip


def _row(name: str, answer: str, remark: str, status: str = "", unit: str = "", **figures: float) -> dict[str, Any]:
    """Return a row of the table; a correct one has no remark."""
    unknown = {"margin": _NAN, "error": _NAN, "unit": unit, "round_trip": _NAN}
    verdict = {"ok": not remark, "remark": remark}
    return {"name": name, "status": status, "answer": answer, **unknown, **figures, **verdict}


def _quietly(call: Callable[[], Any]) -> tuple[Any, bool]:
    """Return a call's result and whether it warned."""
    with warnings.catch_warnings(record=True) as caught, np.errstate(all="warn"):
        warnings.simplefilter("always")
        result = call()
    return result, bool(caught)


def _laws() -> list[dict[str, Any]]:
    """Return the checks of calls in general."""
    good, strict = [[0.0, 0.0, 0.05], [0.01, 0.02, 0.06]], [[0.0, 0.0, 0.05], [_NAN, 0.0, 0.0], [0.0, 0.0, 1.0]]
    bad = [[_NAN, 0.0, 0.0], [1e308, 0.0, 0.0], [0.0, 0.0, 1.0]]
    mixed, warned = _quietly(lambda: Delta().inverse([good[0], *bad, good[1]]))
    same = np.array_equal(mixed.angles[[0, 4]], Delta().inverse(good).angles)
    kept = same and bool((mixed.status[1:4] != 0).all()) and bool((mixed.status[[0, 4]] == 0).all())
    indices = getattr(_error_of(lambda: Delta().inverse(strict, strict=True)), "indices", None)
    shape = Delta().inverse(np.empty((0, 3))).angles.shape
    short = _error_of(lambda: Delta().inverse([[1.0, 2.0]]))
    errors = [_error_of(partial(DeltaGeometry, arm=value)) for value in (0.0, -0.1, _NAN, math.inf)]
    refused = sum(isinstance(error, ValueError) for error in errors)
    return [
        _law("three bad rows among two good ones", "the good rows as if alone", kept and not warned),
        _law("strict=True with rows 1 and 2 bad", f"KinematicsError, indices {indices}", indices == [1, 2]),
        _law("empty array (0, 3)", f"angles of shape {shape}", shape == (0, 3)),
        _law("two coordinates instead of three", f"ValueError: {short}", isinstance(short, ValueError)),
        _law("arm of 0, −0.1, NaN or inf m", f"ValueError for {refused} of {len(errors)}", refused == len(errors)),
    ]


def _error_of(call: Callable[[], object]) -> Exception | None:
    try:
        call()
    except Exception as error:  # its kind belongs in the table
        return error
    return None


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
