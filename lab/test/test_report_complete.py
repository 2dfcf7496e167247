# SPDX-License-Identifier: Apache-2.0
"""Complete quick reports, run as commands: their files and targets. Only at night."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.night, pytest.mark.timeout(1800)]
MACHINE = re.compile("in motion|run time|10 ms")  # targets that depend on the computer
COMMAND = [sys.executable, "-m", "deltacharger_bringup.cli", "report"]


def written(tmp_path: Path, *words: str) -> tuple[dict[str, Any], str]:
    """Run a quick report and return its answer and its page, whose pictures exist."""
    ended = subprocess.run(
        [*COMMAND, *words, "--quick", "--json", "--out", str(tmp_path)], capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    answer = json.loads(ended.stdout)
    assert answer["success"] is True
    assert {Path(name) for name in answer["files"]} == {path for path in tmp_path.iterdir() if path.suffix != ".yaml"}
    page = (tmp_path / f"{words[0]}.md").read_text("utf-8")
    for name in re.findall(r"!\[[^]]+\]\(([^)]+)\)", page):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    assert not re.search(r"\| (nan|None) \|", page)
    return answer, page


@pytest.mark.parametrize(
    ("words", "needs"),
    [("kinematics", ""), ("simulation", ""), ("tactile", "sklearn torch"), ("vision --images 2", "cv2")],
)
def test_a_complete_report(tmp_path: Path, words: str, needs: str) -> None:
    for module in needs.split():
        pytest.importorskip(module, reason="`make optional` installs what all reports need")
    answer, page = written(tmp_path, *words.split())
    subject = words.split()[0]
    figures = json.loads((tmp_path / f"{subject}.json").read_text("utf-8"))
    assert f"`{figures['command']}`" in " ".join(page.split())
    assert answer["targets"] == figures["targets"]
    published = (Path(__file__).parents[2] / f"docs/reports/{subject}.md").read_text("utf-8")
    known = set(re.findall(r"^\| ([^|]+) \|.*\*\*NOT MET\*\*", published, re.MULTILINE))
    if subject in ("kinematics", "simulation"):  # few images and rigs miss the others'
        missed = [each["name"] for each in figures["targets"] if each["met"] is False]
        assert [name for name in missed if name not in known and not MACHINE.search(name)] == []


@pytest.mark.ros
def test_footprint_measures_both_ways_of_a_scene_and_reports_one_that_does_not_run(tmp_path: Path) -> None:
    from deltacharger_lab.reports.footprint.measure import ONE, SEPARATE, WAYS

    small, broken = tmp_path / "small.yaml", tmp_path / "broken.yaml"
    small.write_text("simulation: {servos: board}\nnodes: [tactile_node, servo_node]\n", "utf-8")
    broken.write_text("nodes: [kinematics_node]\nparameters: {kinematics_node: {no_such: 1}}\n", "utf-8")
    answer, page = written(tmp_path, "footprint", "--scene", str(small), "--scene", str(broken))
    assert set(answer["left_out"]) == {f"broken, {way}" for way in WAYS}
    assert all("no_such" in why for why in answer["left_out"].values())
    rows = {row["way"]: row for row in answer["rows"]}
    assert [rows[way]["processes"][0] for way in (ONE, SEPARATE)] == [1, 3]
    for row in rows.values():
        for key in ("ready_s", "pss_mb", "rss_mb", "rest_percent", "threads", "rest_tactile_frame_hz"):
            assert 0.0 < row[key][1] <= row[key][0] <= row[key][2]
        assert row["docking_percent"] == [None] * 3
    assert "| not measured |" in page
