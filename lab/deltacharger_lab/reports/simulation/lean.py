# SPDX-License-Identifier: Apache-2.0
"""Leaning contacts: error against run time compared with MuJoCo, and rough treatment."""

import dataclasses
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_lab.reports import pool, report
from deltacharger_lab.reports.simulation import impact, models
from deltacharger_lab.reports.simulation.scenes import LIGHT, MUJOCO, SimulationPlan, docking, rms, world
from deltacharger_sim.parameters import PlatformParameters, TargetParameters, WorldParameters

STEPS = (1e-3, 5e-3, 1e-2, 2e-2)  # s, of the light model
TARGET_STEP = 1e-2  # s
MODEST = 3.5  # ° of lean, up to which the position is judged
_REFERENCE_STEP = {False: 2e-4, True: 5e-4}  # s; by whether the plan is quick
_FINEST = 1e-3  # s, smallest step of every point of the rough treatment; only some take the shorter one
_ROUGH_TILTS = ((0.1, -0.1), (-0.03, 0.1))  # rad


@dataclass(frozen=True)
class LeanCase:
    """A target that leans by `yaw` about y and `pitch` about x (°), at an offset `aside` (m), and the compliances."""

    yaw: float
    pitch: float
    compliance: float
    contact: float
    aside: tuple[float, float] = (0.0, 0.0)

    @property
    def name(self) -> str:
        """Name on the page."""
        lean = ", ".join(
            f"{what} {angle:g}°" for what, angle in (("yaw", self.yaw), ("pitch", self.pitch)) if angle != 0.0
        )
        return lean + (f", aside by {1e3 * self.aside[0]:g}, {1e3 * self.aside[1]:g} mm" if any(self.aside) else "")

    def parameters(self, **changes: Any) -> WorldParameters:
        """Return its world; `changes` as in `scenes.world`."""
        x, y = self.aside
        target = TargetParameters(x=x, y=y, tilt_x=math.radians(self.pitch), tilt_y=math.radians(self.yaw))
        return world(self.contact, platform=PlatformParameters(compliance=self.compliance), target=target, **changes)


CASES = (
    LeanCase(1.0, 0.0, 0.01, 1e5),
    LeanCase(3.0, 0.0, 0.0, 1e5),
    LeanCase(3.0, 0.0, 0.01, 1e6),
    LeanCase(3.0, 0.0, 0.03, 1e5),
    LeanCase(5.7, 0.0, 0.01, 1e5),
    LeanCase(5.7, 0.0, 0.03, 1e5),
    LeanCase(5.7, 0.0, 0.03, 1e6),
    LeanCase(0.0, 1.0, 0.03, 1e6),
    LeanCase(0.0, 3.0, 0.0, 1e6),
    LeanCase(0.0, 3.0, 0.01, 1e5),
    LeanCase(0.0, 5.7, 0.03, 1e5),
    LeanCase(3.0, -2.0, 0.03, 1e5, (0.003, -0.002)),
)


def cases(plan: SimulationPlan) -> tuple[LeanCase, ...]:
    """Return the measured cases."""
    return CASES[::4] if plan.quick else CASES


def times(plan: SimulationPlan) -> list[dict[str, Any]]:
    """Return the light model's speed in motion relative to real time, at every step; the fastest run counts.

    The level and the leaning worlds take turns, so that a busy machine affects all equally.
    """
    worlds = {"level": world(), **{_key(case): case.parameters() for case in cases(plan)}}
    fastest: dict[tuple[str, float], float] = {}
    for _, step, (key, each) in itertools.product(range(2 * plan.repeats), STEPS, worlds.items()):
        fastest[key, step] = max(fastest.get((key, step), 0.0), docking(LIGHT, each, step)["moving"])
    return [{"case": key, "step": step, "moving": moving} for (key, step), moving in fastest.items()]


