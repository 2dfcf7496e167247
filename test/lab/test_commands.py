# SPDX-License-Identifier: Apache-2.0
"""Commands of the lab without a library; a report's targets and pictures."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.reports.report import Report, at_least, at_most, none


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("report kinematics --quick", "mpmath", "report"),
        ("report tactile --quick", "sklearn xgboost torch", "train"),
        ("tactile compare --quick", "sklearn xgboost torch", "train"),
        ("report vision --quick", "cv2", "vision"),
        ("campaign -n 1", "pyarrow", "campaign"),
    ],
)
def test_without_a_needed_library_the_error_names_what_to_install(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: str,
    missing: str,
    extra: str,
) -> None:
    for module in missing.split():
        monkeypatch.setitem(sys.modules, module, None)
    assert main((*words.split(), "--out", str(tmp_path), "--json")) == 1
    assert f"deltacharger[{extra}]" in json.loads(capsys.readouterr().out)["error"]
    assert list(tmp_path.iterdir()) == []


def test_a_target_is_met_up_to_its_limit_and_rounding() -> None:
    assert at_most("x", 0.1 + 0.2, 0.3, "m")["met"] is True
    assert at_most("x", 0.301, 0.3, "m")["met"] is False
    assert at_least("x", 99.5, 99.5, "%")["met"] is True
    assert at_most("x", 6e-16, 5e-16, "m")["met"] is False
    assert at_least("x", None, 1.0, "")["met"] is at_most("x", math.nan, 1.0, "")["met"] is None
    assert [none("x", count, "of 9")["met"] for count in (0, 1)] == [True, False]


def test_pictures_that_cannot_be_drawn_are_listed_with_the_reason(tmp_path: Path) -> None:
    pytest.importorskip("jinja2", reason="writes with deltacharger[report]")

    def written(results: dict[str, Any], path: Path) -> None:
        path.write_text(results["shown"], "utf-8")

    def absent(results: dict[str, Any], path: Path) -> None:
        raise ModuleNotFoundError("No module named 'matplotlib'")

    report = Report("docking", "deltacharger report docking", ("numpy",))
    report.draw({"a.png": written, "b.png": absent, "c.png": written}, tmp_path, {"c.png": "not run"}, shown="all")
    assert ("shown" in report.results, report.results["pictures"]) == (False, ["a.png"])
    missing = report.results["missing_pictures"]
    assert (set(missing), missing["c.png"], "matplotlib" in missing["b.png"]) == ({"b.png", "c.png"}, "not run", True)
    assert [(path.name, path.read_text("utf-8")) for path in tmp_path.iterdir()] == [("a.png", "all")]
