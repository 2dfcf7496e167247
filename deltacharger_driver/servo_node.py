"""servo_node: the arm's three servos on ROS.

Publishes: servo_state (reliable, depth 1, at `rate`), joint_states, /diagnostics (1 Hz and at every refusal).
Subscribes: joint_trajectory (reliable, depth 1).
Serves: set_torque, reboot_servos.
Parameters: port, baud_rate, ids, rate, zero_ticks, direction, torque_constant, current_bound, current_max, joint_min,
joint_max, reply_margin.

Safe at start: torque is off, and only set_torque switches it on, holding the present position. A missing servo, a
latched hardware error or a lost port stops all: goal := present position, torque off after 0.5 s. A port that vanishes
is opened again by itself and torque stays off. Where the port cannot be opened at start, or other servos answer than
expected, the node ends and says why.
"""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections.abc import Sequence
from typing import Any

from deltacharger.msg import ServoState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_bringup import node_support
from deltacharger_driver.errors import DriverError, TrajectoryRefused
from deltacharger_driver.mx64 import TORQUE_CONSTANT
from deltacharger_driver.servo_controller import ServoController
from deltacharger_driver.servo_diagnostics import DiagnosticEntry, bus_entry, servo_entry
from deltacharger_driver.servo_port import REPLY_MARGIN
from deltacharger_driver.servo_report import Phase, ServoReport
from deltacharger_driver.servo_snapshot import BusSettings
from deltacharger_driver.trajectory import JointLimits, Waypoint, check, check_age

JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
_FRAME = "charger_base"
_RELIABLE_LATEST = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.RELIABLE)
_DIAGNOSTICS_PERIOD = 1.0  # s
_SERVICE_TIMEOUT = 5.0  # s; a reboot takes up to 3


