# SPDX-License-Identifier: Apache-2.0
"""Useful logs: one line at INFO for each goal, phase and failure; WARN and ERROR only if a person must act.

Read as a person reads them: in the standard error of the nodes' processes, as launch shows it, and in /rosout.
"""

from __future__ import annotations

import itertools
import re
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from deltacharger.action import Dock
from rcl_interfaces.msg import Log
from rclpy.action.client import ActionClient
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.executor import Spinner
from deltacharger_ros.messages import fill_pose
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, Process, dock_at_last, new_namespace, wait_until
from ..marks import rest
from ..nodes import answer, call, options
from .test_processes import arguments

pytestmark = pytest.mark.ros

PLACE = Pose(0.0, 0.0, 0.080)
ROSOUT = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
WARN = 30  # of rcl_interfaces/Log
ALARM = re.compile(r"\[(WARN|ERROR|FATAL)\]")


class Charger:
    """A charger of mocks in this process, a client, and the nodes' logs."""

    def __init__(self, scene: Scene, context: Any) -> None:
        self.namespace = new_namespace()
        self.client = ChargerClient(self.namespace, context)
        self.heard: list[Log] = []
        self.reader = Node("reader", **options(context, self.namespace))
        self.reader.create_subscription(Log, "/rosout", self._hear, ROSOUT)
        self._spinner = Spinner(self.reader)
        self.composition = Composition(scene, context, self.namespace).start()
        assert self.client.wait_until_ready(DEADLINE)

    def _hear(self, message: Log) -> None:
        if message.name.startswith(f"{self.namespace}."):
            self.heard.append(message)

    def log_lines(self, name: str = "docking_node") -> list[str]:
        return [each.msg for each in list(self.heard) if each.name == f"{self.namespace}.{name}"]

    def wait_for(self, text: str) -> str:
        wait_until(lambda: any(text in line for line in self.log_lines()), f"'{text}' in {self.log_lines()}")
        return next(line for line in self.log_lines() if text in line)

    def close(self) -> None:
        self.composition.close()
        self.client.close()
        self._spinner.close()


@pytest.fixture
def charger(quick_scene: Scene, context: Any) -> Iterator[Charger]:
    charger = Charger(quick_scene, context)
    yield charger
    charger.close()


def assert_logged_in_order(lines: list[str], title: str) -> None:
    """Every transition begins where the previous one ended, between acceptance and end of the goal."""
    accepted = next(index for index, line in enumerate(lines) if f"{title}: accepted" in line)
    ended = next(index for index, line in enumerate(lines) if f"{title}: done in" in line)
    found = [re.search(rf"{title}: (\w+) → (\w+)", line) for line in lines[accepted:ended]]
    passages = [(each[1], each[2]) for each in found if each]
    assert passages[0][0] == "idle"
    assert all(before[1] == after[0] for before, after in itertools.pairwise(passages)), passages
    assert passages[-1][1] == "charging"
    assert {"approach", "contact", "measure", "energise"} <= {after for _, after in passages}


@pytest.mark.parametrize("number", [signal.SIGINT, rest(signal.SIGTERM)])
def test_a_good_docking_in_processes_is_logged_from_goal_to_end_without_a_warning(
    start: Callable[..., Process], quick_scene: Scene, context: Any, namespace: str, number: int
) -> None:
    processes = {name: start(*arguments(quick_scene, name, namespace)) for name in quick_scene.start_order()}
    alarms: list[Log] = []
    with ChargerClient(namespace, context) as client:
        client.node.create_subscription(
            Log, "/rosout", lambda entry: alarms.append(entry) if entry.name.startswith(namespace) else None, ROSOUT
        )
        assert client.wait_until_ready(DEADLINE), {name: each.err for name, each in processes.items()}
        dock_at_last(client, DockRequest(PLACE))
        assert client.undock(deadline=DEADLINE).success
        alarms.clear()
        outcome = client.dock(DockRequest(PLACE, request_id="order-1"), deadline=DEADLINE)
        for each in processes.values():  # all at once, as Ctrl-C in a terminal does, while current flows
            each.process.send_signal(number)
        for name, each in processes.items():
            assert each.end() == 0, (name, each.err)
        assert outcome.success, outcome
        assert not [entry for entry in alarms if entry.level >= WARN]
    logs = {name: each.err for name, each in processes.items()}
    assert_logged_in_order(logs["docking_node"], "dock order-1")
    assert any("contactor closed" in line for line in logs["docking_node"])
    assert any("contactor open, it was closed for" in line for line in logs["docking_node"])
    assert not [line for lines in logs.values() for line in lines if ALARM.search(line)], logs


