# SPDX-License-Identifier: Apache-2.0
"""servo_node: the arm's three servos on ROS.

Publishes: servo_state (reliable, depth 1, at `rate`), joint_states, /diagnostics (1 Hz; up to 5 Hz while trajectories
    are refused).
Subscribes: joint_trajectory and charger_power (reliable, depth 64; the newest accepted trajectory is followed).
Serves: set_torque, reboot_servos. Calls: set_contactor, if it exists.
Parameters: port, baud_rate, ids, rate, zero_ticks, direction, current_bound, current_max, joint_min, joint_max,
reply_margin, frame_prefix, joint_prefix; servos_file or torque_constant, position_p_gain, position_i_gain,
position_d_gain.

Safe at start: torque is off; only set_torque switches it on, holding the present position. A missing servo, a latched
hardware error or a lost port stops all servos: goal := present position, contactor open, torque off after 0.5 s. On
request and at the node's end, torque goes off once the contactor is reported open, after 0.3 s at the latest. A
vanished port is reopened and torque stays off. If the port cannot be opened at start, or unexpected servos answer, the
node ends with an error. With the port `board` the servos are connected to the board with the pads: tactile_node passes
their bytes through, and servo_node waits for it at start.

A trajectory's times count from its stamp (without one, from its arrival), and its last point holds. A line may be sent
in pieces under one stamp, each replacing the one before.

While charger_power reports a closed contactor, the arm does not move. While its state is unknown, or a probe allows
it to close, only the sender that last moved the arm with the contactor open may move it (motion_guard). The
diagnostics name a refused sender; charging continues.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_core import runtime
from deltacharger_core.environment import domain
from deltacharger_core.frames import CHARGER_BASE, JointFrameParameters
from deltacharger_core.machine import BEHIND_BOARD, JOINTS
from deltacharger_driver.errors import DriverError, NoServosBehindBoard
from deltacharger_driver.parameters import BOARD_MARGIN, SERVOS_FOLLOW, ServoNodeParameters
from deltacharger_driver.rate_meter import RateMeter
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.diagnostics import RefusedTrajectories, bus_entry, servo_entry
from deltacharger_driver.servos.motion_guard import ContactorState
from deltacharger_driver.servos.report import ServoPhase, ServoReport
from deltacharger_driver.servos.servo_node_io import ContactorClient, StatePublishers
from deltacharger_driver.servos.snapshot import BusSettings
from deltacharger_driver.servos.trajectory import JointLimits
from deltacharger_driver.servos.trajectory_node_io import TrajectoryInbox
from deltacharger_ros import node_support
from deltacharger_ros.diagnostics import Diagnostics
from deltacharger_ros.duplicates import publishers
from deltacharger_ros.executor import order_age
from deltacharger_ros.log import Log
from deltacharger_ros.parameters import declare_all, declare_with_servos, reject_unknown
from deltacharger_ros.qos import LATEST, SERVICE

_DIAGNOSTICS_PERIOD = 1.0  # s
_REFUSAL_PERIOD = 0.2  # s between two diagnostics while trajectories are refused
_LISTEN_EVERY = 10  # cycles between two checks for trajectories while torque is off
_LATE = 0.5  # of a period; a cycle that begins later than this is late
_BOARD_TIMEOUT = 10.0  # s at start to wait for the servo port of tactile_node
_POLL_PERIOD = 0.05  # s between two checks for this port
_SERVICE_TIMEOUT = 5.0  # s; a reboot takes up to 3


class ServoNode(Node):
    """See the module's docstring.

    A separate thread owns the bus, takes trajectories and publishes; the services wait for it.

    Raises:
        StartupError: a parameter is wrong, the port cannot be opened, or the servos are not the expected ones.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("servo_node", **kwargs)
        self._lines = Log(self)
        self._contactor = ContactorClient(self)
        frames = declare_all(self, JointFrameParameters)
        self._controller, self._limits = self._configure()
        base = frames.named(CHARGER_BASE)
        self._states = StatePublishers(self, LATEST, self._torque_constant, base, frames.joint_prefix)
        self._diagnostics = Diagnostics(self)
        self._contactor_state = ContactorState.UNKNOWN
        self._refused = 0  # refused trajectories that the diagnostics have reported
        self._cycles = RateMeter(time.monotonic)
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._listening = threading.Event()
        self._start_error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="servo bus", daemon=True)
        self._thread.start()
        self._ready.wait()
        if self._start_error is not None:
            self._thread.join()
            self.destroy_node()
            raise node_support.StartupError(f"servo_node: {self._start_error}") from self._start_error
        settings = self._controller.bus.settings
        self._lines.info(f"servos {settings.ids} at {settings.port}, {settings.baud_rate} baud")
        # Only now: no trajectory may be accepted before the servos are known.
        self._inbox = TrajectoryInbox(self, self._limits)
        self._listening.set()
        group = ReentrantCallbackGroup()
        self.create_service(SetBool, "set_torque", self._on_set_torque, callback_group=group, qos_profile=SERVICE)
        self.create_service(Trigger, "reboot_servos", self._on_reboot, callback_group=group, qos_profile=SERVICE)

    def close(self) -> None:
        """Goal := present position, torque off after at most 0.3 s, port closed, thread joined. Idempotent."""
        self._stop.set()
        self._thread.join()

    def _configure(self) -> tuple[ServoController, JointLimits]:
        """Declare the parameters and build the controller."""
        given = declare_with_servos(self, ServoNodeParameters, SERVOS_FOLLOW)
        reject_unknown(self)
        try:
            settings = BusSettings(
                self._path_of(given.port),
                given.baud_rate,
                given.ids,
                given.zero_ticks,
                given.direction,
                reply_margin=given.reply_margin + BOARD_MARGIN * self._is_behind_board,
                current_max=given.current_max,
                gains=(given.position_p_gain, given.position_i_gain, given.position_d_gain),
                joint_min=given.joint_min,
                joint_max=given.joint_max,
            )
        except DriverError as error:
            raise node_support.StartupError(f"servo_node: {error}") from error
        self._period = 1.0 / given.rate
        self._torque_constant = constant = given.torque_constant
        largest = given.current_max * constant * (1.0 + 1e-9)
        return (
            ServoController(settings, given.current_bound, constant, self._log, contactor=self._contactor),
            JointLimits(JOINTS, given.joint_min, given.joint_max, largest),
        )

    def _path_of(self, port: str) -> str:
        """Return the path of the parameter `port`."""
        self._is_behind_board = port == BEHIND_BOARD
        return str(runtime.servos(domain(), self.get_namespace())) if self._is_behind_board else port

    def _wait_for_board(self) -> None:
        """Wait for the servo port of tactile_node.

        Raises:
            NoServosBehindBoard: it does not appear.
        """
        port, end = Path(self._controller.bus.settings.port), time.monotonic() + _BOARD_TIMEOUT
        while not port.exists():
            if time.monotonic() > end or self._stop.wait(_POLL_PERIOD):
                raise NoServosBehindBoard(str(port))

    def _run(self) -> None:
        """Own the bus: cycle until `close` is called, then make the arm safe."""
        controller = self._controller
        try:
            if self._is_behind_board:
                self._wait_for_board()
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
            controller.close()  # first: after an error of this thread the arm must have no torque
            self._lines.error(f"servo bus thread ended: {error!r}; torque is off")
            raise
        finally:
            controller.close()

    def _cycle_until_safe(self) -> None:
        """Cycle at the rate until `close` was called, torque is off, and servo_state has reported it."""
        controller = self._controller
        due = diagnosed = time.monotonic()
        while True:
            closing, off = self._stop.is_set(), controller.phase in (ServoPhase.OFF, ServoPhase.DISCONNECTED)
            if closing and not off and not controller.is_releasing:
                controller.request("torque_off")
            now = time.monotonic()
            self._cycles.count(late=now - due > _LATE * self._period)
            if controller.phase is ServoPhase.ON or controller.has_request or self._cycles.total % _LISTEN_EVERY == 0:
                self._take_trajectory()  # a trajectory from before torque went on is refused, not kept
            report = controller.cycle()
            if self.context.ok():
                self._states.publish(report)
            if closing and off:
                return
            now = time.monotonic()
            refused = self._listening.is_set() and self._inbox.refused > self._refused
            if now - diagnosed >= (_REFUSAL_PERIOD if refused else _DIAGNOSTICS_PERIOD):
                diagnosed = now
                self._publish_diagnostics(report)
            due = max(due + self._period, now)  # when late, skip missed cycles instead of catching up
            time.sleep(due - now)

    def _publish_diagnostics(self, report: ServoReport) -> None:
        ids = self._controller.bus.settings.ids
        rate, late = self._cycles.rate(), self._cycles.late
        if report.phase is not ServoPhase.ON:
            self._contactor_state = self._contactor.state()
        entries = [bus_entry(report, self._controller, self._contactor_state.name, self._refusals(), rate, late)]
        entries += [servo_entry(report, index, ids[index], joint) for index, joint in enumerate(JOINTS)]
        port = self._controller.bus.settings.port
        self._diagnostics.publish(*(self._diagnostics.status(*entry, port) for entry in entries))

    def _refusals(self) -> RefusedTrajectories:
        """Return the trajectories refused since the last call."""
        if not self._listening.is_set():
            return RefusedTrajectories(0, 0, 0, "", "")
        inbox = self._inbox
        new, self._refused = inbox.refused - self._refused, inbox.refused
        by = publishers(self, inbox.topic, inbox.strangers) if inbox.strangers and self.context.ok() else ""
        if b"" in inbox.strangers:  # Jazzy's rclpy does not provide the sender
            by = f"one of {by}"
        inbox.strangers.clear()
        return RefusedTrajectories(new, inbox.refused, inbox.forbidden, inbox.last_refusal, by)

    def _take_trajectory(self) -> None:
        """Pass a received trajectory to the controller or refuse it; hold while the contactor is closed."""
        if not self._listening.is_set():
            return
        controller, inbox = self._controller, self._inbox
        state = ContactorState.OPEN  # without torque every trajectory is refused
        if controller.phase is ServoPhase.ON:
            self._contactor_state = state = self._contactor.state()
        before = inbox.refused
        inbox.serve(controller, self._contactor.guard, state)
        if state is ContactorState.CLOSED:
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
        queued = self._controller.request(action, order_age())
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
