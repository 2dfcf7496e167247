# SPDX-License-Identifier: Apache-2.0
"""servo_node over a real pseudo-terminal and real rclpy, with emulated servos on a bench."""

from __future__ import annotations

import math
import signal
import sys
import threading
import time
from array import array

import pytest
from builtin_interfaces.msg import Duration
from deltacharger.msg import ServoState
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core.machine import JOINTS, TORQUE_CONSTANT
from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.emulators.bench_arm import BenchArm
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servos.mx64 import CURRENT_UNIT, TICK
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_ros.executor import Spinner
from deltacharger_ros.node_support import StartupError

from ..nodes import call, options
from ..waiting import DEADLINE, wait_until

pytestmark = pytest.mark.ros

START = (-0.7, -0.5, 0.2)  # of `arm`
VOLTAGE, OVERLOAD = 1 << 0, 1 << 5  # the former does not switch the torque off


class Client(Node):
    """A client that uses servo_node like docking_node."""

    def __init__(self, context):
        super().__init__("client", **options(context))
        reliable = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
        self.states, self.joints, self.diagnostics = [], [], []
        self.create_subscription(ServoState, "servo_state", self.states.append, reliable)
        self.create_subscription(JointState, "joint_states", self.joints.append, 10)
        self.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics.append, 10)
        self.trajectories = self.create_publisher(JointTrajectory, "joint_trajectory", reliable)
        self.torque = self.create_client(SetBool, "set_torque")
        self.reboot = self.create_client(Trigger, "reboot_servos")

    def call(self, client, request):
        assert client.wait_for_service(DEADLINE)
        return call(client, request)

    def set_torque(self, on):
        return self.call(self.torque, SetBool.Request(data=on))

    def fresh(self):
        """Return a state sent after this call."""
        count = len(self.states)
        wait_until(lambda: len(self.states) > count + 1)
        return self.states[-1]

    def send(self, *points, names=JOINTS, stamp=None, efforts=()):
        message = JointTrajectory(joint_names=list(names))
        if stamp is not None:
            message.header.stamp = stamp
        for seconds, angles in points:
            point = JointTrajectoryPoint(positions=array("d", angles), effort=array("d", efforts))
            point.time_from_start.sec = int(seconds)
            point.time_from_start.nanosec = int(seconds % 1 * 1e9)
            message.points.append(point)
        self.trajectories.publish(message)

    def reports(self, text):
        """Return whether a diagnostic contains `text`."""
        return any(text in status.message for message in self.diagnostics for status in message.status)


@pytest.fixture
def client(context, terminal, spin):
    spin(ServoNode(**options(context, port=terminal.path)))
    client = spin(Client(context))
    wait_until(lambda: client.states and client.trajectories.get_subscription_count())
    return client


def test_the_state_at_start(client, arm):
    state = client.fresh()
    assert tuple(state.name) == JOINTS
    assert state.header.frame_id == "charger_base"
    assert list(state.position) == pytest.approx(START, abs=TICK)
    assert list(state.voltage) == pytest.approx([12.0] * 3)
    assert list(state.temperature) == [30.0] * 3
    assert list(state.hardware_error) == [0, 0, 0]
    assert list(state.torque_enabled) == [False] * 3
    assert list(state.valid) == [True] * 3
    assert list(state.thermal_reserve) == [math.inf] * 3
    age = client.get_clock().now().nanoseconds - (state.header.stamp.sec * 10**9 + state.header.stamp.nanosec)
    assert 0 <= age < 0.2e9
    wait_until(lambda: client.joints)
    assert list(client.joints[-1].position) == pytest.approx(START, abs=TICK)
    wait_until(lambda: client.diagnostics)
    assert {status.level for status in client.diagnostics[-1].status} == {DiagnosticStatus.OK}
    assert arm.torque_enabled() == [False] * 3


def test_the_rate(client):
    def seconds(first, last):
        span = last.header.stamp.sec - first.header.stamp.sec
        return span + (last.header.stamp.nanosec - first.header.stamp.nanosec) * 1e-9

    def kept():  # a busy machine may lose some cycles; one complete second must occur
        states = client.states
        states.clear()
        wait_until(lambda: len(states) > 1 and seconds(states[0], states[-1]) >= 1.0)
        rate = (len(states) - 1) / seconds(states[0], states[-1])
        assert rate <= 105
        return rate >= 60

    wait_until(kept)


def test_torque_trajectory_torque_off(client, arm):
    answer = client.set_torque(True)
    assert answer.success
    assert arm.torque_enabled() == [True] * 3
    goal = [angle + 0.1 for angle in START]
    client.send((0.2, goal), stamp=client.get_clock().now().to_msg())
    wait_until(lambda: list(client.states[-1].position) == pytest.approx(goal, abs=2 * TICK))
    assert list(client.states[-1].torque_enabled) == [True] * 3
    assert client.set_torque(False).success
    assert arm.torque_enabled() == [False] * 3
    assert list(client.fresh().torque_enabled) == [False] * 3


