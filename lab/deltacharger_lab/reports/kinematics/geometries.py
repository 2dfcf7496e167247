# SPDX-License-Identifier: Apache-2.0
"""Robots unlike the default one: thin shells of reach, tiny and huge, calibrated, with every knee and assembly."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics import Delta, DeltaGeometry, Status
from deltacharger_kinematics.geometry import LimbAdjustment
from deltacharger_kinematics.modes import KNEE_OUT, WORKING_MODES, WorkingMode
from deltacharger_lab.reports.kinematics.measure import KinematicsPlan
from deltacharger_lab.reports.kinematics.reference import ExactDelta
from deltacharger_lab.reports.kinematics.sets import assembled, boundary, outside

_FEWEST = 20
ADJUSTED = (
    LimbAdjustment(0.0010, 0.0020, 0.0030, 0.1010, 0.1810, 0.010),
    LimbAdjustment(-0.0010, 0.0010, -0.0030, 0.0990, 0.1790, -0.020),
    LimbAdjustment(0.0020, -0.0020, 0.0010, 0.1005, None, 0.005),
)


@dataclass(frozen=True)
class Robot:
    """One robot to measure, with its knees and assembly."""

    name: str
    geometry: DeltaGeometry
    working_mode: WorkingMode = KNEE_OUT
    assembly: int = 1


def _scaled(factor: float) -> DeltaGeometry:
    plain = DeltaGeometry()
    names = ("base_radius", "platform_radius", "arm", "rod", "z_offset")
    return replace(plain, **{name: factor * getattr(plain, name) for name in names})


def robots() -> list[Robot]:
    """Return the robots of the table."""
    plain = DeltaGeometry()
    return [
        Robot("default", plain),
        *(
            Robot(f"rod/arm {ratio:g}", replace(plain, rod=ratio * plain.arm))
            for ratio in (1.001, 1.01, 1.1, 10.0, 100.0, 1000.0)
        ),
        Robot("arm longer than rod, 180 and 100 mm", replace(plain, arm=0.18, rod=0.10)),
        Robot("arm = rod = 100 mm", replace(plain, rod=0.1)),
        Robot("D = 0", replace(plain, platform_radius=plain.base_radius)),
        Robot("D = −50 mm", replace(plain, platform_radius=plain.base_radius + 0.05)),
        Robot("D = 150 mm", replace(plain, base_radius=plain.platform_radius + 0.15)),
        *(Robot(f"all lengths × {factor:g}", _scaled(factor)) for factor in (1e-3, 1e3, 1e6)),
        Robot("z_offset 1 km", replace(plain, z_offset=1e3)),
        Robot("every limb adjusted, 18 parameters", replace(plain, limbs=ADJUSTED)),
        *(Robot(f"knees {_signs(mode)}", plain, mode) for mode in WORKING_MODES if mode != KNEE_OUT),
        Robot("mirror assembly", plain, assembly=-1),
        Robot("mirror assembly, adjusted, knees + + +", replace(plain, limbs=ADJUSTED), (1, 1, 1), -1),
    ]


def _signs(mode: tuple[int, ...]) -> str:
    return " ".join("+" if sign > 0 else "−" for sign in mode)


def measure_robots(plan: KinematicsPlan) -> list[dict[str, Any]]:
    """Return errors, decisions and round trips of each robot, at random arm angles and at the edge of reach."""
    count = max(_FEWEST, min(plan.points // 20, 300))
    return [_measure(robot, plan, stream, count) for stream, robot in enumerate(robots(), 100)]


def _measure(robot: Robot, plan: KinematicsPlan, stream: int, count: int) -> dict[str, Any]:
    delta = Delta(robot.geometry, working_mode=robot.working_mode, assembly=robot.assembly)
    exact = ExactDelta(robot.geometry, robot.working_mode, robot.assembly)
    rng = plan.generator(stream)
    points = assembled(robot.geometry, rng, count, delta).points
    # Distances that are tiny relative to the coordinates cannot be met; fewer points result.
    inside, beyond = boundary(exact, rng, count // 2).points, outside(exact, rng, count // 2, -17.0, -3.0).points
    here, edge = _solve(delta, exact, points), _solve(delta, exact, np.concatenate([inside, beyond]))
    solved = delta.inverse(points)
    ahead = (np.asarray(solved.status) & np.uint32(Status.WRONG_ASSEMBLY)) == 0
    back = delta.forward(solved.angles).position
    trip = np.linalg.norm(back - points, axis=-1)[ahead] / (robot.geometry.arm + robot.geometry.rod)
    return {
        "name": robot.name,
        "count": len(points),
        "edge_count": len(inside) + len(beyond),
        **{key: max(here[key], edge[key]) for key in ("array", "point", "precise")},
        "wrong_decisions": here["wrong_decisions"] + edge["wrong_decisions"],
        "round_trip_median": float(np.median(trip)) if len(trip) else math.nan,
        "round_trip_max": _largest(trip),
        "round_trips": len(trip),
    }


def _solve(delta: Delta, exact: ExactDelta, points: Array) -> dict[str, Any]:
    """Return the largest error (rad) of each solver, and the number of wrong decisions on reach by angle or margin."""
    truth = exact.inverse(points).angles
    reached = np.isfinite(truth.high)
    singles = [delta.inverse(tuple(point)) for point in points.tolist()]
    ways = {"array": delta.inverse(points), "precise": delta.inverse(points, precise=True)}
    answers = {name: (way.angles, way.margin) for name, way in ways.items()}
    one_by_one = np.array([each.angles for each in singles]).reshape(-1, 3)
    answers["point"] = one_by_one, np.array([each.margin for each in singles])
    found: dict[str, Any] = {"wrong_decisions": 0}
    for name, (angles, margin) in answers.items():
        found[name] = _largest(truth.angle_error(angles))
        found["wrong_decisions"] += int((np.isfinite(angles) != reached).sum())
        found["wrong_decisions"] += int(np.count_nonzero((margin >= 0.0) != reached.all(-1)))
    return found


def _largest(values: Array) -> float:
    return float(np.max(values[np.isfinite(values)], initial=0.0))
