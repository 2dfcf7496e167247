# SPDX-License-Identifier: Apache-2.0
"""charger.launch.py on mocks, in separate processes: it docks and charges, refuses, is cancelled, and all end with 0.

Without launch: docking and exit codes in test_processes.py; refused and cancelled goals in test_docking_mocks.py.
"""

from __future__ import annotations

import os
import threading
import unittest
from typing import Any

import pytest

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress

from ..chargers import DEADLINE, wait_until
from .launched import (
    QUICK_NODES,
    assert_all_ended_with_0,
    charger,
    description,
    launch_testing,
    run_launch_tests,
)

pytestmark = pytest.mark.ros

NAMESPACE = f"launch_{os.getpid()}"
PLACE = Pose(0.0, 0.0, 0.080)


def generate_test_description() -> Any:
    return description(charger(namespace=NAMESPACE))


class TestDocking(unittest.TestCase):
    """While it runs; collected by launch_testing only."""

    __test__ = False
    client: ChargerClient

    @classmethod
    def setUpClass(cls) -> None:
        cls.client = ChargerClient(NAMESPACE)
        assert cls.client.wait_until_ready(DEADLINE)

    @classmethod
    def tearDownClass(cls) -> None:
        cls.client.close()

    def dock(self, request: DockRequest, **options: Any) -> Outcome:
        """Dock; a process that starts late makes the first goal fail as retriable."""
        outcomes: list[Outcome] = []

        def decided() -> bool:
            outcomes.append(self.client.dock(request, deadline=DEADLINE, **options))
            return not outcomes[-1].retriable or outcomes[-1].error_name == "CANCELED"

        wait_until(decided, f"a docking that need not be tried again: {outcomes}")
        return outcomes[-1]

    def test_a_goal_is_accepted_and_charges_and_undocking_ends_it(self) -> None:
        docked = self.dock(DockRequest(PLACE))
        assert docked.success, docked
        assert docked.details["charge_current"] > 0.5
        undocked = self.client.undock(deadline=DEADLINE)
        assert undocked.success, undocked

    def test_a_goal_that_cannot_be_served_is_refused_with_its_code(self) -> None:
        refused = self.dock(DockRequest(Pose(float("nan"), 0.0, 0.08)))
        assert (refused.success, refused.error_name) == (False, "REJECTED"), refused
        beyond = self.dock(DockRequest(Pose(0.5, 0.0, 0.08)))
        assert (beyond.success, beyond.error_name) == (False, "UNREACHABLE"), beyond

    def test_a_goal_is_cancelled(self) -> None:
        cancel = threading.Event()

        def on_progress(progress: Progress) -> None:
            if progress.phase in ("approach", "contact"):
                cancel.set()

        outcome = self.dock(DockRequest(PLACE), on_progress=on_progress, cancel=cancel)
        assert (outcome.success, outcome.error_name) == (False, "CANCELED"), outcome
        assert self.client.undock(deadline=DEADLINE).success


@launch_testing.post_shutdown_test()
class TestShutdown(unittest.TestCase):
    """After SIGINT to all processes; collected by launch_testing only."""

    __test__ = False

    def test_every_node_ended_with_0(self, proc_info: Any) -> None:
        assert_all_ended_with_0(proc_info, QUICK_NODES)


def test_the_mocks_dock_when_launched() -> None:
    run_launch_tests(__name__, 1)