def test_joints_in_another_order_and_effort_as_bound(client, arm):
    client.set_torque(True)
    order = (JOINTS[2], JOINTS[0], JOINTS[1])
    client.send((0.0, (0.3, -0.6, -0.4)), names=order, efforts=(3.0, 1.0, 2.0))
    wait_until(lambda: arm.commands[0][1] == pytest.approx(-0.6, abs=TICK))
    assert [command[1] for command in arm.commands] == pytest.approx([-0.6, -0.4, 0.3], abs=TICK)
    bounds = [effort / TORQUE_CONSTANT for effort in (1.0, 2.0, 3.0)]
    assert [command[2] for command in arm.commands] == pytest.approx(bounds, abs=CURRENT_UNIT)
    client.send(names=())
    wait_until(lambda: arm.commands[2][2] == pytest.approx(0.83, abs=CURRENT_UNIT))
    assert [command[1] for command in arm.commands] == pytest.approx([-0.6, -0.4, 0.3], abs=TICK)


@pytest.mark.parametrize(
    ("names", "efforts", "reason"),
    [
        (("limb_0_arm_joint", "limb_1_arm_joint", "elbow"), (), "unknown joint 'elbow'"),
        (("limb_0_arm_joint", "limb_1_arm_joint", "\x1b[2J"), (), r"unknown joint '\x1b[2J'"),
        (JOINTS, (9.0, 1.0, 1.0), "effort"),
    ],
)
def test_a_refused_trajectory_moves_nothing_and_is_reported(client, arm, names, efforts, reason):
    client.set_torque(True)
    before = list(arm.commands)
    client.send((0.0, (0.0, 0.0, 0.0)), names=names, efforts=efforts)
    wait_until(lambda: client.reports(reason))
    assert list(arm.commands) == before


def stamped(client, seconds_ago=0.0):
    stamp = client.get_clock().now().to_msg()
    stamp.sec, stamp.nanosec = divmod(stamp.sec * 10**9 + stamp.nanosec - int(seconds_ago * 1e9), 10**9)
    return stamp


def test_a_line_may_last_longer_than_its_stamp_is_valid(client, arm):
    client.set_torque(True)
    goal = [angle + 0.4 for angle in START]
    stamp, begin = stamped(client), time.monotonic()

    def fed():
        now = time.monotonic() - begin
        ahead = [now + step * 0.02 for step in range(1, 7)]
        client.send(*((at, [a + min(at, 1.0) * 0.4 for a in START]) for at in ahead), stamp=stamp)
        time.sleep(0.02)  # the feeder's tick, not a wait for a condition
        return now > 1.1

    wait_until(fed)
    wait_until(lambda: [command[1] for command in arm.commands] == pytest.approx(goal, abs=TICK))
    assert not any(status.message for m in client.diagnostics for status in m.status if "old" in status.message)
    client.send((0.0, START), stamp=stamped(client, 0.7))  # another stamp must be fresh
    wait_until(lambda: client.reports("old"))
    assert [command[1] for command in arm.commands] == pytest.approx(goal, abs=TICK)


def test_frequent_refusals_are_reported_at_a_bounded_rate(client):
    client.diagnostics.clear()
    begin = time.monotonic()

    def fed():
        client.send((0.1, START))  # torque is off
        time.sleep(0.02)
        return time.monotonic() - begin > 1.0

    wait_until(fed)
    wait_until(lambda: client.reports("set_torque"))
    assert len(client.diagnostics) <= (time.monotonic() - begin) / 0.2 + 2


def test_diagnostics_report_rate_and_late_cycles(client):
    client.diagnostics.clear()
    bus = wait_until(lambda: [s for m in client.diagnostics[1:] for s in m.status if s.name.endswith("servo bus")])[0]
    values = {value.key: value.value for value in bus.values}
    assert 0.0 < float(values["rate"].removesuffix(" Hz")) <= 105.0
    assert int(values["late_cycles"]) >= 0
    assert {"timeouts", "corrupt", "late", "retries", "watchdog_trips", "reconnections"} <= set(values)


class LiveArm(BenchArm):
    """An arm that records whether current could flow when its torque went off."""

    def __init__(self, plant):
        super().__init__(START)
        self.plant = plant
        self.live_at_torque_off = []

    def command_servo(self, index, torque_enabled, reference, current_limit, gain=1.0):
        command = self.commands[index]
        if command is not None and command[0] and not torque_enabled:
            self.live_at_torque_off.append(self.plant.read_power()[3])
        super().command_servo(index, torque_enabled, reference, current_limit, gain)


