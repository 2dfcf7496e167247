# SPDX-License-Identifier: Apache-2.0
"""servo_node with real ROS clients and emulated servos on a real pseudo-terminal.

Its rules are tested in virtual time: test_servo_controller*.py and test_trajectory_inbox.py.
"""

import contextlib
import math
import signal
import sys
from array import array
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, ServoState
from deltacharger.srv import SetContactor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS
from deltacharger_core.ros.node_support import StartupError
from deltacharger_driver.ports import PseudoTerminal
from deltacharger_driver.servos import motion, registers, servo_node
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator

from ..chargers import Spin, new_namespace, patience
from ..nodes import call, options
from ..plants import BenchArm
from ..quick import PATIENT_MARGIN
from ..waiting import DEADLINE, host, wait_until
from .servo_rig import START

pytestmark = pytest.mark.ros

RELIABLE = QoSProfile(depth=1)
HIGHER = [angle + 0.1 for angle in START]


class Client(Node):
    """A client that uses servo_node like docking_node."""

    def __init__(self, context: Any, namespace: str, name: str = "client", secret: str = "") -> None:
        super().__init__(name, **options(context, namespace))
        self.secret = secret
        self.states: list[ServoState] = []
        self.statuses: list[DiagnosticStatus] = []
        self.create_subscription(ServoState, "servo_state", self.states.append, RELIABLE)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.trajectories = self.create_publisher(JointTrajectory, "joint_trajectory", RELIABLE)
        self.torque = self.create_client(SetBool, "set_torque")
        self.reboot = self.create_client(Trigger, "reboot_servos")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.statuses += [each for each in message.status if self.get_namespace() in f"/{each.name}"]

    def set_torque(self, on: bool) -> Any:
        assert self.torque.wait_for_service(DEADLINE)
        return call(self.torque, SetBool.Request(data=on))

    def send(self, *points: tuple[float, Any]) -> None:
        message = JointTrajectory(joint_names=list(JOINTS))
        message.header.frame_id = self.secret
        message.header.stamp = self.get_clock().now().to_msg()
        for seconds, angles in points:
            point = JointTrajectoryPoint(positions=array("d", angles))
            point.time_from_start.sec, point.time_from_start.nanosec = int(seconds), int(seconds % 1 * 1e9)
            message.points.append(point)
        self.trajectories.publish(message)

    def reports(self, text: str) -> bool:
        """Return whether a diagnostic contains a text."""
        return any(text in status.message for status in list(self.statuses))

    def reports_health(self) -> bool:
        """Return whether the first diagnostic of the bus shows no fault, and its rate and counts."""
        bus = wait_until(lambda: [each for each in list(self.statuses) if each.name.endswith("servo bus")])[0]
        values = {value.key: value.value for value in bus.values}
        counted = {"late_cycles", "timeouts", "corrupt", "late", "retries", "watchdog_trips", "reconnections"}
        rate = float(values["rate"].removesuffix(" Hz"))
        return bus.level == DiagnosticStatus.OK and 60.0 / host(1.0) < rate <= 105.0 and counted <= set(values)


class PowerStage(Node):
    """Publishes charger_power 20 times a second; set_contactor opens, and records the arm's torque then."""

    def __init__(self, context: Any, namespace: str, arm: BenchArm) -> None:
        super().__init__("power_stage", **options(context, namespace))
        self.closed, self.arm = False, arm
        self.torque_when_opened: list[bool] = []
        self.powers = self.create_publisher(ChargerPower, "charger_power", RELIABLE)
        self.create_timer(0.05, self._publish)
        self.create_service(SetContactor, "set_contactor", self._on_contactor)

    def _publish(self) -> None:
        power = ChargerPower(contactor_closed=self.closed, probe_age=math.inf)
        power.header.stamp = self.get_clock().now().to_msg()
        self.powers.publish(power)

    def _on_contactor(self, request: Any, response: Any) -> Any:
        self.torque_when_opened, self.closed, response.success = self.arm.torque_enabled(), request.close, True
        return response


