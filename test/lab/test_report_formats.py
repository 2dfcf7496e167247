# SPDX-License-Identifier: Apache-2.0
"""Common parts of reports: formats of figures, verdicts of targets, and errors of pages and pictures."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_lab.reports import formats
from deltacharger_lab.reports.page import render
from deltacharger_lab.reports.report import Report, at_least, at_most, none

NUMBERS = (formats.fixed, formats.short, formats.number, formats.power, formats.percent, formats.plain)


@pytest.mark.parametrize("write", NUMBERS)
def test_unknown_values_are_a_dash_from_json_or_not(write: Callable[..., str]) -> None:
    assert write(None) == write(math.nan) == "–"
    assert write(0.0) != "–"


def test_numbers_have_their_significant_digits() -> None:
    assert [formats.number(each) for each in (3.0, 1234.0, 0.12345, -math.inf)] == ["3", "1234", "0.123", "−inf"]
    assert [formats.plain(each) for each in (12345.6, 0.12345)] == ["12346", "0.123"]
    assert formats.rate({"n": 3, "share": 2 / 3, "interval": [0.2, 0.9]}) == "66.67 (20.00–90.00)"
    assert formats.rate({"n": 0}) == formats.counts({}) == "–"
    assert formats.cell("a\n b|c") == "a b\\|c"


def test_a_target_is_met_up_to_its_limit_and_rounding() -> None:
    assert at_most("x", 0.1 + 0.2, 0.3, "m")["met"] is True
    assert at_most("x", 0.301, 0.3, "m")["met"] is False
    assert at_least("x", 99.5, 99.5, "%")["met"] is True
    assert at_most("x", 6e-16, 5e-16, "m")["met"] is False
    assert at_least("x", None, 1.0, "")["met"] is at_most("x", math.nan, 1.0, "")["met"] is None
    assert [none("x", count, "of 9")["met"] for count in (0, 1)] == [True, False]


def test_a_template_with_an_unknown_name_is_an_error() -> None:
    jinja2 = pytest.importorskip("jinja2", reason="writes with deltacharger[report]")
    with pytest.raises(jinja2.UndefinedError, match="'targets' is undefined"):
        render("docking", {})


def test_pictures_that_cannot_be_drawn_are_listed_with_the_reason(tmp_path: Path) -> None:
    pytest.importorskip("jinja2", reason="writes with deltacharger[report]")

    def written(results: dict[str, Any], path: Path) -> None:
        path.write_text(results["shown"], "utf-8")

    def absent(results: dict[str, Any], path: Path) -> None:
        raise ModuleNotFoundError("No module named 'matplotlib'")

    report = Report("docking", "deltacharger report docking", ("numpy",))
    report.draw({"a.png": written, "b.png": absent, "c.png": written}, tmp_path, {"c.png": "not run"}, shown="all")
    assert "shown" not in report.results
    assert report.results["pictures"] == ["a.png"]
    assert report.results["missing_pictures"] == {
        "c.png": "not run",
        "b.png": "No module named 'matplotlib'; install deltacharger[report]",
    }
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert (tmp_path / "a.png").read_text("utf-8") == "all"
