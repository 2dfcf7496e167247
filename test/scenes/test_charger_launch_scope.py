# SPDX-License-Identifier: Apache-2.0
"""charger.launch.py in a group of another launch file: namespace, remaps, parameters and environment apply.

A simulated scene and one on hardware, with emulated ports, behave equally: their names in the graph differ only by
the group's namespace.
"""

from __future__ import annotations

import contextlib
import os
import unittest
from typing import Any

import pytest
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from deltacharger_core import runtime
from deltacharger_ros.executor import Spinner
from deltacharger_scenes.scene import load_scene
from deltacharger_sim.charger.simulated_charger import SimulatedCharger

from ..chargers import wait_until
from ..nodes import call
from .launched import assert_all_ended_with_0, charger, description, launch_testing, run_launch_tests

pytestmark = pytest.mark.ros

GROUPS = ("simulated", "hardware")
NODES = ("servo_node", "tactile_node", "kinematics_node", "misalignment_node", "docking_node")
REMAPS = {"docking_state": "what_it_does", "dock/_action/status": "how_it_goes"}
OPENED = contextlib.ExitStack()


def pushed(group: str) -> str:
    return f"{group}_{os.getpid()}"


def domain_of_the_groups() -> int:
    """Return the ROS domain set in the groups' environment, not the launch's."""
    return (int(os.environ["ROS_DOMAIN_ID"]) + 1) % 233


def generate_test_description() -> Any:
    simulation = load_scene("simulated").simulation
    assert simulation is not None
    emulators = OPENED.enter_context(SimulatedCharger(simulation))
    ports = {"servo_port": emulators.servo_port, "board_port": emulators.board_port}
    return description(
        group("simulated", charger(scene="simulated", namespace="arm")),
        group("hardware", charger(scene="bench", namespace="arm", **ports)),
    )


def group(name: str, included: Any) -> Any:
    """Return a group with all settings that an integrator may put around a charger."""
    from launch.actions import GroupAction, SetEnvironmentVariable
    from launch_ros.actions import PushRosNamespace, SetParameter, SetRemap

    return GroupAction(
        [
            SetEnvironmentVariable("ROS_DOMAIN_ID", str(domain_of_the_groups())),
            PushRosNamespace(pushed(name)),
            SetParameter("use_sim_time", True),
            *(SetRemap(old, new) for old, new in REMAPS.items()),
            included,
        ]
    )


class TestScope(unittest.TestCase):
    """While they run; collected by launch_testing only."""

    __test__ = False

    @classmethod
    def setUpClass(cls) -> None:
        cls.context = Context()
        options = SignalHandlerOptions.NO
        rclpy.init(context=cls.context, args=[], domain_id=domain_of_the_groups(), signal_handler_options=options)
        cls.node = Node("integrator", context=cls.context, use_global_arguments=False)
        cls.spinner = Spinner(cls.node)

    @classmethod
    def tearDownClass(cls) -> None:
        cls.spinner.close()
        rclpy.try_shutdown(context=cls.context)

    def test_simulation_and_hardware_have_the_groups_names_and_clock(self) -> None:
        wanted = {f"/arm/{name}" for name in (*NODES, *REMAPS.values(), "undock/_action/send_goal")}
        wait_until(lambda: wanted <= self.names("simulated"), f"{wanted} in the graph")
        wait_until(lambda: self.names("simulated") == self.names("hardware"), "the same names of both")
        assert not {f"/arm/{old}" for old in REMAPS} & self.names("simulated")
        for each in GROUPS:
            for name in NODES:
                asked = self.node.create_client(GetParameters, f"/{pushed(each)}/arm/{name}/get_parameters")
                wait_until(asked.service_is_ready, f"{name} of {each}")
                response = call(asked, GetParameters.Request(names=["use_sim_time"]))
                assert response.values[0].bool_value, f"{name} of {each}"

    def test_a_fault_finds_the_simulated_charger_by_its_full_namespace(self) -> None:
        path = runtime.charger(domain_of_the_groups(), f"{pushed('simulated')}/arm")
        wait_until(path.is_symlink, str(path))

    def names(self, group: str) -> set[str]:
        """Return nodes, topics and services of a group, without its namespace."""
        others = [*self.node.get_topic_names_and_types(), *self.node.get_service_names_and_types()]
        nodes = [f"{where}/{name}" for name, where in self.node.get_node_names_and_namespaces()]
        every, outer = {*nodes, *(name for name, _ in others)}, f"/{pushed(group)}"
        return {name.removeprefix(outer) for name in every if name.startswith(f"{outer}/")}


@launch_testing.post_shutdown_test()
class TestShutdown(unittest.TestCase):
    """After SIGINT to all processes; collected by launch_testing only."""

    __test__ = False

    def test_every_node_ended_with_0(self, proc_info: Any) -> None:
        assert_all_ended_with_0(proc_info, 2 * len(NODES) + 1)


def test_a_groups_settings_apply_when_launched() -> None:
    with OPENED:
        run_launch_tests(__name__, 5)
