# SPDX-License-Identifier: Apache-2.0
"""A complete quick report, run as a command for the module that names it in REPORT; tests that read it are slow."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
Quick = tuple[Path, dict[str, Any], dict[str, Any], str]


@pytest.fixture(scope="module")
def quick_report(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Quick:
    """Run the command for real: its folder, output, figures and page."""
    subject, *options = request.module.REPORT
    for module in request.module.MEASURES_WITH:
        pytest.importorskip(module, reason="`make optional` installs what all reports need")
    folder = tmp_path_factory.mktemp("report")
    words = [sys.executable, "-m", "deltacharger_bringup.cli", "report", subject, "--quick", *options]
    ended = subprocess.run([*words, "--json", "--out", str(folder)], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    figures = json.loads((folder / f"{subject}.json").read_text("utf-8"))
    answer = json.loads(ended.stdout)
    assert answer["success"] is True
    assert {Path(name) for name in answer["files"]} == set(folder.iterdir())
    assert answer["targets"] == figures["targets"]
    assert answer.get("simulated", True) is True
    assert figures["pictures"] == list(importlib.import_module(f"deltacharger_lab.reports.{subject}.pictures").PICTURES)
    page = (folder / f"{subject}.md").read_text("utf-8")
    assert f"`{figures['command']}`" in " ".join(page.split())
    assert sorted(re.findall(r"!\[[^]]+\]\(([^)]+)\)", page)) == sorted(figures["pictures"])
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in figures["pictures"])
    return folder, answer, figures, page


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if item.path.is_relative_to(HERE) and "quick_report" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.rest)
            item.add_marker(pytest.mark.timeout(600))
