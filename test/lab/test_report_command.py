# SPDX-License-Identifier: Apache-2.0
"""Every `deltacharger report` with wrong arguments, with a file in place of its folder, and with Ctrl-C."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_bringup.cli.main import main

WRONG = [
    *(("kinematics", "--points", text) for text in ("0", "49", "100001", "1e3")),
    *(("vision", "--images", text) for text in ("1", "1001")),
    *((subject, "--seed", text) for subject in ("kinematics", "tactile", "vision") for text in ("-1", "1.5")),
    *(("footprint", "--repeats", text) for text in ("0", "1.5")),
    *((subject, "--seed", "1") for subject in ("footprint", "simulation")),
    ("simulation", "more"),
    *((subject, "--quik") for subject in ("docking", "footprint", "kinematics", "simulation", "tactile", "vision")),
]


@pytest.mark.parametrize("words", WRONG, ids=" ".join)
def test_wrong_arguments_exit_with_2(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    assert main(("report", *words, "--json")) == 2
    assert json.loads(capsys.readouterr().out)["success"] is False


@pytest.mark.parametrize("subject", ["footprint", "kinematics", "simulation", "tactile", "vision"])
def test_a_file_in_place_of_the_folder_exits_with_2(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, subject: str
) -> None:
    path = tmp_path / "file"
    path.write_text("kept", encoding="utf-8")
    for out in (path, path / "below"):
        assert main(("report", subject, "--quick", "--out", str(out), "--json")) == 2
        assert "--out" in json.loads(capsys.readouterr().out)["error"]
    assert path.read_text("utf-8") == "kept"


@pytest.mark.parametrize(
    ("words", "missing", "extra"),
    [
        ("report kinematics", ("mpmath",), "report"),
        ("report tactile", ("sklearn", "xgboost", "torch"), "train"),
        ("tactile compare", ("sklearn", "xgboost", "torch"), "train"),
        ("report vision", ("cv2",), "vision"),
    ],
)
def test_without_a_needed_library_the_error_names_what_to_install(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: str,
    missing: tuple[str, ...],
    extra: str,
) -> None:
    for module in missing:
        monkeypatch.setitem(sys.modules, module, None)
    assert main((*words.split(), "--quick", "--out", str(tmp_path), "--json")) == 1
    assert f"install deltacharger[{extra}]" in json.loads(capsys.readouterr().out)["error"]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.rest
@pytest.mark.timeout(300)
@pytest.mark.parametrize(("subject", "module"), [("tactile", "sklearn"), ("vision", "cv2")])
def test_an_interruption_ends_it_without_a_traceback(tmp_path: Path, subject: str, module: str) -> None:
    pytest.importorskip(module, reason="`make optional` installs what all reports need")
    words = [sys.executable, "-m", "deltacharger_bringup.cli", "report", subject, "--quick", "--json"]
    running = subprocess.Popen(
        [*words, "--out", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert running.stderr is not None
    assert "%" in next(line for line in running.stderr if "absent" not in line)  # the first task is done
    running.send_signal(signal.SIGINT)
    out, errors = running.communicate(timeout=60)
    assert running.returncode == 130
    assert "Traceback" not in errors
    assert json.loads(out) == {"success": False, "error": "interrupted"}
    assert list(tmp_path.iterdir()) == []
