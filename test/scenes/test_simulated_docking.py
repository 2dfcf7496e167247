# SPDX-License-Identifier: Apache-2.0
"""Docking with the real actions, drivers and bytes, in the simulated world; cancels in each phase: test/docking."""

from __future__ import annotations

import json
import math
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from deltacharger_ros.outcomes import DockRequest, Pose, Progress
from deltacharger_scenes.scene import parse_scene

from ..quick import SCENE, STEPS
from ..running_charger import QUICK, RunningCharger

pytestmark = pytest.mark.ros

HERE = Pose(0.0, 0.0, 0.080)


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(parse_scene(QUICK, "simulated"), context) as charger:
        yield charger


@pytest.mark.witness
def test_it_docks_and_charges_and_a_cancel_of_the_next_goal_ends_safely(charger: RunningCharger) -> None:
    assert charger.charge().details["charge_current"] > 0.5
    charger.go_home()
    cancel = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == "energise":
            cancel.set()

    outcome = charger.dock(on_progress=on_progress, cancel=cancel)
    assert (cancel.is_set(), outcome.error_name) == (True, "CANCELED"), outcome
    charger.assert_safe()
    assert math.dist(charger.world.snapshot().position, (0.0, 0.0, 0.0)) < 0.003


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (DockRequest(Pose(math.nan, 0.0, 0.08)), "REJECTED"),
        (DockRequest(HERE, critical_angle=0.4), "REJECTED"),
        (DockRequest(Pose(0.0, 0.0, 0.5)), "UNREACHABLE"),
        (DockRequest(Pose(0.0, 0.0, 0.08, math.radians(12.5))), "CRITICAL_ANGLE"),
    ],
)
def test_an_impossible_goal_is_aborted_with_its_code_and_nothing_moves(
    charger: RunningCharger, request_: DockRequest, code: str
) -> None:
    before = len(charger.world.events)
    outcome = charger.dock(request_)
    assert (outcome.success, outcome.error_name) == (False, code)
    assert outcome.error_message
    assert (outcome.details["suggested_base_pose"] is not None) == (code == "UNREACHABLE")
    assert charger.world.events[before:] == []


@pytest.mark.rest
def test_sigint_cancels_and_exits_with_130(
    start: Callable[..., Any], deltacharger: tuple[str, ...], namespace: str, tmp_path: Path
) -> None:
    scene = tmp_path / "quick.yaml"
    steps = {"docking_node": {**STEPS, "charge_stable_time": 2.0}}  # so that a signal arrives while it energises
    scene.write_text(yaml.safe_dump({**SCENE, "goal": {"z": HERE.z}, "parameters": steps}), encoding="utf-8")
    process = start(*deltacharger, "dock", "--json", "--no-picture", "--namespace", namespace, "--scene", str(scene))
    process.wait_for_line(" s  energise ", process.err)
    assert process.end(signal.SIGINT) == 130
    answer = json.loads(process.out[-1])
    assert answer["error_name"] == "CANCELED"
    assert answer["simulation"]["energised_shorts"] == 0
    assert not any("Traceback" in line for line in process.err), process.err