class Servos:
    """servo_node and a client in their own namespace; `serve` runs further nodes there."""

    def __init__(self, context: Any, path: str, arm: BenchArm, spin: Spin) -> None:
        self.arm, self.context, self.serve = arm, context, spin
        self.namespace = new_namespace()
        self.node = spin(
            servo_node.ServoNode(**options(context, self.namespace, port=path, reply_margin=PATIENT_MARGIN))
        )
        self.client: Client = spin(Client(context, self.namespace))
        wait_until(lambda: self.client.states and self.client.trajectories.get_subscription_count())

    def goals(self) -> list[float]:
        return [command[1] for command in self.arm.commands]

    def are_at(self, angles: Any) -> None:
        wait_until(lambda: self.goals() == pytest.approx(list(angles), abs=registers.TICK), f"goals {angles}")


@contextlib.contextmanager
def emulated(arm: BenchArm) -> Iterator[str]:
    """Serve an arm's servos, and yield their port."""
    emulator = ServoBusEmulator(arm)
    with PseudoTerminal(emulator) as terminal:
        emulator.line_speed = terminal.speed
        yield terminal.path


@pytest.mark.witness
@pytest.mark.version
def test_while_the_contactor_is_closed_the_arm_stands_still_and_keeps_its_torque(context: Any, spin: Spin) -> None:
    """A running line becomes a hold; the diagnostics report a refusal."""
    arm = BenchArm(START)
    with patience(), emulated(arm) as path:
        servos = Servos(context, path, arm, spin)
        stage = spin(PowerStage(context, servos.namespace, arm))
        stranger = spin(Client(context, servos.namespace, "stranger"))
        wait_until(lambda: stage.powers.get_subscription_count() and stranger.trajectories.get_subscription_count())

        def becomes(state: motion.ContactorState) -> None:
            wait_until(lambda: servos.node._contactor_state is state, state.name)

        assert servos.client.reports_health()
        assert call(servos.client.reboot, Trigger.Request()).success
        assert servos.client.set_torque(True).success
        becomes(motion.ContactorState.OPEN)
        servos.client.send((180.0, [angle + 0.4 for angle in START]))  # longer than any wait
        wait_until(lambda: servos.goals()[0] > START[0] + registers.TICK, "a running line")
        stage.closed = True
        becomes(motion.ContactorState.CLOSED)
        wait_until(lambda: not servos.node._controller._goals.are_moving, "the hold")
        held = servos.goals()
        stranger.send((0.0, HIGHER))
        wait_until(lambda: stranger.reports(motion.ContactorState.CLOSED.value), "a refusal")
        assert servos.goals() == held
        stage.closed = False
        becomes(motion.ContactorState.OPEN)
        assert not servos.node._controller._goals.are_moving  # nor does it continue
        stranger.send((0.0, START))
        servos.are_at(START)
        stage.closed = True
        becomes(motion.ContactorState.CLOSED)
        assert servos.client.set_torque(False).success
        assert stage.torque_when_opened == [True] * 3  # it opens before the torque goes
        assert not stage.closed
        assert arm.torque_enabled() == [False] * 3


def test_a_wrong_configuration_stops_the_start_with_a_reason(context: Any, terminal: PseudoTerminal) -> None:
    with pytest.raises(StartupError, match="no id twice"):
        servo_node.ServoNode(**options(context, port=terminal.path, ids=[1, 1, 2]))


@pytest.mark.witness
def test_the_executable_ends_cleanly_on_a_signal(
    context: Any, terminal: PseudoTerminal, arm: BenchArm, start: Any, spin: Spin
) -> None:
    client = spin(Client(context, namespace := new_namespace()))
    module = "deltacharger_driver.servos.servo_node"
    words = ("-r", f"__ns:=/{namespace}", "-p", f"port:={terminal.path}", "-p", f"reply_margin:={PATIENT_MARGIN}")
    process = start(sys.executable, "-m", module, "--ros-args", *words)
    process.wait_until(client.torque.service_is_ready, "set_torque")
    assert client.set_torque(True).success
    assert process.end(signal.SIGINT) == 0
    assert arm.torque_enabled() == [False] * 3
    wait_until(lambda: list(client.states[-1].torque_enabled) == [False] * 3, "the report of it")
