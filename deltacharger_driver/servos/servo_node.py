# SPDX-License-Identifier: Apache-2.0
"""servo_node: the arm's three servos on ROS.

Publishes: servo_state (reliable, depth 1, at `rate`), joint_states, /diagnostics (1 Hz).
Subscribes: joint_trajectory and charger_power (reliable, depth 64; the newest accepted trajectory is followed).
Serves: set_torque, reboot_servos. Calls: set_contactor, if it exists.
Parameters: port, baud_rate, ids, rate, zero_ticks, direction, current_max, joint_min, joint_max,
reply_margin, frame_prefix, joint_prefix; servos_file or torque_constant, position_p_gain, position_d_gain.

Of torque_constant, current_max and the gains, what nobody sets is as the servos' type has it.

Safe at start: torque is off; only set_torque switches it on, holding the present position. A missing servo, a latched
hardware error or a lost port stops all servos: goal := present position, contactor open, torque off after 0.5 s. On
request and at the node's end, torque goes off once the contactor is reported open, after 0.3 s at the latest. A
vanished port is reopened and torque stays off. If the port cannot be opened at start, or unexpected servos answer, the
node ends with an error. With the port `board` the servos are connected to the board with the pads: tactile_node passes
their bytes through, and servo_node waits for it at start.

A trajectory's times count from its stamp (without one, from its arrival), and its last point holds. A line may be sent
in pieces under one stamp, each replacing the one before.

While charger_power reports a closed contactor, the arm does not move. While its state is unknown, or a probe allows
it to close, only the sender that last moved the arm with the contactor open may move it (`MotionGuard`). Charging
continues.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from deltacharger.msg import ChargerPower, ServoState
from deltacharger.srv import SetContactor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_core import environment, machine, real_time, runtime, servo_types, texts
from deltacharger_core.frames import CHARGER_BASE, JointFrameParameters
from deltacharger_core.ros import diagnostics, executor, log, messages, node_support, parameters
from deltacharger_core.ros.clock import Stamps, stamp_age
from deltacharger_core.ros.on_demand import BoundedTopic
from deltacharger_core.ros.qos import LATEST, SERVICE
from deltacharger_driver.errors import DriverError, NoServosBehindBoard, TrajectoryRefused
from deltacharger_driver.parameters import BOARD_MARGIN, OF_TYPE, SERVOS_FOLLOW, ServoNodeParameters
from deltacharger_driver.servos import bus, motion, registers
from deltacharger_driver.servos.controller import Contactor, ServoController, bus_entry, servo_entry

KEPT = QoSProfile(history=HistoryPolicy.KEEP_LAST, depth=64, reliability=ReliabilityPolicy.RELIABLE)
"""charger_power and joint_trajectory: read in every cycle, so that a flood from one sender does not hide the others."""

_HOLDER = "servo_node"  # anyone may open; the name only shows who did
_LARGEST_POWER = 1024  # bytes of a charger_power; a valid one has 80
LONGEST_SECRET = 64  # characters of header.frame_id
_LARGEST = 128 * 1024  # bytes of a trajectory, and of all that one cycle reads; 1000 points have 112 000, read in 36 ms
_LARGEST_HOLD = 512  # bytes of a trajectory without points
_Line = tuple[motion.Sender, int, int]

_DIAGNOSTICS_PERIOD = 1.0  # s
_LATE = 0.5  # of a period; a cycle that begins later than this is late
_BOARD_TIMEOUT = 10.0  # s at start to wait for the servo port of tactile_node
_POLL_PERIOD = 0.05  # s between two checks for this port
_SERVICE_TIMEOUT = 5.0  # s; a reboot takes up to 3


class ContactorClient(Contactor):
    """The contactor for `ServoController`, and the motion guard, over set_contactor and charger_power.

    Used by one thread.

    Args:
        node: the client; its executor takes the answers without a waiting thread.
        clock: s.

    Attributes:
        guard: decides who may move the arm.
    """

    def __init__(self, node: Node, clock: Callable[[], float] = time.monotonic) -> None:
        self.guard = motion.MotionGuard()
        self._clock = clock
        self._node = node
        self._client: Any = node.create_client(SetContactor, "set_contactor", qos_profile=SERVICE)
        self._power = BoundedTopic(node, ChargerPower, "charger_power", KEPT)
        self._pending: Future[Any] | None = None
        self._requested_at = -math.inf  # s, of the last request to open
        self._open = True

    def request_open(self) -> None:
        """Request an opening if there is a server; returns at once."""
        with contextlib.suppress(RuntimeError):  # ROS is shutting down
            if self._pending is not None:
                self._client.remove_pending_request(self._pending)  # its server died: it would wait forever
                self._pending = None
            self._open = not self._client.service_is_ready()
            if not self._open:
                self._requested_at = self._clock()
                self._pending = self._client.call_async(SetContactor.Request(close=False, holder=_HOLDER))

    def is_open(self) -> bool:
        """Return whether it was measured open and without current after the last `request_open`, or has no server."""
        if not self._open:
            with contextlib.suppress(RuntimeError):
                self._read_power()
        return self._open

    def state(self) -> motion.ContactorState:
        """Return its known state."""
        with contextlib.suppress(RuntimeError):  # ROS is shutting down
            self._read_power()
        announced = not self.guard.was_received and self._is_announced()
        return self.guard.state(self._clock(), announced)

    def _is_announced(self) -> bool:
        with contextlib.suppress(RuntimeError):
            return bool(self._client.service_is_ready() or self._node.count_publishers(self._power.name))
        return True

    def _read_power(self) -> None:
        received = self._power.take()
        if not received:
            return
        now, clock = self._clock(), self._node.get_clock()
        opened = False
        # The newest of each publisher; all messages if rclpy does not provide the publisher.
        for each in {one.publisher or one.data: one for one in received}.values():
            power = each.read() if len(each.data) <= _LARGEST_POWER else None
            if power is None:
                continue
            age = stamp_age(clock, power.header.stamp)
            current = (
                abs(power.charge_current) >= machine.ZERO_CURRENT
            )  # NaN = not measured: the contactor alone decides
            live = power.contactor_closed or current or power.fault == ChargerPower.FAULT_CONTACTOR_WELDED
            opened |= not live and now - age > self._requested_at and age >= -real_time.AHEAD
            armed = (
                power.probe_age < machine.PROBE_LIFETIME
            )  # whatever it found: limits may allow a close on a dead port
            self.guard.observe(each.publisher or self._nameless(live), live, armed, age, now)
        self._open |= opened and self.guard.state(now, False) is not motion.ContactorState.CLOSED

    def _nameless(self, live: bool) -> bytes:
        """Return an id if rclpy provides none: with several publishers, reports of open and live are kept apart."""
        return b"live" if live and self._node.count_publishers(self._power.name) > 1 else b""


class StatePublishers:
    """Publishes servo_state and joint_states from reports.

    Args:
        node: the publisher.
        qos: of servo_state.
        frame_id: full name of charger_base.
        joint_prefix: prefix of the names in joint_states.
    """

    def __init__(self, node: Node, qos: QoSProfile, frame_id: str, joint_prefix: str = "") -> None:
        self._state = ServoState(name=list(machine.JOINTS))
        self._joint = JointState(name=[f"{joint_prefix}{name}" for name in machine.JOINTS])
        self._state.header.frame_id = self._joint.header.frame_id = frame_id
        self._stamps = Stamps(node.get_clock())
        self._states = node.create_publisher(ServoState, "servo_state", qos)
        self._joints = node.create_publisher(JointState, "joint_states", 10)

    def publish(self, report: bus.ServoReport, torque_constant: float) -> None:
        """Publish the state after a cycle; joint_states only if all angles are known and it has subscribers.

        Its efforts are currents times `torque_constant` (N·m/A).
        """
        state, stamp = self._state, self._stamps.at(report.time)
        state.header.stamp = stamp
        state.position, state.velocity = array("d", report.angle), array("d", report.velocity)
        state.current = array("d", report.current)
        state.voltage, state.temperature = array("f", report.voltage), array("f", report.temperature)
        state.hardware_error, state.stray = array("B", report.hardware_error), array("B", report.stray)
        state.torque_enabled, state.valid = list(report.torque_enabled), list(report.valid)
        state.thermal_reserve = array("f", report.thermal_reserve)
        self._states.publish(state)
        if self._joints.get_subscription_count() and not math.isnan(sum(report.angle)):
            joint = self._joint
            joint.header.stamp, joint.position, joint.velocity = stamp, state.position, state.velocity
            joint.effort = array("d", [current * torque_constant for current in report.current])
            self._joints.publish(joint)


class TrajectoryInbox:
    """Selects which received trajectory a `ServoController` follows: the newest that is allowed and valid.

    Any node may publish on joint_trajectory. In each cycle a bounded part of the received data is read, the newest
    first. A refused message is counted, and the one before it is tried. Used by the controller's thread.

    Args:
        node: the subscriber.
        limits: of angles and torque bounds.

    Attributes:
        refused: trajectories refused since the start.
        forbidden: of these, those refused because of the contactor.
        last_refusal: reason of the last refusal.
    """

    def __init__(self, node: Node, limits: motion.JointLimits) -> None:
        self.refused = self.forbidden = 0
        self.last_refusal = ""
        self._node = node
        self._limits = limits
        self._topic = BoundedTopic(node, JointTrajectory, "joint_trajectory", KEPT)
        self._followed: _Line | None = None  # the line being followed

    def serve(self, controller: ServoController, guard: motion.MotionGuard, state: motion.ContactorState) -> None:
        """Pass the newest valid trajectory to the controller and refuse the newer ones.

        Args:
            controller: receives the trajectory.
            guard: decides who may move the arm.
            state: present state of the contactor.
        """
        budget = _LARGEST + KEPT.depth * _LARGEST_HOLD
        for received in reversed(self._topic.take()):
            secret = received.frame_id(LONGEST_SECRET)
            if secret is None:
                self._refuse(f"its header cannot be read, or its frame_id is longer than {LONGEST_SECRET} characters")
                continue
            sender = motion.Sender(secret, received.publisher)
            allowed = guard.may_move(sender, state)
            size = len(received.data)
            if not allowed and size > _LARGEST_HOLD:
                self._forbid(state)
                continue
            if size > _LARGEST:
                self._refuse(f"it has {size} bytes, more than {_LARGEST}; send fewer points and short names")
                continue
            budget -= size
            if budget < 0:  # too much data already refused
                return
            try:
                message = received.read()
                if message is None:
                    raise TrajectoryRefused("its bytes are not a JointTrajectory")
                if message.points and not allowed:
                    self._forbid(state)
                    continue
                self._follow(controller, message, sender)
            except TrajectoryRefused as error:
                self._refuse(error.reason)
                continue
            if message.points:
                guard.record_move(sender, state)
            return

    def _follow(self, controller: ServoController, message: Any, sender: motion.Sender) -> None:
        """Submit a trajectory or raise TrajectoryRefused."""
        if controller.phase is not bus.ServoPhase.ON:
            self._followed = None
        trajectory = motion.check(message.joint_names, [_waypoint(point) for point in message.points], self._limits)
        stamp = message.header.stamp
        old = self._age(stamp)
        line = (sender, stamp.sec, stamp.nanosec)
        # A later piece of a running line is as old as its end: the line itself may last longer than a stamp is valid.
        motion.check_age(max(old - trajectory.duration, 0.0) if line == self._followed else old)
        start = controller.now() - old if stamp.sec or stamp.nanosec else math.inf
        controller.submit(trajectory, start)
        self._followed = line if not trajectory.is_hold else self._followed

    def _age(self, stamp: Any) -> float:
        """Return the age of a stamp on the node's clock, s; 0 if not set, NaN if invalid."""
        return stamp_age(self._node.get_clock(), stamp) if stamp.sec or stamp.nanosec else 0.0

    def _forbid(self, state: motion.ContactorState) -> None:
        self.forbidden += 1
        self._refuse(state.value)

    def _refuse(self, reason: str) -> None:
        self.refused += 1
        self.last_refusal = str(TrajectoryRefused(reason))