class ServoNode(Node):
    """See the module's docstring.

    One thread of its own owns the bus and publishes; the services wait for it and need an executor of several threads.

    Raises:
        StartupError: a parameter is wrong, the port cannot be opened, or the servos are not those expected.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("servo_node", **kwargs)
        self._controller, self._limits = self._configure()
        self._states = self.create_publisher(ServoState, "servo_state", _RELIABLE_LATEST)
        self._joints = self.create_publisher(JointState, "joint_states", 10)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._refused = 0
        self._last_refusal = ""
        self._diagnose_now = threading.Event()
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._start_error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="servo bus", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._start_error is not None:
            self._thread.join()
            self.destroy_node()
            raise node_support.StartupError(f"servo_node: {self._start_error}") from self._start_error
        # Only now, so that nobody is heard before the servos are known.
        self.create_subscription(
            JointTrajectory,
            "joint_trajectory",
            self._on_trajectory,
            _RELIABLE_LATEST,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        group = ReentrantCallbackGroup()
        self.create_service(SetBool, "set_torque", self._on_set_torque, callback_group=group)
        self.create_service(Trigger, "reboot_servos", self._on_reboot, callback_group=group)

    def close(self) -> None:
        """Goal := present position, torque off after at most 0.5 s, port closed, thread joined. Idempotent."""
        self._stop.set()
        self._thread.join()

    def _configure(self) -> tuple[ServoController, JointLimits]:
        """Declare the parameters and build the controller."""

        def declare(name: str, default: Any, text: str, low: float | None = None, high: float | None = None) -> Any:
            return node_support.declare(self, name, default, text, low, high)

        port = declare("port", "/dev/ttyUSB0", "serial port of the servos")
        baud_rate = declare("baud_rate", 1_000_000, "speed of the servos' bus (bit/s)", 9600, 4_000_000)
        ids = declare("ids", [1, 2, 3], "servo ids of limbs 0, 1, 2", 0, 252)
        rate = declare("rate", 100.0, "bus cycles per second (Hz)", 20.0, 200.0)
        zero = declare("zero_ticks", [2048, 2048, 2048], "encoder count at arm angle 0, per limb", -1048575, 1048575)
        sign = declare("direction", [1, 1, 1], "1 or -1 per limb: whether the count rises with the angle", -1, 1)
        constant = declare("torque_constant", TORQUE_CONSTANT, "torque per current of a servo (N·m/A)", 0.1, 10.0)
        bound = declare("current_bound", 0.83, "current bound where a trajectory sets none (A)", 0.0, 4.1)
        largest = declare("current_max", 3.0, "largest current bound a trajectory may set (A)", 0.0, 4.1)
        low = declare("joint_min", math.radians(-65.0), "smallest arm angle (rad)", -math.pi, math.pi)
        high = declare("joint_max", math.radians(70.0), "largest arm angle (rad)", -math.pi, math.pi)
        margin = declare("reply_margin", REPLY_MARGIN, "time until a reply is missing (s)", 0.002, 0.1)
        node_support.reject_unknown(self)
        problem = ""
        if len(ids) != len(JOINTS):
            problem = f"parameter 'ids' has {len(ids)} values; give {len(JOINTS)}"
        elif low >= high:
            problem = f"parameter 'joint_min' ({low}) is not below 'joint_max' ({high})"
        elif bound > largest:
            problem = f"parameter 'current_bound' ({bound}) is above 'current_max' ({largest})"
        if problem:
            raise node_support.StartupError(f"servo_node: {problem}")
        try:
            settings = BusSettings(port, baud_rate, tuple(ids), tuple(zero), tuple(sign), reply_margin=margin)
        except DriverError as error:
            raise node_support.StartupError(f"servo_node: {error}") from error
        self._period = 1.0 / rate
        self._torque_constant = constant
        return (
            ServoController(settings, bound, constant, self._log),
            JointLimits(JOINTS, low, high, largest * constant * (1.0 + 1e-9)),
        )

    def _run(self) -> None:
        """Own the bus: cycle until told to stop, then make the arm safe."""
        controller = self._controller
        try:
            controller.open()
        except BaseException as error:
            self._start_error = error
            controller.close()
            return
        finally:
            self._ready.set()
        try:
            self._cycle_until_safe()
        except BaseException as error:
            # An error of ours must still leave the arm without torque; close() below sees to it.
            self.get_logger().fatal(f"servo bus thread ended: {error!r}; torque goes off")
            raise
        finally:
            controller.close()

    def _cycle_until_safe(self) -> None:
        """Cycle at the rate; after `close` was called, until torque is off."""
        controller = self._controller
        state, joints = _empty_messages()
        due = diagnose_at = time.monotonic()
        while True:
            if self._stop.is_set():
                controller.stop("the driver is closing")
                if controller.phase in (Phase.OFF, Phase.DISCONNECTED):
                    return
            report = controller.cycle()
            self._publish(report, state, joints)
            now = time.monotonic()
            if now >= diagnose_at or self._diagnose_now.is_set():
                diagnose_at = now + _DIAGNOSTICS_PERIOD
                self._publish_diagnostics(report)
            due += self._period
            if due < now:
                due = now  # late: go on from here rather than hurry through what was missed
            time.sleep(due - now)

    def _publish(self, report: ServoReport, state: ServoState, joints: JointState) -> None:
        if not self.context.ok():
            return
        nanoseconds = self.get_clock().now().nanoseconds - int((time.monotonic() - report.time) * 1e9)
        stamp = state.header.stamp
        stamp.sec, stamp.nanosec = divmod(max(nanoseconds, 0), 1_000_000_000)
        state.position = array("d", report.angle)
        state.velocity = array("d", report.velocity)
        state.current = array("d", report.current)
        state.voltage = array("f", report.voltage)
        state.temperature = array("f", report.temperature)
        state.hardware_error = array("B", report.hardware_error)
        state.torque_enabled = list(report.torque_enabled)
        state.valid = list(report.valid)
        state.thermal_reserve = array("f", report.thermal_reserve)
        self._states.publish(state)
        if not math.isnan(sum(report.angle)):
            joints.header.stamp = stamp
            joints.position = state.position
            joints.velocity = state.velocity
            joints.effort = array("d", [current * self._torque_constant for current in report.current])
            self._joints.publish(joints)

    def _publish_diagnostics(self, report: ServoReport) -> None:
        self._diagnose_now.clear()
        if not self.context.ok():
            return
        refused, self._refused = self._refused, 0
        ids = self._controller.bus.settings.ids
        entries = [bus_entry(report, self._controller, refused, self._last_refusal)]
        entries += [servo_entry(report, index, ids[index], joint) for index, joint in enumerate(JOINTS)]
        message = DiagnosticArray(status=[self._diagnostic(entry) for entry in entries])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)

    def _diagnostic(self, entry: DiagnosticEntry) -> DiagnosticStatus:
        return DiagnosticStatus(
            level=bytes((entry.level,)),
            name=f"{self.get_fully_qualified_name()}: {entry.name}",
            message=entry.message,
            hardware_id=self._controller.bus.settings.port,
            values=[KeyValue(key=key, value=value) for key, value in entry.values.items()],
        )

    def _on_trajectory(self, message: JointTrajectory) -> None:
        try:
            stamp = Time.from_msg(message.header.stamp, clock_type=self.get_clock().clock_type)
            if stamp.nanoseconds:
                check_age((self.get_clock().now() - stamp).nanoseconds * 1e-9)
            points = [_waypoint(point) for point in message.points]
            self._controller.submit(check(message.joint_names, points, self._limits))
        except TrajectoryRefused as error:
            self._last_refusal = str(error)
            self._refused += 1
            self._diagnose_now.set()
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)

    def _on_set_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        return self._ask("torque_on" if request.data else "torque_off", response)

    def _on_reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._ask("reboot", response)

    def _ask(self, action: str, response: Any) -> Any:
        """Have the bus thread carry `action` out, and fill in how it went."""
        if self._stop.is_set():
            response.success, response.message = False, "the driver is closing"
            return response
        asked = self._controller.request(action)
        if asked.wait(_SERVICE_TIMEOUT):
            response.success, response.message = asked.success, asked.message
        else:
            response.success, response.message = False, "the servos' thread did not answer in time"
        return response

    def _log(self, severity: str, sentence: str) -> None:
        logger = self.get_logger()
        if severity == "error":
            logger.error(sentence)
        elif severity == "warning":
            logger.warning(sentence)
        else:
            logger.info(sentence)


def _waypoint(point: JointTrajectoryPoint) -> Waypoint:
    time_from_start = point.time_from_start.sec + point.time_from_start.nanosec * 1e-9
    return Waypoint(time_from_start, point.positions, point.effort)


def _empty_messages() -> tuple[ServoState, JointState]:
    """Return messages with what never changes filled in."""
    state, joints = ServoState(name=list(JOINTS)), JointState(name=list(JOINTS))
    state.header.frame_id = joints.header.frame_id = _FRAME
    return state, joints


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(ServoNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