def test_a_failed_goal_is_logged_with_code_number_and_phase_at_info(charger: Charger) -> None:
    charger.composition.node("mock_tactile_node").set_parameters([Parameter("fault", value="short")])
    outcome = charger.client.dock(DockRequest(PLACE, request_id="order-2"), deadline=DEADLINE)
    assert outcome.error_name == "SHORT_CIRCUIT", outcome
    end = charger.wait_for("dock order-2: failed, 502 SHORT_CIRCUIT: ")
    assert outcome.error_message in end
    assert re.search(r"\(after \d+\.\d s\); charge .*; contact -?0\.\d{3} A, -?\d+\.\d N", end)
    assert "energise → retract" in charger.wait_for(", 502 SHORT_CIRCUIT: ")
    assert not [each for each in charger.heard if each.level >= WARN]


def test_a_refused_goal_is_logged_with_its_reason_without_control_characters(charger: Charger) -> None:
    outcome = charger.client.dock(DockRequest(Pose(0.0, 0.0, 0.9), request_id="a\x1b[31m\nb"), deadline=DEADLINE)
    assert outcome.error_name == "UNREACHABLE", outcome
    line = charger.wait_for("refused, 301 UNREACHABLE: ")
    assert line.startswith("dock a\\u001b[31m\\u000ab: refused")
    assert not [each for each in charger.heard if each.level >= WARN]


def test_a_cancel_and_a_client_that_leaves_are_logged(charger: Charger) -> None:
    docks: Any = ActionClient(charger.client.node, Dock, "dock")
    charger.client.waitables.append(docks)
    assert docks.wait_for_server(DEADLINE)
    goal = Dock.Goal(request_id="order-3", hold=True)
    fill_pose(goal.electrodes, PLACE)
    send = charger.client.node.executor.call_soon
    handle = answer(answer(send(docks.send_goal_async, goal)))
    line = charger.wait_for("dock order-3: accepted")
    assert line.endswith("accepted, electrodes at (0.0, 0.0, 80.0) mm, roll 0.0°, charges, holds the goal")
    answer(handle.cancel_goal_async())
    charger.wait_for("dock order-3: cancelled by a client")
    charger.wait_for("dock order-3: failed, 102 CANCELED")
    goal.request_id = "order-4"
    answer(answer(send(docks.send_goal_async, goal)))
    charger.wait_for("dock order-4: accepted")
    time.sleep(2.5)  # longer than a check: nothing is logged while the client is present
    assert not any("client has gone" in line for line in charger.log_lines())
    charger.client.close()
    charger.wait_for("dock order-4: its client has gone")


def test_servo_node_ends_without_an_alarm_while_docking_node_holds_the_arm(
    start: Callable[..., Process], deltacharger: tuple[str, ...], context: Any, namespace: str, tmp_path: Path
) -> None:
    """As after Ctrl-C, which reaches all nodes at once."""
    hardware = start(*deltacharger, "simulate", "--scene", "simulated", "--directory", str(tmp_path), "--as-node")
    hardware.wait_for_line("ready", hardware.out)
    words = ("--ros-args", "-r", f"__ns:=/{namespace}", "-p", f"port:={tmp_path / 'servo'}")
    servos = start(sys.executable, "-m", NODES["servo_node"].module, *words)
    servos.wait_for_line("servos (1, 2, 3) at", servos.err)
    with ChargerClient(namespace, context) as client:
        torque = client.node.create_client(SetBool, "set_torque")
        assert torque.wait_for_service(DEADLINE)
        assert call(torque, SetBool.Request(data=True)).success
        hold = client.node.create_publisher(JointTrajectory, "joint_trajectory", 1)
        timer = client.node.create_timer(0.01, lambda: hold.publish(JointTrajectory()))
        servos.process.send_signal(signal.SIGINT)
        assert servos.end() == 0, servos.err
        timer.cancel()
    assert hardware.end(signal.SIGINT) == 0
    assert any("stopping all servos: the driver is closing" in line for line in servos.err)
    assert not [line for line in servos.err if ALARM.search(line)], servos.err