def _waypoint(point: JointTrajectoryPoint) -> motion.ServoWaypoint:
    return motion.ServoWaypoint(messages.seconds(point.time_from_start), point.positions, point.effort)


def _wait_for_board(port: Path) -> None:
    """Wait for the servo port of tactile_node.

    Raises:
        NoServosBehindBoard: it does not appear.
    """
    end = time.monotonic() + _BOARD_TIMEOUT
    while not port.exists():
        if time.monotonic() > end:
            raise NoServosBehindBoard(str(port))
        time.sleep(_POLL_PERIOD)


class ServoNode(Node):
    """See the module's docstring.

    A separate thread owns the bus, takes trajectories and publishes; the services wait for it.

    Raises:
        StartupError: a parameter is wrong, the port cannot be opened, or the servos are not the expected ones.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("servo_node", **kwargs)
        self._lines = log.Log(self)
        self._contactor = ContactorClient(self)
        frames = parameters.declare_all(self, JointFrameParameters)
        given = parameters.declare_with_servos(self, ServoNodeParameters(), SERVOS_FOLLOW)
        parameters.reject_unknown(self)
        self._controller = self._configure(given)
        base = frames.named(CHARGER_BASE)
        self._states = StatePublishers(self, LATEST, base, frames.joint_prefix)
        self._diagnostics = diagnostics.Diagnostics(self)
        self._contactor_state = motion.ContactorState.UNKNOWN
        self._refused = 0  # refused trajectories that the diagnostics have reported
        self._cycles = real_time.RateMeter(time.monotonic)
        self._stop = threading.Event()
        settings = self._controller.bus.settings
        try:
            if given.port == machine.BEHIND_BOARD:
                _wait_for_board(Path(settings.port))
            self._controller.open()
        except DriverError as error:
            self._controller.close()
            self.destroy_node()
            raise node_support.StartupError(f"servo_node: {error}") from error
        self._lines.info(f"servos {settings.ids} at {settings.port}, {settings.baud_rate} baud")
        drive = self._controller.bus.drive
        self._tell_type(drive)
        # Only now: no trajectory may be accepted before the servos are known.
        largest = drive.current_max * drive.torque_constant * (1.0 + 1e-9)
        self._inbox = TrajectoryInbox(
            self, motion.JointLimits(machine.JOINTS, given.joint_min, given.joint_max, largest)
        )
        self._thread = threading.Thread(target=self._run, name="servo bus", daemon=True)
        self._thread.start()
        group = ReentrantCallbackGroup()
        self.create_service(SetBool, "set_torque", self._on_set_torque, callback_group=group, qos_profile=SERVICE)
        self.create_service(Trigger, "reboot_servos", self._on_reboot, callback_group=group, qos_profile=SERVICE)

    def close(self) -> None:
        """Goal := present position, torque off after at most 0.3 s, port closed, thread joined. Idempotent."""
        self._stop.set()
        self._thread.join()

    def _configure(self, given: ServoNodeParameters) -> ServoController:
        """Build the controller; parameters in `OF_TYPE` that nobody set are left to the servos' type."""
        measured = SERVOS_FOLLOW if self.get_parameter("servos_file").value else {}
        self._unset = {name for name in OF_TYPE if name not in measured and not parameters.was_given(self, name)}
        chosen = {name: None if name in self._unset else getattr(given, name) for name in OF_TYPE}
        is_behind_board = given.port == machine.BEHIND_BOARD
        try:
            settings = registers.BusSettings(
                str(runtime.servos(environment.domain(), self.get_namespace())) if is_behind_board else given.port,
                given.baud_rate,
                given.ids,
                given.zero_ticks,
                given.direction,
                reply_margin=given.reply_margin + BOARD_MARGIN * is_behind_board,
                torque_constant=chosen["torque_constant"],
                current_max=chosen["current_max"],
                gains=tuple(chosen[name] for name in registers.GAINS),
                joint_min=given.joint_min,
                joint_max=given.joint_max,
            )
        except DriverError as error:
            raise node_support.StartupError(f"servo_node: {error}") from error
        self._period = 1.0 / given.rate
        return ServoController(settings, self._log, contactor=self._contactor)

    def _tell_type(self, drive: registers.Drive) -> None:
        """Show what the servos' type decided in the parameters that nobody set, and in the log."""
        values = {"torque_constant": drive.torque_constant, "current_max": drive.current_max}
        values |= dict(zip(registers.GAINS, drive.gains, strict=True))
        found = {name: value for name, value in values.items() if name in self._unset}
        if drive.servo is not servo_types.MX_64 and found:
            parameters.show_values(self, found)
            text = ", ".join(f"{name} {value:.4g}" for name, value in found.items())
            self._lines.info(f"the servos are {drive.servo.name}; by their type {text}")

    def _run(self) -> None:
        """Own the bus: cycle until `close` is called, then make the arm safe."""
        try:
            self._cycle_until_safe()
        except BaseException as error:
            self._controller.close()  # first: after an error of this thread the arm must have no torque
            self._lines.error(f"servo bus thread ended: {error!r}; torque is off")
            raise
        self._controller.close()

    def _cycle_until_safe(self) -> None:
        """Cycle at the rate until `close` was called, torque is off, and servo_state has reported it."""
        controller = self._controller
        due = diagnosed = time.monotonic()
        while True:
            closing, off = self._stop.is_set(), controller.phase in (bus.ServoPhase.OFF, bus.ServoPhase.DISCONNECTED)
            if closing and not off and not controller.is_releasing:
                controller.request("torque_off")
            now = time.monotonic()
            self._cycles.count(late=now - due > _LATE * self._period)
            self._take_trajectory()  # without torque too: one from before torque went on is refused, not kept
            report = controller.cycle()
            if self.context.ok():
                self._states.publish(report, controller.bus.drive.torque_constant)
            if closing and off:
                return
            now = time.monotonic()
            if now - diagnosed >= _DIAGNOSTICS_PERIOD:
                diagnosed = now
                self._publish_diagnostics(report)
            due = max(due + self._period, now)  # when late, skip missed cycles instead of catching up
            time.sleep(due - now)

    def _publish_diagnostics(self, report: bus.ServoReport) -> None:
        controller = self._controller
        if report.phase is not bus.ServoPhase.ON:
            self._contactor_state = self._contactor.state()
        inbox = self._inbox
        refused = inbox.last_refusal if inbox.refused > self._refused else ""
        self._refused = inbox.refused
        level, message, values = bus_entry(report, controller, refused)
        values |= {
            "rate": texts.quantity(self._cycles.rate(), ".1f", "Hz"),
            "late_cycles": self._cycles.late,
            "contactor": self._contactor_state.name,
            "refused_trajectories": inbox.refused,
            "forbidden_trajectories": inbox.forbidden,
            "last_refusal": inbox.last_refusal,
        }
        settings, hot = controller.bus.settings, controller.bus.drive.servo.temperature_limit
        statuses = [self._diagnostics.status(level, message, values, "servo bus", settings.port)]
        for index, (joint, servo) in enumerate(zip(machine.JOINTS, settings.ids, strict=True)):
            level, message, values = servo_entry(report, index, hot)
            values = {"joint": joint, "id": servo, **values}
            statuses.append(self._diagnostics.status(level, message, values, f"servo {servo}", settings.port))
        self._diagnostics.publish(*statuses)

    def _take_trajectory(self) -> None:
        """Pass a received trajectory to the controller or refuse it; hold while the contactor is closed."""
        controller, inbox = self._controller, self._inbox
        state = motion.ContactorState.OPEN  # without torque every trajectory is refused
        if controller.phase is bus.ServoPhase.ON:
            self._contactor_state = state = self._contactor.state()
        before = inbox.refused
        inbox.serve(controller, self._contactor.guard, state)
        if state is motion.ContactorState.CLOSED:
            controller.freeze()
        if inbox.refused > before and not self._stop.is_set():  # at shutdown the sender closes too
            self._lines.warning(inbox.last_refusal, pause=1.0)

    def _on_set_torque(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        return self._ask("torque_on" if request.data else "torque_off", response)

    def _on_reboot(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._ask("reboot", response)

    def _ask(self, action: str, response: Any) -> Any:
        """Have the bus thread execute `action` unless it comes too late, and fill in the result."""
        if self._stop.is_set():
            response.success, response.message = False, "the driver is closing"
            return response
        queued = self._controller.request(action, executor.order_age())
        if queued.wait(_SERVICE_TIMEOUT):
            response.success, response.message = queued.success, queued.message
        else:
            response.success, response.message = False, "the servos' thread did not answer in time"
        return response

    def _log(self, severity: str, message: str) -> None:
        loggers = {"error": self._lines.error, "warning": self._lines.warning}
        loggers.get(severity, self._lines.info)(message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(ServoNode, args, has_deadlines=True)


if __name__ == "__main__":
    raise SystemExit(main())
