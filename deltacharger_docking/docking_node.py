"""docking_node: the actions dock and undock over the docking state machine.

Subscribes to servo_state, tactile_frame, charger_power; calls set_torque, tare, probe, set_contactor,
predict_misalignment and detect_electrodes; publishes joint_trajectory, docking_state and /diagnostics. One thread,
paced by servo_state, steps the machine, publishes what it commands and renews the contactor's lease: if that thread
hangs, the lease lapses.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse, ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.time import Time
from trajectory_msgs.msg import JointTrajectory

from deltacharger_bringup import node_support
from deltacharger_docking import docking_node_io as io
from deltacharger_docking.codes import Code, DockingError, Rejected
from deltacharger_docking.goal_check import suggested_base
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockGoal, Observation, Outcome, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.kinematics_node import declare_geometry

GoalHandle = ServerGoalHandle[Any, Any, Any]

_TICK = 0.02  # s; pace where servo_state does not come
_FEEDBACK = 0.2  # s between feedbacks without a change
_DIAGNOSTICS = 1.0  # s
_OPEN_TIMEOUT = 0.6  # s to see the contactor open when the node closes
_TORQUE_DELAY = 0.5  # s from an opening after a defect to torque off
_TORQUE_TIMEOUT = 1.0  # s to see the torque go off; servo_node waits 0.5 s before it switches it off


def declare_parameters(node: Node) -> DockingParameters:
    """Declare every field of `DockingParameters` and return the given values.

    Raises:
        StartupError: a value is refused.
    """
    values = {}
    for item in fields(DockingParameters):
        bounds = item.metadata
        values[item.name] = node_support.declare(
            node,
            item.name,
            item.default,
            bounds["description"],
            bounds.get("low"),
            bounds.get("high"),
            bounds.get("choices", ()),
        )
    try:
        return DockingParameters(**values)
    except ValueError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error


class _Goal:
    """A goal being served: its handle, and events for the thread that waits in its callback."""

    def __init__(self, handle: GoalHandle, feedback: Any) -> None:
        self.handle = handle
        self.feedback = feedback
        self.done = threading.Event()
        self.outcome: Outcome | None = None
        self.shown: tuple[Any, ...] = ()
        self.shown_at = -math.inf


class DockingNode(Node):
    """Serves dock and undock; see the module for topics and services, docs/docking.md for the parameters."""

    def __init__(self, **kwargs: Any) -> None:
        self._closed = True  # nothing to make safe before the node is complete
        self._servers: list[ActionServer[Any, Any, Any]] = []
        super().__init__("docking_node", **kwargs)
        self._settings = declare_parameters(self)
        geometry = declare_geometry(self)
        self._base_frame = node_support.declare(
            self, "base_frame", "base_link", "the robot's frame in which goals may be given besides charger_base"
        )
        self._base_pose = node_support.declare(
            self,
            "base_pose",
            [0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5],
            "charger_base in base_frame: x, y, z in m, then the quaternion x, y, z, w",
        )
        if len(self._base_pose) != 7:
            raise node_support.StartupError("docking_node: parameter 'base_pose' needs 7 numbers: x y z qx qy qz qw")
        node_support.reject_unknown(self)
        self._machine = DockingMachine(self._settings, geometry)
        self._lock = threading.RLock()
        self._goal: _Goal | None = None
        self._wake = threading.Event()
        self._stopping = threading.Event()
        self._state_shown: tuple[Any, ...] = ()
        self._diagnosed = -math.inf
        self._torque_off_at = math.inf
        self._slowest_tick = 0.0
        group = ReentrantCallbackGroup()
        self._inputs = io.Inputs(self, group, self._wake.set)
        self._calls = io.Services(self, group, self._age)
        self._trajectory = self.create_publisher(JointTrajectory, "joint_trajectory", QoSProfile(depth=1))
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state = self.create_publisher(DockingState, "docking_state", latched)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._servers.append(self._serve(Dock, "dock", self._execute_dock, group))
        self._servers.append(self._serve(Undock, "undock", self._execute_undock, group))
        self._closed = False
        self._thread = threading.Thread(target=self._loop, name="docking loop", daemon=True)
        self._thread.start()

    def _serve(self, kind: Any, name: str, execute: Any, group: ReentrantCallbackGroup) -> ActionServer[Any, Any, Any]:
        """Serve an action; every goal is accepted, because only a result can carry a code and a reason."""
        return ActionServer(
            self,
            kind,
            name,
            execute_callback=execute,
            goal_callback=lambda request: GoalResponse.ACCEPT,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=group,
        )

    def close(self) -> None:
        """Open the contactor, see it open, stop the servos, end the goal and the loop. Safe to call twice."""
        if self._closed:
            return
        self._closed = True
        self._stopping.set()
        self._wake.set()
        self._thread.join(2.0)
        with self._lock:
            self._carry_out(self._machine.emergency(), self._observe())
        end = time.monotonic() + _OPEN_TIMEOUT
        while self._observe().contactor_closed and time.monotonic() < end:
            self._calls.contactor(False, True)
            time.sleep(0.02)
        end = time.monotonic() + _TORQUE_TIMEOUT
        if self._is_live(self._observe()):
            self.get_logger().error("the contactor does not open; the torque stays on so that no arc is drawn")
        elif self._observe().torque_enabled:
            self._calls.call(Request(0, Service.TORQUE_OFF))
            while self._observe().torque_enabled and time.monotonic() < end:
                time.sleep(0.02)
        goal = self._goal
        if goal is not None:
            goal.outcome = Outcome(code=Code.CANCELED, message="the charger is shutting down", retriable=True)
            goal.done.set()
        self._publish_state(force=True)

    def destroy_node(self) -> None:
        """Close, then release the ROS side."""
        self.close()
        for server in self._servers:
            server.destroy()
        super().destroy_node()

    def _age(self, stamp: Any) -> float:
        return float((self.get_clock().now() - Time.from_msg(stamp)).nanoseconds) * 1e-9

    def _observe(self) -> Observation:
        replies, refusal = self._calls.take()
        return self._inputs.observation(replies, refusal)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            self._wake.wait(_TICK)
            self._wake.clear()
            started = time.monotonic()
            try:
                with self._lock:
                    observation = self._observe()
                    self._carry_out(self._machine.step(observation), observation)
                    self._report()
                    self._switch_off_when_due(observation)
            except Exception as error:  # a defect must open the contactor and end the goal, not the thread
                self._defect(error)
            self._slowest_tick = max(self._slowest_tick, time.monotonic() - started)

    def _switch_off_when_due(self, observation: Observation) -> None:
        """After a defect, switch the torque off once the contactor is open: never before."""
        if time.monotonic() >= self._torque_off_at and not self._is_live(observation):
            self._torque_off_at = math.inf
            self._calls.call(Request(0, Service.TORQUE_OFF))

    def _is_live(self, observation: Observation) -> bool:
        return observation.contactor_closed and observation.power_age <= self._settings.power_age_max

    def _defect(self, error: Exception) -> None:
        self.get_logger().error(f"docking stopped by a defect: {type(error).__name__}: {error}")
        with self._lock:
            self._carry_out(self._machine.emergency(), self._observe())
            self._torque_off_at = min(self._torque_off_at, time.monotonic() + _TORQUE_DELAY)
            self._end_goal(Outcome(code=Code.INTERNAL, message=f"internal error: {error}; see the log"))

    def _carry_out(self, command: Command, observation: Observation) -> None:
        self._calls.contactor(command.energise, observation.contactor_closed)
        if command.trajectory is not None:
            # Not the instant of sending: planning a line takes milliseconds, and times count from the observation.
            now = self.get_clock().now() - Duration(seconds=time.monotonic() - observation.time)
            self._trajectory.publish(io.trajectory(command.trajectory, now.to_msg()))
        for request in command.requests:
            self._calls.call(request)

    def _report(self) -> None:
        """Publish state and feedback where they changed, hand a finished goal over, diagnose now and then."""
        self._publish_state()
        outcome, self._machine.outcome = self._machine.outcome, None
        if outcome is not None:
            self._end_goal(outcome)
        goal = self._goal
        if goal is not None and not goal.done.is_set():
            if goal.handle.is_cancel_requested:
                self._machine.cancel()
            self._feed_back(goal)
        if time.monotonic() - self._diagnosed > _DIAGNOSTICS:
            self._diagnosed = time.monotonic()
            self._diagnose()

    def _end_goal(self, outcome: Outcome) -> None:
        goal = self._goal
        if goal is not None:
            goal.outcome = outcome
            goal.done.set()
        self._goal = None

    def _publish_state(self, force: bool = False) -> None:
        status = self._machine.status
        shown = (status.state, status.docked, status.charging, status.code, status.message, status.request_id)
        if shown == self._state_shown and not force:
            return
        self._state_shown = shown
        message = DockingState(
            state=int(status.state),
            docked=status.docked,
            charging=status.charging,
            error_code=int(status.code),
            error_message=status.message,
            request_id=status.request_id,
        )
        message.header.stamp = self.get_clock().now().to_msg()
        self._state.publish(message)

    def _feed_back(self, goal: _Goal) -> None:
        status = self._machine.status
        shown = (status.state, status.alignments, status.estimate)
        if shown == goal.shown and time.monotonic() - goal.shown_at < _FEEDBACK:
            return
        goal.shown, goal.shown_at = shown, time.monotonic()
        message = goal.feedback()
        message.state = int(status.state)
        message.z = status.position[2]
        if isinstance(message, Dock.Feedback):
            message.alignments = status.alignments
            message.contact_current = status.contact_current
            message.misalignment = self._calls.misalignment(status.estimate)
            message.elapsed = io.duration(status.elapsed)
        else:
            message.charge_current = self._observe_charge_current()
        with contextlib.suppress(RuntimeError):  # the client may have gone between the check and the call
            goal.handle.publish_feedback(message)

    def _observe_charge_current(self) -> float:
        return self._inputs.observation().charge_current

    def _diagnose(self) -> None:
        status, observation = self._machine.status, self._inputs.observation()
        level, text = DiagnosticStatus.OK, status.state.name
        if status.code:
            level, text = DiagnosticStatus.WARN, f"{status.code.name}: {status.message}"
        if observation.servo_age > self._settings.servo_age_max:
            level, text = DiagnosticStatus.ERROR, "servo_state is missing or stale"
        entries = {
            "state": status.state.name,
            "docked": status.docked,
            "charging": status.charging,
            "contact_current_A": round(status.contact_current, 3),
            "servo_age_s": round(observation.servo_age, 3),
            "tactile_age_s": round(observation.tactile_age, 3),
            "power_age_s": round(observation.power_age, 3),
            "slowest_tick_ms": round(1000 * self._slowest_tick, 1),
        }
        self._slowest_tick = 0.0
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        values = [KeyValue(key=key, value=str(value)) for key, value in entries.items()]
        name = self.get_fully_qualified_name()
        message.status = [DiagnosticStatus(level=level, name=name, message=text, hardware_id="", values=values)]
        self._diagnostics.publish(message)

    def _execute_dock(self, handle: GoalHandle) -> Dock.Result:
        request = handle.request
        outcome = self._serve_goal(
            _Goal(handle, Dock.Feedback),
            lambda observation: self._machine.start_dock(self._dock_goal(request), observation),
        )
        return self._dock_result(outcome)

    def _execute_undock(self, handle: GoalHandle) -> Undock.Result:
        request = handle.request
        outcome = self._serve_goal(
            _Goal(handle, Undock.Feedback),
            lambda observation: self._machine.start_undock(request.request_id, observation),
        )
        return Undock.Result(
            success=outcome.success,
            error_code=int(outcome.code),
            error_message="" if outcome.success else outcome.message,
            retriable=outcome.retriable,
            elapsed=io.duration(outcome.elapsed),
        )

    def _serve_goal(self, goal: _Goal, start: Any) -> Outcome:
        """Start a goal, wait for its end in this callback's own thread, and set the handle's final state."""
        try:
            with self._lock:
                if self._closed:
                    raise Rejected("the charger is shutting down")
                start(self._inputs.observation())  # takes no reply that the running goal waits for
                self._goal = goal
                self._torque_off_at = math.inf
        except DockingError as error:
            outcome = Outcome(
                code=error.code, message=str(error), retriable=error.retriable, suggested_base=suggested_base(error)
            )
            goal.handle.abort()
            return outcome
        except Exception as error:  # rclpy would answer with an empty result, which looks like code 0
            self.get_logger().error(f"a goal met a defect: {type(error).__name__}: {error}")
            goal.handle.abort()
            return Outcome(code=Code.INTERNAL, message=f"internal error: {error}; see the log")
        while not goal.done.wait(1.0):
            if self._goal is not goal and not goal.done.is_set():  # a goal that nobody serves must not wait for ever
                goal.outcome = Outcome(message="the goal was lost; see the log")
                break
        assert goal.outcome is not None
        outcome = goal.outcome
        if outcome.success:
            goal.handle.succeed()
        elif outcome.code is Code.CANCELED and goal.handle.is_cancel_requested:
            goal.handle.canceled()
        else:
            goal.handle.abort()
        return outcome

    def _dock_goal(self, request: Dock.Goal) -> DockGoal:
        return DockGoal(
            electrodes=io.electrodes(request.electrodes, self._base_frame, self._base_pose),
            critical_angle=request.critical_angle,
            start_charging=request.start_charging,
            hold=request.hold,
            stop_energy=request.stop_energy,
            stop_after=io.seconds(request.stop_after),
            request_id=request.request_id,
        )

    def _dock_result(self, outcome: Outcome) -> Dock.Result:
        return Dock.Result(
            success=outcome.success,
            error_code=int(outcome.code),
            error_message="" if outcome.success else outcome.message,
            retriable=outcome.retriable,
            aligned=outcome.aligned,
            alignments=outcome.alignments,
            misalignment=self._calls.misalignment(outcome.estimate),
            contact_current=outcome.contact_current,
            contact_force=outcome.contact_force,
            charge_current=outcome.charge_current,
            energy=outcome.energy,
            elapsed=io.duration(outcome.elapsed),
            suggested_base_pose=io.pose_stamped(outcome.suggested_base, self.get_clock().now().to_msg()),
        )


def main(args: Sequence[str] | None = None) -> int:
    """Run docking_node until SIGINT or SIGTERM; 0 after a signal, 2 where it cannot start as configured."""
    return node_support.run(DockingNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
