# SPDX-License-Identifier: Apache-2.0
"""Commands of the lab with wrong arguments, a file in place of a folder, or without a library; targets and pictures."""

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
    "words",
    [
        ("campaign",),
        ("campaign", "--out", "FILE/no/where"),
        ("campaign", "--out", "FILE"),
        ("campaign", "--out", "PATH", "--scenes", "defualt"),
        ("campaign", "--out", "PATH", "--scheduler", "tcp://127.0.0.1:9", "--workers", "2"),
        *(("campaign", "compare", "PATH", "PATH", *more) for more in ((), ("--picture", "a.doc"))),
        *(
            ("tactile", "record", "--protocol", "paper", *more.split(), "--out", "PATH")
            for more in ("--set angle", "--compose", "--repeat 2", "--namespace a", "--x-mm 3")
        ),
        *(("report", "kinematics", "--points", text) for text in ("49", "100001", "1e3")),
        *(("report", "vision", "--images", text) for text in ("1", "1001")),
        *(("report", "tactile", "--seed", text) for text in ("-1", "1.5")),
        *(("report", "footprint", "--repeats", text) for text in ("0", "1.5")),
        *(("report", subject, "--seed", "1") for subject in ("footprint", "simulation")),
        ("report", "simulation", "more"),
        ("report", "docking", "--quik"),
        ("report", "docking", "--only", "egde", "--out", "PATH"),
        ("report", "footprint", "--scene", "bensch"),
        *(
            ("report", subject, "--quick", "--out", "FILE")
            for subject in ("footprint", "kinematics", "tactile", "vision")
        ),
        ("report", "simulation", "--quick", "--out", "FILE/below"),
    ],
    ids=" ".join,
)
def test_wrong_arguments_exit_with_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...]
) -> None:
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    words = tuple(word.replace("FILE", str(file)).replace("PATH", str(tmp_path / "new")) for word in words)
    assert main((*words, "--json")) == 2
    assert json.loads(capsys.readouterr().out)["success"] is False
    assert [(path.name, path.read_text()) for path in tmp_path.rglob("*") if path.is_file()] == [("file", "kept")]


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
