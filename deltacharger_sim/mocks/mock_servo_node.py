# SPDX-License-Identifier: Apache-2.0
"""mock_servo_node: servo_node without servos, for tests of the layers above it.

Subscribes: joint_trajectory. Publishes: servo_state, joint_states. Serves: set_torque, reboot_servos.
Names, units and trajectory code are servo_node's; a `MockArm` replaces the hardware.
Parameter: `fault`, which may be changed at runtime: with `silence` servo_state stops.

The mock arm is for tests of nodes, not of physics: three servos on the real geometry, and one elastic plane to press on
and stick to. Its servos have a rotor, because docking measures their damping by a jump.
"""

import array
import math
import threading
import time
from collections.abc import Sequence
from typing import Any

from deltacharger.msg import ServoState
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core import machine
from deltacharger_core.frames import CHARGER_BASE, JointFrameParameters
from deltacharger_core.ros import clock, messages, node_support, parameters, qos
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.motion import JointLimits, ServoGoals, ServoWaypoint, check, check_age
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.mocks.parameters import SERVO_FAULTS, MockServoNodeParameters, fault_switch

Vector = tuple[float, float, float]
_DAMPING = 0.3  # N·m·s/rad of a servo, little, so that tests are quick
_CONTACT = 2e4  # N/m of the plane, in every direction
_STEP = 0.002  # s; the stiffest motion (contact, all three servos) decays in 9 ms, so explicit steps stay stable


class MockArm:
    """Three servos that follow their goals, and a platform that presses on the plane z = DOCK_DISTANCE.

    Attributes:
        angles: rad, measured.
        velocities: rad/s.
        currents: A, signed: torque over torque constant.
        goals: rad.
        bounds: A, largest current of each servo.
        torque_enabled: per servo; a servo without torque keeps its angle (its gear holds it).
    """

    def __init__(self) -> None:
        self._delta = ScalarDelta()
        self.angles = list(self._delta.inverse(0.0, 0.0, 0.0))
        self.goals = list(self.angles)
        self.velocities, self.currents = [0.0] * 3, [0.0] * 3
        self.bounds = [machine.CURRENT_BOUND] * 3
        self.torque_enabled = [False] * 3
        self._touched: Vector | None = None

    @property
    def position(self) -> Vector:
        """Platform position, m in charger_base."""
        return self._delta.forward(*self.angles)

    def advance(self, duration: float) -> None:
        """Advance by `duration` s."""
        steps = max(1, math.ceil(duration / _STEP))
        for _ in range(steps):
            self._step(duration / steps)

    def _step(self, dt: float) -> None:
        position = self.position
        held = self._delta.holding_torque(*position, machine.GRAVITY)
        pressed = self._delta.torque(*position, self._contact_force(position))
        before = list(self.angles)
        for index, (hold, press) in enumerate(zip(held, pressed, strict=True)):
            if not self.torque_enabled[index]:
                self.currents[index] = self.velocities[index] = 0.0
                continue
            bound = self.bounds[index] * machine.TORQUE_CONSTANT
            wanted = (
                machine.SERVO_STIFFNESS * (self.goals[index] - self.angles[index]) - _DAMPING * self.velocities[index]
            )
            torque = min(max(wanted, -bound), bound)
            self.currents[index] = torque / machine.TORQUE_CONSTANT
            self.velocities[index] += dt * (torque - hold - press) / machine.SERVO_INERTIA
            self.angles[index] += dt * self.velocities[index]
        if not math.isfinite(self.position[0]):
            self.angles, self.velocities = before, [0.0] * 3  # the rods' end stop

    def _contact_force(self, position: Vector) -> Vector:
        """Return the platform's force on the plane (N); it sticks where it touched."""
        if position[2] <= machine.DOCK_DISTANCE:
            self._touched = None
            return 0.0, 0.0, 0.0
        x, y, _ = self._touched = self._touched or position
        return (
            _CONTACT * (position[0] - x),
            _CONTACT * (position[1] - y),
            _CONTACT * (position[2] - machine.DOCK_DISTANCE),
        )


_PERIOD = 0.01  # s of a cycle