class Charging:
    """Both drivers on emulated hardware, and a client that charges without end."""

    def __init__(self, context, folder):
        self.plant = BenchPlant()
        self.arm = LiveArm(self.plant)
        self.emulator = ServoBusEmulator(self.arm)
        self.servo = PseudoTerminal(self.emulator, folder / "live_servo").start()
        self.board = PseudoTerminal(BoardEmulator(self.plant), folder / "live_board").start()
        nodes = (
            TactileNode(**options(context, port=self.board.path)),
            ServoNode(**options(context, port=self.servo.path)),
            Client(context),
        )
        self.spinners = [Spinner(node) for node in nodes]
        self.client = self.spinners[2].node
        self.contactor = self.client.create_client(SetContactor, "set_contactor")
        self.probe = self.client.create_client(Probe, "probe")
        self.tare = self.client.create_client(Trigger, "tare")
        self.over = threading.Event()
        self.thread = threading.Thread(target=self.renew)

    def begin(self):
        """Torque on, contact, probe, close."""
        assert self.client.set_torque(True).success
        assert self.client.call(self.tare, Trigger.Request()).success
        self.plant.press(20.0)
        assert self.client.call(self.probe, Probe.Request()).success
        self.thread.start()
        wait_until(lambda: self.plant.read_power()[3])

    def renew(self):
        lease = Duration(nanosec=250_000_000)
        while not self.over.wait(0.05):
            self.contactor.call_async(SetContactor.Request(close=True, holder="dock", lease=lease))

    def close(self):
        self.over.set()
        if self.thread.ident is not None:
            self.thread.join()
        for spinner in reversed(self.spinners):
            spinner.close()
        self.servo.stop()
        self.board.stop()


@pytest.fixture
def charging(context, tmp_path):
    charging = Charging(context, tmp_path)
    yield charging
    charging.close()


@pytest.mark.parametrize(
    "end",
    [
        lambda charging: charging.client.set_torque(False),
        lambda charging: charging.emulator.raise_hardware_error(1, VOLTAGE),
        lambda charging: charging.spinners.pop(1).close(),
    ],
    ids=["set_torque false", "a latched error", "the node is closed"],
)
def test_the_contactor_opens_before_the_torque_goes(charging, end):
    charging.begin()
    end(charging)
    wait_until(lambda: len(charging.arm.live_at_torque_off) == 3)
    assert charging.arm.live_at_torque_off == [False] * 3
    assert not charging.plant.read_power()[3]


def test_the_contactor_opens_when_the_servos_cable_is_pulled(charging):
    charging.begin()
    begin = time.monotonic()
    charging.servo.stop()
    wait_until(lambda: not charging.plant.read_power()[3])
    assert time.monotonic() - begin < 2.0  # the client would have continued


def test_a_missing_servo_stops_all(client, arm, emulator):
    client.set_torque(True)
    emulator.faults.missing = {2}

    def only_that_one():
        state = client.states[-1]
        return list(state.valid) == [True, False, True] and math.isnan(state.position[1]) and state

    state = wait_until(only_that_one)
    assert math.isnan(state.temperature[1])
    assert state.torque_enabled[1]
    wait_until(lambda: arm.torque_enabled()[0] is False)
    assert list(client.fresh().torque_enabled)[::2] == [False, False]
    wait_until(lambda: client.reports("servo 2 does not answer"))
    answer = client.set_torque(True)
    assert not answer.success
    assert "servo 2" in answer.message


def test_a_latched_error_needs_a_reboot(client, arm, emulator):
    client.set_torque(True)
    emulator.raise_hardware_error(1, OVERLOAD)
    wait_until(lambda: client.states[-1].hardware_error[0] == ServoState.ERROR_OVERLOAD)
    wait_until(lambda: arm.torque_enabled() == [False] * 3)
    assert not client.set_torque(True).success
    answer = client.call(client.reboot, Trigger.Request())
    assert answer.success, answer.message
    assert list(client.fresh().hardware_error) == [0, 0, 0]
    assert arm.torque_enabled() == [False] * 3
    assert client.set_torque(True).success


def test_two_chargers_by_namespace(context, terminal):
    node = ServoNode(**options(context, "/second", port=terminal.path))
    topics = dict(node.get_topic_names_and_types())
    node.close()
    node.destroy_node()
    assert {"/second/servo_state", "/second/joint_states", "/second/joint_trajectory", "/diagnostics"} <= set(topics)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"port": "/nowhere"}, "no such port"),
        ({"ids": [1, 2]}, "ids"),
        ({"ids": [1, 1, 2]}, "no id twice"),
        ({"ids": [1, 2, 4]}, "servo 4 does not answer at any speed"),
        ({"direction": [1, 0, 1]}, "direction"),
        ({"rate": 1000.0}, "rate"),
        ({"joint_min": 1.0, "joint_max": 0.5}, "joint_min"),
        ({"current_bound": 3.5}, "current_bound"),
        ({"baud": 57600}, "did you mean 'baud_rate'"),
        ({"baud_rate": 57600}, "answers at 1000000"),
    ],
)
def test_a_wrong_configuration_stops_the_start_with_a_reason(context, terminal, emulator, parameters, reason):
    emulator.line_speed = terminal.speed
    with pytest.raises(StartupError, match=reason):
        ServoNode(**options(context, **{"port": terminal.path, **parameters}))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_executable_ends_cleanly_on_a_signal(context, terminal, arm, start, spin, number):
    client = spin(Client(context))
    module = "deltacharger_driver.servos.servo_node"
    process = start(sys.executable, "-m", module, "--ros-args", "-p", f"port:={terminal.path}")
    assert client.set_torque(True).success
    assert process.end(number) == 0
    assert arm.torque_enabled() == [False] * 3
