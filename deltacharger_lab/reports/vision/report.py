# SPDX-License-Identifier: Apache-2.0
"""Measures the electrode detector on simulated images and writes the report: figures as JSON, a page, pictures."""

from __future__ import annotations

import datetime
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.html import write_html
from deltacharger_lab.reports.machine import machine
from deltacharger_lab.reports.pool import work
from deltacharger_lab.reports.vision import mount as vision_mount
from deltacharger_lab.reports.vision import summary as vision_summary
from deltacharger_lab.reports.vision.measure import FIELDS
from deltacharger_lab.reports.vision.page import write_page
from deltacharger_lab.reports.vision.pictures import draw_all
from deltacharger_lab.reports.vision.plan import Plan
from deltacharger_ros.outcomes import json_ready

PAGE, FIGURES, HTML = "vision.md", "vision.json", "vision.html"
_LIBRARIES = ("numpy", "opencv-python-headless", "opencv-python", "mujoco", "matplotlib")


def build(plan: Plan, directory: Path, command: str, progress: Callable[[str], None]) -> dict[str, Any]:
    """Measure, write page, HTML, figures and pictures into `directory` and return the figures.

    Raises:
        ModuleNotFoundError: OpenCV is missing.
        OSError: a file cannot be written.
        KeyboardInterrupt: interrupted; nothing was written.
    """
    if "opencv" in plan.absent:
        raise ModuleNotFoundError(plan.absent["opencv"], name="cv2")
    started = time.monotonic()
    results: dict[str, Any] = {
        "simulated": True,
        "machine": machine(_LIBRARIES),
        "command": command,
        "date": datetime.date.today().isoformat(),
        "seed": plan.seed,
        "first_seed": plan.first_seed,
        "images": plan.images,
        "quick": plan.quick,
        "absent": plan.absent,
    }
    _measure(results, plan, progress)
    progress("pictures")
    results["pictures"], results["missing_pictures"] = draw_all(results, plan, directory)
    results["elapsed_s"] = time.monotonic() - started
    results["targets"] = vision_summary.targets(results)
    (directory / FIGURES).write_text(json.dumps(json_ready(results), ensure_ascii=False) + "\n", "utf-8")
    write_page(results, directory / PAGE)
    write_html(directory / PAGE, results["pictures"], directory / HTML)
    return results


def _measure(results: dict[str, Any], plan: Plan, progress: Callable[[str], None]) -> None:
    found = work(plan.tasks(), progress)
    progress("run times, alone")
    results["times"] = work([plan.timing()], progress)["run times"][0]
    images = vision_summary.gathered(found["images"])
    mounts = vision_summary.gathered(found["mount"])
    results["rows"] = {name: vision_summary.row(each) for name, each in images.items()}
    results["band"] = vision_summary.row(vision_summary.band(images))
    results["mount"] = {name: vision_summary.mount_row(each) for name, each in mounts.items()}
    results["raw"] = {
        "fields": FIELDS,
        "images": images,
        "mount_fields": vision_mount.FIELDS,
        "mount": mounts,
    }
