# SPDX-License-Identifier: Apache-2.0
"""charger.launch.py twice in one launch, distinguished by namespace only; neither affects the other.

Without launch: test_two_chargers.py.
"""

from __future__ import annotations

import os
import unittest
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions

from .launched import (
    QUICK_NODES,
    assert_all_ended_with_0,
    charger,
    description,
    launch_testing,
    run_launch_tests,
)
from .test_two_chargers import Watched

pytestmark = pytest.mark.ros

NAMES = [f"launch_{side}_{os.getpid()}" for side in ("left", "right")]


def generate_test_description() -> Any:
    return description(*(charger(namespace=name) for name in NAMES))


class TestTwo(unittest.TestCase):
    """While they run; collected by launch_testing only."""

    __test__ = False

    def test_neither_affects_the_other(self) -> None:
        context = Context()
        rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
        left, right = (Watched(name, context) for name in NAMES)
        try:
            for each in (left, right):
                each.ready()
            right.forget()
            assert left.dock().success
            right.assert_at_rest()
            assert right.dock().success
            right.forget()
            assert left.undock().success
            right.assert_charging()
            assert right.undock().success
        finally:
            for each in (left, right):
                each.client.close()
            rclpy.try_shutdown(context=context)


@launch_testing.post_shutdown_test()
class TestShutdown(unittest.TestCase):
    """After SIGINT to all processes; collected by launch_testing only."""

    __test__ = False

    def test_every_node_ended_with_0(self, proc_info: Any) -> None:
        assert_all_ended_with_0(proc_info, 2 * QUICK_NODES)


def test_two_chargers_dock_when_launched() -> None:
    run_launch_tests(__name__, 3)
