# SPDX-License-Identifier: Apache-2.0
"""Every file in examples/ runs unchanged and prints what its docstring promises."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from deltacharger_core.environment import LARGEST_DOMAIN
from deltacharger_scenes.scene import load_scene

from .chargers import Process

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[1] / "examples"
QUICK = Path(__file__).parent / "scenes" / "quick.yaml"
DEADLINE = 110.0  # s; far longer than any takes, and inside of the suite's own limit
DOMAIN = (int(os.environ["ROS_DOMAIN_ID"]) + 5) % (LARGEST_DOMAIN + 1)
"""Of no other test: those of two workers are ten apart (workers.py)."""
ENVIRONMENT = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

# File, options, module without which it is skipped, and its output: regular expressions in order.
RUNS: tuple[tuple[str, Sequence[str], str, Sequence[str]], ...] = (
    (
        "ik_in_ten_lines.py",
        (),
        "",
        (
            r"15\.26 15\.26 15\.26.*OK",
            r"nan.*UNREACHABLE_FAR",
            r"back: \[ *0\. +0\. +80\.\] mm",
            r"0\.443 0\.443 0\.443",
        ),
    ),
    (
        "talk_to_the_emulator.py",
        (),
        "",
        (
            r"servo 1 answers: model 311",
            r"servo 3 answers: model 311",
            r"servo 1 moved by 10°",
            r"10x10 taxels at 120 Hz",
            r"\d+ frames, left [89]\.\d N, right [89]\.\d N",
            r"probe: 2\.0 Ω, target at 24\.0 V",
        ),
    ),
    (
        "train_a_model.py",
        ("{folder}/model.npz",),
        "sklearn",
        (r"judged on 825 others", r"accuracy [89]\d\.\d %; always the commonest class 2\d", r"may be acted on"),
    ),
    (
        "detect_in_a_picture.py",
        ("{folder}/picture.png",),
        "cv2",
        (r"in charger_base: \[ *1[12]\.", r"roll 4\.\d ± 0", r"off by [01]\.\d\d mm"),
    ),
    (
        "change_a_threshold.py",
        ("0.0003", "0.002"),
        "",
        (
            r"clearance_min 0\.0003 m: 15 of 20 charged, median \d\.\d s, least clearance 1\.\d mm, .* for 0\.0 s",
            r"clearance_min 0\.002 m: 0 of 20 charged, live without clearance for 0\.0 s",
        ),
    ),
)
ELSEWHERE = {"charge_robot.py": "test/bringup/test_fleet_page.py", "send_a_goal.py": "below", "charger.yaml": "below"}
"""Files that another test checks: name, and which."""


def _run(name: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        cwd=folder,
        env={**os.environ, **ENVIRONMENT},
    )


@pytest.mark.parametrize(("name", "options", "module", "printed"), RUNS, ids=[run[0] for run in RUNS])
def test_each_example_prints_its_promised_output(
    name: str, options: Sequence[str], module: str, printed: Sequence[str], tmp_path: Path
) -> None:
    if module:
        pytest.importorskip(module, reason=f"{name} needs {module}; `make optional` installs it")
    run = _run(name, *(option.format(folder=tmp_path) for option in options), folder=tmp_path)
    assert run.returncode == 0, run.stderr
    place = 0
    for pattern in printed:
        found = re.compile(pattern).search(run.stdout, place)
        assert found is not None, f"'{pattern}' is missing from:\n{run.stdout[place:]}"
        place = found.end()
    assert len(list(tmp_path.iterdir())) == sum("{folder}" in option for option in options)


def test_a_goal_is_sent_to_the_charger_that_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused = _run("send_a_goal.py", folder=tmp_path)
    assert refused.returncode == 1
    assert "deltacharger up" in refused.stderr
    for name, value in ENVIRONMENT.items():
        monkeypatch.setenv(name, value)
    charger = Process(sys.executable, "-m", "deltacharger_bringup.cli", "up", "--scene", str(QUICK))
    try:
        charger.wait_for_line("ready", charger.err)
        run = _run("send_a_goal.py", folder=tmp_path)
        assert run.returncode == 0, run.stderr
        assert re.search(r"approach .*contact .*measure .*energise .*charging with \d+\.\d A", run.stdout, re.DOTALL)
    finally:
        assert charger.end(signal.SIGINT) == 130


def test_the_file_for_real_hardware_is_a_scene() -> None:
    scene = load_scene(str(EXAMPLES / "charger.yaml"))
    assert scene.touches_hardware
    assert scene.docks


def test_the_examples_are_short_checked_and_named_in_the_table() -> None:
    files = {path.name for path in EXAMPLES.glob("*.*")} - {"README.md"}
    assert files == {run[0] for run in RUNS} | set(ELSEWHERE), "add the new one to RUNS, or to ELSEWHERE"
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert all(f"[{name}]({name})" in table for name in files)
    for name in files:
        assert len((EXAMPLES / name).read_text(encoding="utf-8").splitlines()) < 65, name
