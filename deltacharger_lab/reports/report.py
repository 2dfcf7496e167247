# SPDX-License-Identifier: Apache-2.0
"""What all reports have in common: where and when they were written, their pictures, and the files that they leave."""

from __future__ import annotations

import datetime
import importlib
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from deltacharger_lab.reports.machine import machine
from deltacharger_lab.reports.page import write, write_html


class Report:
    """A report on its way: `results` takes what is measured; then `draw`, the targets, and `write`.

    Args:
        subject: of the report, of its template and of its files.
        command: that writes it.
        libraries: whose versions are told.
        html: whether the page is written as one HTML file too.

    Raises:
        ModuleNotFoundError: what writes the page is missing; told before anything takes time.
    """

    def __init__(self, subject: str, command: str, libraries: Iterable[str], html: bool = False) -> None:
        for needed in ("jinja2", *(["markdown_it"] if html else [])):
            importlib.import_module(needed)
        self._subject, self._html = subject, html
        self._started = time.monotonic()
        self.results: dict[str, Any] = {
            "machine": machine(libraries),
            "command": command,
            "date": datetime.date.today().isoformat(),
            "absent": {},
        }

    def draw(
        self, jobs: Mapping[str, Callable[[Path], None]], directory: Path, missing: Mapping[str, str] | None = None
    ) -> None:
        """Write every picture that can be written; note those that are missing, with the reason, and the time it took.

        Args:
            jobs: by name of the file.
            directory: of the report.
            missing: pictures that there cannot be, and why.
        """
        reasons = dict(missing or {})
        for name, job in jobs.items():
            if name not in reasons:
                try:
                    job(directory / name)
                except ImportError as error:
                    reasons[name] = f"{error}; install deltacharger[report]"
        self.results["pictures"] = [name for name in jobs if name not in reasons]
        self.results["missing_pictures"] = reasons
        self.results["elapsed_s"] = time.monotonic() - self._started

    def write(self, directory: Path, indent: int | None = 1, **more: Any) -> dict[str, Any]:
        """Write figures, page and HTML, and return the figures.

        Args:
            directory: of the report.
            indent: of the JSON; None = all in one line.
            more: what the template needs besides the figures.

        Raises:
            OSError: a file cannot be written.
        """
        write(self.results, directory, self._subject, indent, **more)
        if self._html:
            write_html(directory / f"{self._subject}.md", directory / f"{self._subject}.html")
        return self.results
