# SPDX-License-Identifier: Apache-2.0
"""Measures the electrode detector on simulated images and writes the report: figures as JSON, a page, pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deltacharger_lab.campaigns.summary import upper_bound
from deltacharger_lab.reports.pool import work
from deltacharger_lab.reports.report import Progress, Report
from deltacharger_lab.reports.vision import conditions, mount, summary
from deltacharger_lab.reports.vision.measure import FIELDS
from deltacharger_lab.reports.vision.pictures import PICTURES
from deltacharger_lab.reports.vision.plan import VisionPlan

_LIBRARIES = ("numpy", "opencv-python-headless", "opencv-python", "mujoco", "matplotlib")


def build(plan: VisionPlan, directory: Path, command: str, progress: Progress) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: OpenCV is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if "opencv" in plan.absent:
        raise ModuleNotFoundError(plan.absent["opencv"], name="cv2")
    report = Report("vision", command, _LIBRARIES, html=True)
    results = report.results
    results |= {
        "simulated": True,
        "seed": plan.seed,
        "first_seed": plan.first_seed,
        "images": plan.images,
        "quick": plan.quick,
        "absent": plan.absent,
    }
    _measure(results, plan, progress)
    progress("pictures")
    report.draw(PICTURES, directory)
    results["targets"] = summary.targets(results)
    return report.write(directory, None, view=conditions, upper_bound=upper_bound)


def _measure(results: dict[str, Any], plan: VisionPlan, progress: Progress) -> None:
    found = work(plan.tasks(), progress)
    progress("run times, alone")
    results["times"] = work([plan.timing()], progress)["run times"][0]
    images = summary.gathered(found["images"])
    mounts = summary.gathered(found["mount"])
    results["rows"] = {name: summary.row(each) for name, each in images.items()}
    results["band"] = summary.row(summary.band(images))
    results["mount"] = {name: summary.row(each, mount.FIELDS) for name, each in mounts.items()}
    results["raw"] = {"fields": FIELDS, "images": images, "mount_fields": mount.FIELDS, "mount": mounts}
