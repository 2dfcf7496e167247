# SPDX-License-Identifier: Apache-2.0
"""Every `deltacharger report` with wrong arguments, a file in place of its folder, or without a library."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from deltacharger_bringup.cli.main import main


@pytest.mark.parametrize(
    "words",
    [
        *(("kinematics", "--points", text) for text in ("49", "100001", "1e3")),
        *(("vision", "--images", text) for text in ("1", "1001")),
        *(("tactile", "--seed", text) for text in ("-1", "1.5")),
        *(("footprint", "--repeats", text) for text in ("0", "1.5")),
        *((subject, "--seed", "1") for subject in ("footprint", "simulation")),
        ("simulation", "more"),
        ("docking", "--quik"),
        ("docking", "--only", "egde", "--out", "PATH"),
        ("footprint", "--scene", "bensch"),
        *((subject, "--quick", "--out", "FILE") for subject in ("footprint", "kinematics", "tactile", "vision")),
        ("simulation", "--quick", "--out", "FILE/below"),
    ],
    ids=" ".join,
)
def test_wrong_arguments_exit_with_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, words: tuple[str, ...]
) -> None:
    file = tmp_path / "file"
    file.write_text("kept", encoding="utf-8")
    words = tuple(word.replace("FILE", str(file)).replace("PATH", str(tmp_path / "new")) for word in words)
    assert main(("report", *words, "--json")) == 2
    assert json.loads(capsys.readouterr().out)["success"] is False
    assert [(path.name, path.read_text()) for path in tmp_path.rglob("*") if path.is_file()] == [("file", "kept")]


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("report kinematics", "mpmath", "report"),
        ("report tactile", "sklearn xgboost torch", "train"),
        ("tactile compare", "sklearn xgboost torch", "train"),
        ("report vision", "cv2", "vision"),
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
    assert main((*words.split(), "--quick", "--out", str(tmp_path), "--json")) == 1
    assert f"deltacharger[{extra}]" in json.loads(capsys.readouterr().out)["error"]
    assert list(tmp_path.iterdir()) == []
