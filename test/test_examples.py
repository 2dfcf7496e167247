# SPDX-License-Identifier: Apache-2.0
"""Every file in examples/ runs unchanged and prints what its docstring promises."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from deltacharger_core.environment import LARGEST_DOMAIN

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[1] / "examples"
DEADLINE = 110.0  # s; far longer than any needs, and below the suite's limit
DOMAIN = (int(os.environ["ROS_DOMAIN_ID"]) + 5) % (LARGEST_DOMAIN + 1)
"""Used by no other test: domains of two workers are ten apart (workers.py)."""

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
            r"servo 2 without supply: silent",
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
        "send_a_goal.py",
        (str(Path(__file__).parent / "scenes" / "quick.yaml"),),  # a busy computer is no broken cable there
        "",
        (
            r"no charger answers; starting that of the scene '.*quick.yaml'",
            r"approach",
            r"contact",
            r"measure",
            r"energise",
            r"charging with \d+\.\d A after \d+ alignments",
        ),
    ),
)
ELSEWHERE: dict[str, str] = {"charge_robot.py": "test/bringup/test_fleet_page.py"}
"""Files that another test runs: name and test."""


@pytest.mark.parametrize(("name", "options", "module", "printed"), RUNS, ids=[run[0] for run in RUNS])
def test_each_example_prints_its_promised_output(
    name: str, options: Sequence[str], module: str, printed: Sequence[str], tmp_path: Path
) -> None:
    if module:
        pytest.importorskip(module, reason=f"{name} needs {module}; `make optional` installs it")
    ours = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    words = [option.format(folder=tmp_path) for option in options]
    run = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *words],
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        cwd=tmp_path,
        env={**os.environ, **ours},
    )
    assert run.returncode == 0, run.stderr
    place = 0
    for pattern in printed:
        found = re.compile(pattern).search(run.stdout, place)
        assert found is not None, f"'{pattern}' is missing from:\n{run.stdout[place:]}"
        place = found.end()
    assert len(list(tmp_path.iterdir())) == sum("{folder}" in option for option in options)


def test_every_example_is_tested_and_listed_in_the_table() -> None:
    files = {path.name for path in EXAMPLES.glob("*.py")}
    assert files == {run[0] for run in RUNS} | set(ELSEWHERE), "add the new one to RUNS, or to ELSEWHERE"
    table = (EXAMPLES / "README.md").read_text(encoding="utf-8")
    assert all(f"[{name}]({name})" in table for name in files)