class MockServoNode(Node):
    """See the module's docstring."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("servo_node", **kwargs)
        parameters.declare_all(self, MockServoNodeParameters)
        frames = parameters.declare_all(self, JointFrameParameters)
        parameters.reject_unknown(self)
        self._frame_id = frames.named(CHARGER_BASE)
        self._joint_names = [f"{frames.joint_prefix}{name}" for name in machine.JOINTS]
        geometry = DeltaGeometry()
        self._limits = JointLimits(machine.JOINTS, geometry.joint_min, geometry.joint_max, machine.STALL_TORQUE)
        self._fault = fault_switch(self, SERVO_FAULTS)
        self._lock = threading.Lock()
        self._arm = MockArm()
        self._goals = ServoGoals(len(machine.JOINTS), machine.CURRENT_BOUND, machine.TORQUE_CONSTANT)
        self._goals.begin_at(tuple(self._arm.angles))
        self._state = self.create_publisher(ServoState, "servo_state", qos.LATEST)
        self._joints = self.create_publisher(JointState, "joint_states", qos.DEFAULT_DEPTH)
        group = ReentrantCallbackGroup()
        self.create_subscription(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.LATEST)
        self.create_service(SetBool, "set_torque", self._on_torque, callback_group=group, qos_profile=qos.SERVICE)
        self.create_service(Trigger, "reboot_servos", self._on_reboot, callback_group=group, qos_profile=qos.SERVICE)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mock servos", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Switch torque off and join the thread."""
        self._stop.set()
        self._thread.join(2.0)
        with self._lock:
            self._arm.torque_enabled = [False] * 3

    @property
    def position(self) -> tuple[float, float, float]:
        """Position of the mock's platform, m in charger_base; for tests, which may bypass the interface."""
        with self._lock:
            return self._arm.position

    @property
    def torque_enabled(self) -> bool:
        """Whether any servo has torque; for tests."""
        with self._lock:
            return any(self._arm.torque_enabled)

    def _run(self) -> None:
        due = last = time.monotonic()
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            now, stamp = time.monotonic(), self.get_clock().now().to_msg()
            with self._lock:
                self._goals.advance(now)
                self._arm.goals, self._arm.bounds = list(self._goals.angles), list(self._goals.bounds)
                self._arm.advance(min(now - last, 0.1))
                message = self._message()
                message.header.stamp = stamp  # of the arm, however long this takes
            last = now
            due = max(due + _PERIOD, now - _PERIOD)
            if self._fault() != "silence" and self.context.ok():
                self._publish(message)

    def _message(self) -> ServoState:
        message = ServoState()
        message.header.frame_id = self._frame_id
        message.name = list(machine.JOINTS)
        message.position = array.array("d", self._arm.angles)
        message.velocity = array.array("d", self._arm.velocities)
        message.current = array.array("d", self._arm.currents)
        message.voltage = array.array("f", [machine.NOMINAL_VOLTAGE] * 3)
        message.temperature = array.array("f", [35.0] * 3)
        message.hardware_error = array.array("B", [0] * 3)
        message.torque_enabled = list(self._arm.torque_enabled)
        message.valid = [True] * 3
        message.thermal_reserve = array.array("f", [math.inf] * 3)
        message.stray = array.array("B", [0] * 3)
        return message

    def _publish(self, message: ServoState) -> None:
        self._state.publish(message)
        joints = JointState(
            header=message.header, name=self._joint_names, position=message.position, velocity=message.velocity
        )
        self._joints.publish(joints)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        stamp = message.header.stamp
        unset = not (stamp.sec or stamp.nanosec)
        age = 0.0 if unset else clock.stamp_age(self.get_clock(), stamp)
        points = [
            ServoWaypoint(messages.seconds(each.time_from_start), each.positions, each.effort)
            for each in message.points
        ]
        try:
            check_age(age)
            trajectory = check(message.joint_names, points, self._limits)
        except TrajectoryRefused as refusal:
            self.get_logger().warning(str(refusal))
            return
        now = time.monotonic()
        with self._lock:
            self._goals.follow(trajectory, now, now)

    def _on_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            if request.data and not all(self._arm.torque_enabled):
                self._goals.begin_at(tuple(self._arm.angles))
            self._arm.torque_enabled = [request.data] * 3
        response.success = True
        response.message = "torque on, goal at the present position" if request.data else "torque off"
        return response

    def _on_reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            self._goals.hold(self._arm.angles)
            self._arm.torque_enabled = [False] * 3
        response.success = True
        response.message = "three servos rebooted; torque is off"
        return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(MockServoNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
