# SPDX-License-Identifier: Apache-2.0
"""Commands of the lab without a library; a report's targets and pictures."""

import errno
import json
import math
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.reports.report import Report, at_least, at_most, none
from deltacharger_lab.training.__main__ import COMMANDS
from test.bringup.command import refuses


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("report tactile --quick", "sklearn xgboost torch", "deltacharger-lab[train]"),
        ("report vision --quick", "cv2", "deltacharger[vision]"),
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
    assert extra in json.loads(capsys.readouterr().out)["error"]
    assert list(tmp_path.iterdir()) == []


# Command line, and a noun of what is said about it.
REFUSED = {
    "report kinematics --quick --out /proc/report": "/proc/report",
    "evaluate --data none.npz --model none.npz": "none.npz",
    "train --data text.npz --model lda --target pose --out m.npz": "--model pose",
    "campaign --out text.npz": "text.npz is a file",
    "campaign --out new --scenes defualt": "'default'",
    "campaign --compare new new": "_campaign.json",
    "report footprint --scene bensch": "'bench'",
    "report docking --only egde --out new": "egde",
    "report kinematics --quick --out text.npz": "--out",
}


@pytest.mark.parametrize("line", REFUSED)
def test_wrong_input_ends_with_2_and_a_noun(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "text.npz").write_text("no archive")
    refuses(capsys, line, REFUSED[line], commands=COMMANDS if line.split()[0] in COMMANDS else None)
    assert [path.name for path in tmp_path.iterdir()] == ["text.npz"], "nothing is written"


@pytest.mark.parametrize("line", ["report kinematics --quick --out {0}/new", "campaign -n 1 --out {0}/new/a"])
def test_a_folder_is_tried_before_any_work(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path, line: str
) -> None:
    def fail(*arguments: object, **more: object) -> None:
        raise OSError(errno.EACCES, os.strerror(errno.EACCES), str(tmp_path))

    monkeypatch.setattr(Path, "mkdir", fail)
    refuses(capsys, line.format(tmp_path), str(tmp_path))


def test_a_target_is_met_up_to_its_limit_and_rounding() -> None:
    assert at_most("x", 0.1 + 0.2, 0.3, "m")["met"] is True
    assert at_most("x", 0.301, 0.3, "m")["met"] is False
    assert at_least("x", 99.5, 99.5, "%")["met"] is True
    assert at_most("x", 6e-16, 5e-16, "m")["met"] is False
    assert at_least("x", None, 1.0, "")["met"] is at_most("x", math.nan, 1.0, "")["met"] is None
    assert [none("x", count, "of 9")["met"] for count in (0, 1)] == [True, False]


def test_pictures_without_data_are_listed_with_the_reason(tmp_path: Path) -> None:
    def written(results: dict[str, Any], path: Path) -> None:
        path.write_text(results["shown"], "utf-8")

    report = Report("docking", "deltacharger report docking", ("numpy",))
    report.draw({"a.png": written, "c.png": written}, tmp_path, {"c.png": "not run"}, shown="all")
    assert ("shown" in report.results, report.results["pictures"]) == (False, ["a.png"])
    assert report.results["missing_pictures"] == {"c.png": "not run"}
    assert [(path.name, path.read_text("utf-8")) for path in tmp_path.iterdir()] == [("a.png", "all")]
