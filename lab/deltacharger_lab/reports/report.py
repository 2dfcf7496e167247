# SPDX-License-Identifier: Apache-2.0
"""Common parts of reports: machine and date, pictures, targets and files.

Templates omit the line under the head of a table: a block of rows is a table, its first row the head.
"""

import contextlib
import datetime
import importlib
import inspect
import json
import math
import os
import platform
import re
import textwrap
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from deltacharger_core.ros.outcomes import json_ready
from deltacharger_lab.reports import formats

_TEMPLATES = Path(__file__).parent / "templates"
_FILTERS = dict(inspect.getmembers(formats, inspect.isfunction))
_WIDTH = 125
_NO_PROSE = ("#", "- ", "![")  # blocks that are not wrapped


def render(subject: str, figures: Mapping[str, Any], **more: Any) -> str:
    """Return the page of the JSON figures; errors as `rendered`."""
    text = rendered(f"{subject}.md.j2", {**figures, "figures": figures, **more})
    return "\n\n".join(map(_wrapped, re.split(r"\n\s*\n", text.strip()))) + "\n"


def rendered(name: str, values: Mapping[str, Any]) -> str:
    """Return a template rendered with values.

    Raises:
        ModuleNotFoundError: jinja2 is missing.
        jinja2.TemplateError: the template uses an unknown name.
    """
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(_FILTERS)
    environment.globals.update(values)
    return environment.get_template(name).render()


def _wrapped(block: str) -> str:
    """Return prose as one paragraph, wrapped between words, and a table with the line under its head."""
    if block.startswith("|"):
        head, newline, rows = block.partition("\n")
        return f"{head}\n|{'---|' * (head.count('|') - 1)}{newline}{rows}"
    if block.startswith(_NO_PROSE):
        return block
    return textwrap.fill(" ".join(block.split()), _WIDTH, break_long_words=False, break_on_hyphens=False)


Progress = Callable[[str], None]
"""Called with the next step."""
Picture = Callable[[dict[str, Any], Path], None]
"""Draws results into a file."""


class Report:
    """A report in progress: put measurements and targets into `results`; then `draw` and `write`.

    Args:
        subject: name of the report, its template and its files SUBJECT.json and SUBJECT.md.
        command: that writes it.
        libraries: whose versions the page lists.
        measures_with: libraries that the measurement needs.

    Raises:
        ModuleNotFoundError: a needed library is missing; raised before anything takes time.
    """

    def __init__(
        self,
        subject: str,
        command: str,
        libraries: Iterable[str],
        measures_with: Iterable[str] = (),
    ) -> None:
        for needed in ("jinja2", *measures_with):
            importlib.import_module(needed)
        self._subject = subject
        self._started = time.monotonic()
        self.results: dict[str, Any] = {
            "machine": machine(libraries),
            "command": command,
            "date": datetime.date.today().isoformat(),
            "absent": {},
        }

    def draw(
        self, pictures: Mapping[str, Picture], directory: Path, missing: Mapping[str, str] | None = None, **more: Any
    ) -> None:
        """Write all possible pictures; record missing ones with the reason, and the elapsed time.

        Args:
            pictures: by file name.
            directory: of the report.
            missing: pictures that cannot be drawn, with the reason.
            more: further data for pictures, which no file keeps.
        """
        reasons = dict(missing or {})
        for name, draw in pictures.items():
            if name not in reasons:
                draw({**self.results, **more}, directory / name)
        self.results["pictures"] = [name for name in pictures if name not in reasons]
        self.results["missing_pictures"] = reasons
        self.results["elapsed_s"] = time.monotonic() - self._started

    def write(self, directory: Path, **more: Any) -> dict[str, Any]:
        """Write figures (NaN and infinity as null), and the page rendered from them; return the figures.

        Args:
            directory: of the report.
            more: further names for the template.

        Raises:
            OSError: a file cannot be written.
        """
        figures, path = json_ready(self.results), directory / f"{self._subject}.json"
        path.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", "utf-8")
        path.with_suffix(".md").write_text(render(self._subject, figures, **more), "utf-8")
        return self.results


def machine(libraries: Iterable[str]) -> dict[str, Any]:
    """Return processor, cores, load, system, Python and the versions of installed libraries."""
    versions = {}
    for name in libraries:
        with contextlib.suppress(PackageNotFoundError):
            versions[name] = version(name)
    lines: list[str] = []
    with contextlib.suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    return {
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "processor": next(names, platform.processor() or platform.machine()),
        "load": os.getloadavg()[0],
        "versions": versions,
    }


def at_most(name: str, value: float | None, limit: float, unit: str, wanted: str = "") -> dict[str, Any]:
    """Return a target that a figure must not exceed; `wanted` replaces the text "≤ limit"."""
    return _target(name, wanted or f"≤ {limit:g}", value, unit, -math.inf, limit)


def at_least(name: str, value: float | None, limit: float, unit: str, wanted: str = "") -> dict[str, Any]:
    """Return a target that a figure must reach; `wanted` replaces the text "≥ limit"."""
    return _target(name, wanted or f"≥ {limit:g}", value, unit, limit, math.inf)


def none(name: str, count: float | None, unit: str) -> dict[str, Any]:
    """Return a target of no events."""
    return at_most(name, count, 0.0, unit, "= 0")


def _target(name: str, wanted: str, value: float | None, unit: str, low: float, high: float) -> dict[str, Any]:
    measured = math.nan if value is None else float(value)
    met = low <= measured <= high or math.isclose(measured, low) or math.isclose(measured, high)  # apart from rounding
    return {
        "name": name,
        "wanted": wanted,
        "measured": measured,
        "unit": unit,
        "met": None if math.isnan(measured) else met,
    }
