# SPDX-License-Identifier: Apache-2.0
"""charger.launch.py: killed nodes that move nothing and carry no current restart by themselves, and serve again.

Without launch: test_killed_nodes.py restarts such nodes by hand, beside a running charger. Causes that end the
complete charger are in test_charger_launch_ends.py.
"""

from __future__ import annotations

import os
import signal
import unittest
from typing import Any

import pytest
from deltacharger.srv import SolveForwardKinematics

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest

from ..chargers import DEADLINE, dock_at_last, wait_until
from .launched import (
    QUICK_NODES,
    assert_all_ended_with_0,
    charger,
    description,
    launch_testing,
    run_launch_tests,
)

pytestmark = pytest.mark.ros

NAMESPACE = f"launch_killed_{os.getpid()}"
KILLED = ("mock_detector_node", "misalignment_node", "kinematics_node")


def generate_test_description() -> Any:
    return description(charger(namespace=NAMESPACE))


class TestKilled(unittest.TestCase):
    """While it runs; collected by launch_testing only."""

    __test__ = False

    def test_killed_nodes_restart_and_serve(self, proc_info: Any) -> None:
        with ChargerClient(NAMESPACE) as client:
            assert client.wait_until_ready(DEADLINE)
            docking = self.pid(proc_info, "/docking_node")
            for name in KILLED:
                killed = self.pid(proc_info, name)
                os.kill(killed, signal.SIGKILL)
                wait_until(lambda: self.pid(proc_info, name) not in (0, killed), f"{name} again")  # noqa: B023
            dock_at_last(client, DockRequest(None))  # it asks detector and estimator
            assert client.undock(deadline=DEADLINE).success
            service = client.node.create_client(SolveForwardKinematics, "solve_forward_kinematics")
            assert service.wait_for_service(DEADLINE)
            answer = service.call_async(SolveForwardKinematics.Request(angles=[0.0, 0.0, 0.0]))
            wait_until(answer.done, "kinematics_node to answer")
            assert list(answer.result().status) == [0]
            assert self.pid(proc_info, "/docking_node") == docking, "the others keep running"

    @staticmethod
    def pid(proc_info: Any, name: str) -> int:
        """Return the process of an executable; 0 without one."""
        from launch.events.process import ProcessStarted

        events = [event for event in list(proc_info) if event.cmd[0].endswith(name)]
        return events[0].pid if events and isinstance(events[0], ProcessStarted) else 0


@launch_testing.post_shutdown_test()
class TestShutdown(unittest.TestCase):
    """After SIGINT to all processes; collected by launch_testing only."""

    __test__ = False

    def test_every_node_ended_with_0(self, proc_info: Any) -> None:
        assert_all_ended_with_0(proc_info, QUICK_NODES)


def test_killed_nodes_restart_when_launched() -> None:
    run_launch_tests(__name__, 2)
