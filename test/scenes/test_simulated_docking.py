# SPDX-License-Identifier: Apache-2.0
"""Docking with the real actions, drivers and bytes, in the simulated world."""

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

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose, Progress
from deltacharger_scenes.composition import Composition

from ..chargers import DEADLINE
from ..marks import rest
from ..quick import SCENE, STEPS, quick_simulation

pytestmark = pytest.mark.ros

MOVED = {"overlap_loss_max": 0.004, "landing_limit": 0.0025}  # as by default, so that the arm must move to align
HERE = Pose(0.0, 0.0, 0.080)
GOAL = DockRequest(HERE)
PHASES = [*map(rest, ("approach", "contact", "measure", "align")), "energise"]


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Composition]:
    with Composition(quick_simulation("simulated", MOVED), context, "simulated_docking") as composition:
        yield composition


@pytest.fixture(scope="module")
def client(charger: Composition) -> Iterator[ChargerClient]:
    with ChargerClient("simulated_docking") as client:
        assert client.wait_until_ready(DEADLINE)
        yield client


def assert_safe(charger: Composition) -> None:
    """True state, unknown to docking: contactor open, never a short, arm back at its start."""
    assert charger.charger is not None
    world = charger.charger.world
    truth = world.snapshot()
    assert not truth.contactor_closed
    assert world.record.energised_shorts == 0
    assert world.record.energised_unsafe == 0.0
    assert math.dist(truth.position, (0.0, 0.0, 0.0)) < 0.003


@pytest.mark.parametrize(
    ("request_", "code"),
    [
        (DockRequest(Pose(math.nan, 0.0, 0.08)), "REJECTED"),
        (DockRequest(Pose(0.0, 0.0, 0.08, math.nan)), "REJECTED"),
        (DockRequest(Pose(0.0, 0.0, 0.08, 0.0, "map")), "REJECTED"),
        (DockRequest(HERE, critical_angle=0.4), "REJECTED"),
        (DockRequest(HERE, critical_angle=-0.1), "REJECTED"),
        (DockRequest(HERE, critical_angle=math.nan), "REJECTED"),
        (DockRequest(Pose(0.0, 0.0, 0.5)), "UNREACHABLE"),
        (DockRequest(Pose(0.2, 0.0, 0.08)), "UNREACHABLE"),
        (DockRequest(Pose(0.0, 0.0, 0.08, math.radians(12.5))), "CRITICAL_ANGLE"),
        (DockRequest(None), "ELECTRODES_NOT_FOUND"),
    ],
)
def test_an_impossible_goal_is_aborted_with_its_code_and_nothing_moves(
    charger: Composition, client: ChargerClient, request_: DockRequest, code: str
) -> None:
    outcome = client.dock(request_, deadline=60.0)
    assert not outcome.success
    assert outcome.error_name == code
    assert outcome.error_message
    assert (outcome.details["suggested_base_pose"] is not None) == (code == "UNREACHABLE")
    assert_safe(charger)


@pytest.mark.parametrize("phase", PHASES)
def test_a_cancel_in_any_phase_ends_safely_and_the_next_goal_is_served(
    charger: Composition, client: ChargerClient, phase: str
) -> None:
    cancel = threading.Event()

    def on_progress(progress: Progress) -> None:
        if progress.phase == phase:
            cancel.set()

    outcome = client.dock(GOAL, on_progress, cancel, deadline=120.0)
    assert cancel.is_set(), f"phase {phase} was never entered: {outcome}"
    assert outcome.error_name == "CANCELED"
    assert_safe(charger)


@pytest.mark.rest
@pytest.mark.parametrize("phase", ["approach", "energise"])
def test_sigint_cancels_and_exits_with_130(
    start: Callable[..., Any], deltacharger: tuple[str, ...], phase: str, namespace: str, tmp_path: Path
) -> None:
    scene = tmp_path / "quick.yaml"
    steps = {"docking_node": {**STEPS, "charge_stable_time": 2.0}}  # so that a signal arrives while it energises
    scene.write_text(yaml.safe_dump({**SCENE, "goal": {"z": HERE.z}, "parameters": steps}), encoding="utf-8")
    process = start(*deltacharger, "dock", "--json", "--namespace", namespace, "--scene", str(scene))
    process.wait_for_line(f" s  {phase} ", process.err)
    assert process.end(signal.SIGINT) == 130
    answer = json.loads(process.out[-1])
    assert answer["error_name"] == "CANCELED"
    assert answer["simulation"]["energised_shorts"] == 0
    assert not any("Traceback" in line for line in process.err), process.err
