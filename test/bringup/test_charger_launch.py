"""launch/charger.launch.py: the mocks scene in separate processes docks, and every node ends with 0.

The same scenario without launch stands in test_processes.py and, by code, in test_docking_mocks.py. This file is also
what `launch_test test/bringup/test_charger_launch.py` runs.
"""

from __future__ import annotations

import os
import sys
import time
import unittest
from pathlib import Path
from typing import Any

import pytest

_WHY = "launch and launch_testing come with a ROS installation, not from PyPI"
launch = pytest.importorskip("launch", reason=_WHY)
launch_testing = pytest.importorskip("launch_testing", reason=_WHY)
pytest.importorskip("launch_ros", reason=_WHY)

ROOT = Path(__file__).resolve().parents[2]
NAMESPACE = f"launch_{os.getpid()}"
DEADLINE = 30.0  # s

os.environ.setdefault("ROS_DOMAIN_ID", "88")
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


def generate_test_description() -> Any:
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource
    from launch_testing.actions import ReadyToTest

    scene = Path(__file__).with_name("quick.yaml")
    charger = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(ROOT / "launch" / "charger.launch.py")),
        launch_arguments={"scene": str(scene), "namespace": NAMESPACE, "log_level": "warn"}.items(),
    )
    return launch.LaunchDescription([charger, ReadyToTest()])


class TestDocking(unittest.TestCase):
    """While it runs; collected by launch_testing alone."""

    __test__ = False

    def test_a_goal_is_served_to_its_end(self) -> None:
        from deltacharger_bringup.client import ChargerClient
        from deltacharger_bringup.outcomes import DockRequest, Pose

        end = time.monotonic() + DEADLINE  # a process that starts late makes the first goal fail as retriable
        with ChargerClient(NAMESPACE) as client:
            assert client.wait_until_ready(DEADLINE)
            docked = client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE)
            while not docked.success and docked.retriable and time.monotonic() < end:
                docked = client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE)
            assert docked.success, docked
            undocked = client.undock(deadline=DEADLINE)
            assert undocked.success, undocked


@launch_testing.post_shutdown_test()
class TestShutdown(unittest.TestCase):
    """After SIGINT to all of it; collected by launch_testing alone."""

    __test__ = False

    def test_every_node_ended_with_0(self, proc_info: Any) -> None:
        launch_testing.asserts.assertExitCodes(proc_info)
        assert len(proc_info.processes()) == 6


def test_the_mocks_dock_when_launched() -> None:
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix
    from launch_testing.loader import LoadTestsFromPythonModule
    from launch_testing.test_runner import LaunchTestRunner

    try:
        get_package_prefix("deltacharger")
    except PackageNotFoundError:
        pytest.skip("deltacharger is not installed where ament finds it: launch looks executables up there")
    runner = LaunchTestRunner(LoadTestsFromPythonModule(sys.modules[__name__], name="charger_launch"))
    runner.validate()
    began = time.monotonic()
    results = runner.run()
    for result in results.values():
        assert result.wasSuccessful(), [*result.errors, *result.failures]
        assert result.testsRun > 0
    assert time.monotonic() - began < 4 * DEADLINE