def errors(case: LeanCase, name: str, finest: float) -> list[dict[str, Any]]:
    """Return the light model's errors at every step against a model in steps of `finest` s.

    Path with friction and weight; force, tilt and share at rest without, because they are unique then.
    """
    rubbing, free = case.parameters(), case.parameters(friction=0.0, gravity_y=0.0)
    exact, rest = docking(name, rubbing, finest), docking(name, free, finest)
    rows = []
    for step in STEPS:
        path, found = docking(LIGHT, rubbing, step), docking(LIGHT, free, step)
        off = max(abs(a - b) for a, b in zip(found["tilt"], rest["tilt"], strict=True))
        rows.append(
            {
                **dataclasses.asdict(case),
                "case": _key(case),
                "name": case.name,
                "step": step,
                "finest": finest,
                "rms_mm": 1000.0 * rms(path["trace"], exact["trace"]),
                "force_percent": 100.0 * (found["force"] / rest["force"] - 1.0),
                "tilt_deg": math.degrees(off),
                "share_percent": 100.0 * (found["share"] - rest["share"]),
                "speed": max(path["speed"], found["speed"]),
                "reference": {key: rest[key] for key in ("force", "tilt", "share")},
            }
        )
    return rows


def rough(contact: float, compliance: float, steps: tuple[float, ...]) -> list[dict[str, Any]]:
    """Dock against strong leans and treat the arm roughly; return whether all stayed finite and came to rest."""
    rows = []
    for step, (tilt_x, tilt_y) in itertools.product(steps, _ROUGH_TILTS):
        lean: dict[str, Any] = {
            "platform": PlatformParameters(compliance=compliance),
            "target": TargetParameters(tilt_x=tilt_x, tilt_y=tilt_y),
        }
        found = models.roughly(LIGHT, SERVO_STIFFNESS, contact, step, **lean)
        speed = docking(LIGHT, world(contact, friction=0.0, gravity_y=0.0, **lean), step)["speed"]
        row = {"contact": contact, "compliance": compliance, "step": step, "tilt": [tilt_x, tilt_y]}
        rows.append(row | {"imbalance": found["imbalance"], "ok": bool(found["bounded"] and speed < models.REST)})
    return rows


def tasks(plan: SimulationPlan, names: tuple[str, ...]) -> Iterator[pool.ReportTask]:
    """Yield all work that needs no idle computer."""
    finest = _REFERENCE_STEP[plan.quick]
    for case in cases(plan):
        yield pool.ReportTask("lean", errors, (case, MUJOCO if MUJOCO in names else LIGHT, finest), 0.0004 / finest)
    for contact, compliance in itertools.product(plan.map_contacts, (0.0, 0.001, 0.1)):
        long = tuple(step for step in plan.map_steps if step >= _FINEST)
        steps = plan.map_steps[:1] + long if contact in (1e3, 1e6, 1e9) and not plan.quick else long
        yield pool.ReportTask("lean_rough", rough, (contact, compliance, steps), 0.0001 / steps[0])


def targets(results: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the targets of leaning contacts."""
    slowest = min(
        row["moving"] for row in results["lean_times"] if row["step"] == TARGET_STEP and row["case"] != "level"
    )
    modest = [row for row in results["lean"] if max(abs(row["yaw"]), abs(row["pitch"])) < MODEST]
    worst = impact.worst(modest, "rms_mm", step=TARGET_STEP)
    lost = sum(not row["ok"] for row in results["lean_rough"])
    return [
        report.at_least("light model at 10 ms with lean and compliance, in motion, slowest", slowest, 500.0, "× real"),
        report.at_most("the same, position, leans to 3°, worst", worst, 0.15, "mm rms"),
        report.none("leaning contacts that diverge or do not rest", lost, f"of {len(results['lean_rough'])}"),
    ]


def _key(case: LeanCase) -> str:
    return f"{case.name}; {case.compliance:g}; {case.contact:g}"
