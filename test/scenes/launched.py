# SPDX-License-Identifier: Apache-2.0
"""Chargers started by launch: charger.launch.py under launch_testing's runner, or under `ros2 launch` as a process.

launch and launch_testing come with a ROS installation, not from PyPI; without them, tests that import this
module are skipped. The executables are those of the installed package, which ament must find.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

_WHY = "launch and launch_testing come with a ROS installation, not from PyPI"
launch = pytest.importorskip("launch", reason=_WHY)
launch_testing = pytest.importorskip("launch_testing", reason=_WHY)
pytest.importorskip("launch_ros", reason=_WHY)

FILE = Path(__file__).resolve().parents[2] / "launch" / "charger.launch.py"
QUICK = Path(__file__).with_name("quick.yaml")
PATIENCE = "60"  # s until launch forces a node to end, so that a loaded computer fails no test
QUICK_NODES = 6  # started by quick.yaml


def charger(**arguments: str) -> Any:
    """Return the action that includes the launch file, with the quick scene unless another is given."""
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import PythonLaunchDescriptionSource

    settings = {"scene": str(QUICK), "log_level": "warn", "sigterm_timeout": PATIENCE} | arguments
    return IncludeLaunchDescription(PythonLaunchDescriptionSource(str(FILE)), launch_arguments=settings.items())


def description(*chargers: Any) -> Any:
    """Return the launch description of generate_test_description: tests begin at once, and wait for what they need."""
    from launch_testing.actions import ReadyToTest

    return launch.LaunchDescription([*chargers, ReadyToTest()])


@contextmanager
def domain(offset: int) -> Iterator[None]:
    """Run this process, and those that it starts, in a ROS domain different from the other tests'."""
    before = os.environ["ROS_DOMAIN_ID"]
    os.environ["ROS_DOMAIN_ID"] = str((int(before) + offset) % 233)
    try:
        yield
    finally:
        os.environ["ROS_DOMAIN_ID"] = before


def need_the_package() -> None:
    """Skip if ament does not find the executables."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        get_package_prefix("deltacharger")
    except PackageNotFoundError:
        pytest.skip("ament does not find deltacharger: launch needs it for the executables")


def run_launch_tests(module: str, offset: int) -> None:
    """Run generate_test_description and the TestCases of a test module, in a separate domain."""
    from launch_testing.loader import LoadTestsFromPythonModule
    from launch_testing.test_runner import LaunchTestRunner

    need_the_package()
    runner = LaunchTestRunner(LoadTestsFromPythonModule(sys.modules[module], name=module.rpartition(".")[2]))
    runner.validate()
    with domain(offset):
        results = runner.run()
    for result in results.values():
        assert result.wasSuccessful(), [*result.errors, *result.failures]
        assert result.testsRun > 0


def assert_all_ended_with_0(proc_info: Any, count: int) -> None:
    """Check the last exit code of each process."""
    launch_testing.asserts.assertExitCodes(proc_info)
    assert len(proc_info.processes()) == count
