# SPDX-License-Identifier: Apache-2.0
"""mock_servo_node: servo_node without servos, for tests of the layers above it.

Subscribes: joint_trajectory. Publishes: servo_state, joint_states, /diagnostics. Serves: set_torque, reboot_servos.
Names, units and trajectory code are servo_node's; a `MockArm` replaces the hardware.
Parameters: rate, the plane of the target, and `fault`, which may be changed at runtime:

silence         servo_state stops
nan_current     the currents are not measured
missing         servo 2 does not answer: valid false, its numbers NaN
hardware_error  servo 2 reports overload and loses its torque until reboot_servos
jam             nothing moves, at any current
"""

from __future__ import annotations

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

from deltacharger_core.frames import CHARGER_BASE, JointFrameParameters
from deltacharger_core.machine import JOINTS, NOMINAL_VOLTAGE, STALL_TORQUE, TORQUE_CONSTANT
from deltacharger_driver.errors import TrajectoryRefused
from deltacharger_driver.servos.motion import JointLimits, ServoGoals, ServoWaypoint, check, check_age
from deltacharger_kinematics import DeltaGeometry
from deltacharger_ros import node_support, qos
from deltacharger_ros.clock import stamp_age
from deltacharger_ros.diagnostics import WARN, Diagnostics
from deltacharger_ros.messages import seconds
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.qos import SERVICE
from deltacharger_scenes.mocks.arm import MockArm
from deltacharger_scenes.mocks.fault_switch import FaultSwitch
from deltacharger_scenes.mocks.parameters import SERVO_FAULTS, MockServoNodeParameters

_BROKEN = 1  # index of the servo affected by the faults


class MockServoNode(Node):
    """See the module's docstring."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("servo_node", **kwargs)
        given, frames = declare_all(self, MockServoNodeParameters), declare_all(self, JointFrameParameters)
        reject_unknown(self)
        self._rate = given.rate
        self._frame_id = frames.named(CHARGER_BASE)
        self._joint_names = [f"{frames.joint_prefix}{name}" for name in JOINTS]
        geometry = DeltaGeometry()
        self._limits = JointLimits(JOINTS, geometry.joint_min, geometry.joint_max, STALL_TORQUE)
        self._fault = FaultSwitch(self, SERVO_FAULTS, given.fault_delay)
        self._lock = threading.Lock()
        self._arm = MockArm(given.target_z)
        self._goals = ServoGoals(len(JOINTS), given.current_bound, TORQUE_CONSTANT)
        self._goals.begin_at(tuple(self._arm.angles))
        self._error = [0, 0, 0]
        self._state = self.create_publisher(ServoState, "servo_state", qos.LATEST)
        self._joints = self.create_publisher(JointState, "joint_states", qos.DEFAULT_DEPTH)
        self._diagnostics = Diagnostics(self)
        group = ReentrantCallbackGroup()
        self.create_subscription(JointTrajectory, "joint_trajectory", self._on_trajectory, qos.LATEST)
        self.create_service(SetBool, "set_torque", self._on_torque, callback_group=group, qos_profile=SERVICE)
        self.create_service(Trigger, "reboot_servos", self._on_reboot, callback_group=group, qos_profile=SERVICE)
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

    def reboot(self) -> None:
        """Clear hardware errors and switch torque off, as reboot_servos does."""
        with self._lock:
            self._goals.hold(self._arm.angles)
            self._error = [0, 0, 0]
            self._arm.torque_enabled = [False] * 3

    def _run(self) -> None:
        period = 1.0 / self._rate
        due = last = time.monotonic()
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            now, stamp = time.monotonic(), self.get_clock().now().to_msg()
            with self._lock:
                self._apply_fault()
                self._goals.advance(now)
                self._arm.goals, self._arm.bounds = list(self._goals.angles), list(self._goals.bounds)
                self._arm.advance(min(now - last, 0.1))
                message = self._message()
                message.header.stamp = stamp  # of the arm, however long this takes
            last = now
            due = max(due + period, now - period)
            if self._fault.active() != "silence" and self.context.ok():
                self._publish(message)

    def _apply_fault(self) -> None:
        fault = self._fault.active()
        self._arm.jammed = fault == "jam"
        if fault == "hardware_error" and self._fault.first_time():
            self._error[_BROKEN] = ServoState.ERROR_OVERLOAD
            self._arm.torque_enabled[_BROKEN] = False

    def _message(self) -> ServoState:
        message = ServoState()
        message.header.frame_id = self._frame_id
        message.name = list(JOINTS)
        current = list(self._arm.currents)
        valid = [True] * 3
        position, velocity = list(self._arm.angles), list(self._arm.velocities)
        fault = self._fault.active()
        if fault == "nan_current":
            current = [math.nan] * 3
        elif fault == "missing":
            valid[_BROKEN] = False
            for values in (position, velocity, current):
                values[_BROKEN] = math.nan
        message.position = array.array("d", position)
        message.velocity = array.array("d", velocity)
        message.current = array.array("d", current)
        message.voltage = array.array("f", [NOMINAL_VOLTAGE] * 3)
        message.temperature = array.array("f", [35.0] * 3)
        message.hardware_error = array.array("B", self._error)
        message.torque_enabled = list(self._arm.torque_enabled)
        message.valid = valid
        message.thermal_reserve = array.array("f", [math.inf] * 3)
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
        age = 0.0 if unset else stamp_age(self.get_clock(), stamp)
        points = [ServoWaypoint(seconds(each.time_from_start), each.positions, each.effort) for each in message.points]
        try:
            check_age(age)
            trajectory = check(message.joint_names, points, self._limits)
        except TrajectoryRefused as refusal:
            self.get_logger().warning(str(refusal))
            self._diagnostics.report(WARN, str(refusal), {}, "joint_trajectory")
            return
        now = time.monotonic()
        with self._lock:
            self._goals.follow(trajectory, now, now)

    def _on_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        with self._lock:
            if request.data and any(self._error):
                response.message = "servo 2 reports overload: clear the cause, then call reboot_servos"
                return response
            if request.data and not all(self._arm.torque_enabled):
                self._goals.begin_at(tuple(self._arm.angles))
            self._arm.torque_enabled = [request.data] * 3
        response.success = True
        response.message = "torque on, goal at the present position" if request.data else "torque off"
        return response

    def _on_reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.reboot()
        response.success = True
        response.message = "three servos rebooted; torque is off"
        return response


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(MockServoNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
