# SPDX-License-Identifier: Apache-2.0
"""Every file in examples/ runs unchanged and prints what its docstring promises."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from deltacharger_bringup.scenes.scene import load_scene, problems
from deltacharger_core.environment import LARGEST_DOMAIN

from .chargers import Process
from .marks import rest

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[1] / "examples"
QUICK = Path(__file__).parent / "scenes" / "quick.yaml"
DEADLINE = 110.0  # s; far longer than any takes, and inside of the suite's own limit
DOMAIN = (int(os.environ["ROS_DOMAIN_ID"]) + 5) % (LARGEST_DOMAIN + 1)
"""Of no other test: those of two workers are ten apart (workers.py)."""
ENVIRONMENT = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}

# File: options, and its output as an expression.
RUNS = {
    "ik_in_ten_lines.py": ("", r"15\.26 15\.26 15\.26.*OK.*nan.*UNREACHABLE_FAR.* 80\.\] mm.*0\.443 0\.443 0\.443"),
    "talk_to_the_emulator.py": (
        "",
        r"servo 1 answers: model 311.*moved by (9|10)°.*10x10 taxels at 120 Hz.*at most 0\.\d N.*OPEN port",
    ),
    "detect_in_a_picture.py": ("{}/a.png", r"charger_base: \[ *1[12]\..*roll 4\.\d ± 0.*off by [01]\.\d\d mm"),
    "change_a_threshold.py": (
        "0.0003 0.002",
        r"0\.0003 m: 16 of 20 charged, .* 1\.0 mm, .* for 0\.0 s.*0\.002 m: 0 of 20 charged, .* for 0\.0 s",
    ),
}


def _run(name: str, *words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        cwd=folder,
        env={**os.environ, **ENVIRONMENT},
    )


@pytest.mark.parametrize(
    "name",
    ["ik_in_ten_lines.py", pytest.param("talk_to_the_emulator.py", marks=pytest.mark.witness), *map(rest, [*RUNS][2:])],
)
def test_each_example_prints_its_promised_output(name: str, tmp_path: Path) -> None:
    options, printed = RUNS[name]
    if name == "detect_in_a_picture.py":
        pytest.importorskip("cv2", reason="`make optional` installs it")
    run = _run(name, *options.format(tmp_path).split(), folder=tmp_path)
    assert run.returncode == 0, run.stderr
    assert re.search(printed, run.stdout, re.DOTALL), run.stdout
    assert len(list(tmp_path.iterdir())) == options.count("{}")


@pytest.mark.rest
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
    assert not list(problems(scene))
