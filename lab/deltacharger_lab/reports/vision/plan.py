# SPDX-License-Identifier: Apache-2.0
"""Plan of the vision report: images of each row, seeds, and what cannot be measured here."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from deltacharger_lab.reports.pool import ReportTask
from deltacharger_lab.reports.vision import conditions
from deltacharger_lab.reports.vision.conditions import CONDITIONS, Condition, key
from deltacharger_lab.reports.vision.measure import LEVELS, judge, judge_mount, times

FULL, QUICK = 150, 15
"""Images of a usual row."""
FIRST_SEED = 20_000
"""Tuning used seeds below 1000."""
_SEEDS_APART = 10_000
_CHUNK = 25  # images of one task
_TIMED = {False: 40, True: 8}
_SIZE_WEIGHT = {"320 × 200 px": 0.6, "1280 × 800 px": 3.0}


@dataclass(frozen=True)
class VisionPlan:
    """Extent of the measurement.

    Attributes:
        images: of a usual row.
        seed: shifts the seeds of all images.
        quick: whether this is the short plan.
        absent: by missing library, the reason and what is left out.
    """

    images: int
    seed: int
    quick: bool
    absent: dict[str, str]

    @property
    def first_seed(self) -> int:
        """Seed of the first image of every row."""
        return FIRST_SEED + _SEEDS_APART * self.seed

    def conditions(self) -> list[Condition]:
        """Return the rows that can be measured here."""
        return [
            each for each in CONDITIONS.values() if not (each.renderer == conditions.MUJOCO and "mujoco" in self.absent)
        ]

    def count(self, weight: float) -> int:
        """Return the images of a row."""
        return max(2, round(self.images * weight))

    def seeds(self, count: int) -> range:
        """Return the seeds of a row."""
        return range(self.first_seed, self.first_seed + count)

    def tasks(self) -> list[ReportTask]:
        """Return all work except the run times, which need an idle computer."""
        found = []
        for each in self.conditions():
            cost = 4.0 if each.renderer == conditions.MUJOCO else _SIZE_WEIGHT.get(each.name, 1.0)
            for part in _chunks(self.seeds(self.count(each.weight))):
                found.append(ReportTask("images", judge, (key(each), part), cost * len(part)))
        for level in LEVELS:
            for part in _chunks(self.seeds(self.count(4 / 3))):
                found.append(ReportTask("mount", judge_mount, (level, part), float(len(part))))
        return found

    def timing(self) -> ReportTask:
        """Return the measurement of run times."""
        names = conditions.keys(conditions.BY_RANGE, conditions.HIDDEN, conditions.SIZE)
        names += [f"{conditions.DEFECTS}: {conditions.ALONE}"]
        names += [f"{conditions.ALARMS}: {name}" for name in (conditions.CLUTTER, conditions.CLUTTER_FLAT)]
        names += [
            key(each) for each in self.conditions() if each.group == conditions.RENDERERS and "docking" in each.name
        ]
        return ReportTask("run times", times, (names, self.seeds(_TIMED[self.quick])))


def plan(images: int | None, seed: int, quick: bool) -> VisionPlan:
    """Return the plan for this machine."""
    return VisionPlan(images or (QUICK if quick else FULL), seed, quick, absent())


def absent() -> dict[str, str]:
    """Return for each missing or broken library what is left out, and what to install."""
    from deltacharger_lab.mujoco.boxes import RendererError
    from deltacharger_lab.mujoco.camera import MujocoCamera
    from deltacharger_vision.rendering.camera import OAK_D

    found = {}
    if find_spec("cv2") is None:
        found["opencv"] = "the detector needs it; install deltacharger[vision]"
    try:
        MujocoCamera(OAK_D.scaled(64, 40)).close()
    except RendererError as error:
        found["mujoco"] = f"its rows are left out: {error}"
    return found


def _chunks(seeds: range) -> list[tuple[int, ...]]:
    return [tuple(seeds[start : start + _CHUNK]) for start in range(0, len(seeds), _CHUNK)]
