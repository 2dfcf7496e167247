# SPDX-License-Identifier: Apache-2.0
"""docking_node: the actions dock and undock over the docking state machine.

Subscribes to servo_state, tactile_frame, charger_power. Calls set_torque, tare, probe, set_contactor,
predict_misalignment and detect_electrodes. Publishes joint_trajectory, docking_state, docking_decision and
/diagnostics. One thread, paced by servo_state, steps the machine, publishes its commands and renews the contactor's
lease. If that thread hangs, the lease lapses.
"""

import contextlib
import math
import secrets
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from deltacharger.action import Dock, Undock
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core import environment, texts
from deltacharger_core.frames import TransformParameters
from deltacharger_core.ros import action_server, clock, log, messages, node_support, outcomes, parameters, qos
from deltacharger_core.ros.frames import Frames, TransformError
from deltacharger_docking import codes, goals, machine
from deltacharger_docking.observation import Command, DockGoal, DockingOutcome, Observation, Request, Service
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters, ProfileNames, TargetProfile
from deltacharger_docking.ros import inputs, messages as io, reports, services
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_kinematics.parameters import GeometryFileParameters

_SERVOS_FOLLOW = {"servo_stiffness": "stiffness", "torque_constant": "torque_constant"}  # names in servos_file
_TICK = 0.02  # s; period without servo_state
_OPEN_TIMEOUT = 0.6  # s for the contactor to open when the node closes
_TORQUE_DELAY = 0.5  # s from opening after a defect to torque off
_LAST_REQUEST = -1  # number of the final request to switch the torque off
_SHUTTING_DOWN = "the charger is shutting down"
_TORQUE_TIMEOUT = 1.0  # s for the torque to go off; servo_node takes 0.3 s at most
_ANSWER = 1.0  # s to see a goal's callback end when the node closes
_FEEDBACK = 0.2  # s between feedbacks without a change


class ServedGoal(action_server.Work):
    """A goal being served, of an action."""

    def __init__(self, handle: action_server.GoalHandle, action: Any) -> None:
        super().__init__(handle)
        self.action = action


class DockingNode(Node):
    """Serves dock and undock; topics and services in the module docstring, parameters in docs/parameters.md.

    The machine serves one goal at a time; `_lock` protects it.

    Args:
        held: command and publish nothing, and queue goals, until `release`.
        kwargs: of rclpy's Node.
    """

    def __init__(self, held: bool = False, **kwargs: Any) -> None:
        self._closed = True  # nothing to make safe before the node is complete and released
        super().__init__("docking_node", **kwargs)
        robot, transforms = (
            parameters.declare_all(self, DockingNodeParameters),
            parameters.declare_all(self, TransformParameters),
        )
        defaults = DockingParameters.of(robot.servo)
        self._settings = parameters.declare_with_servos(self, defaults, _SERVOS_FOLLOW)
        geometry = parameters.declare_file(self, GeometryFileParameters, load_geometry) or DeltaGeometry()
        names = parameters.declare_all(self, ProfileNames).target_profiles
        profiles = {name: parameters.declare_all(self, TargetProfile, prefix=f"{name}.") for name in names}
        parameters.reject_unknown(self)
        self._frames = frames = Frames(self, transforms, robot.base_frame, robot.base_pose)
        self._targets = ", ".join(profiles) or "none, so it charges nothing (docs/targets.md)"
        self._machine = machine.DockingMachine(self._settings, geometry, profiles=profiles)
        self._lock = threading.RLock()
        self._log = log.Log(self)
        self._clock_watch = clock.ClockWatch(self.get_clock())
        self._stopping = threading.Event()
        self._torque_off_at = math.inf
        self._goal: ServedGoal | None = None
        self._ended: action_server.GoalHandle | None = None  # of the goal that ended last
        self._waiting: list[action_server.GoalHandle] | None = []  # goals that arrived before `release`
        self._inputs = inputs.Inputs(self, self._log)
        self._calls = services.Services(self, transforms)
        self._secret = secrets.token_hex(16)  # shows servo_node that this process sends the trajectories
        self._trajectory = self.create_publisher(JointTrajectory, "joint_trajectory", qos.LATEST)
        self._reports = reports.Reports(self, self._log, self._settings.age_max, frames.charger_base)
        self._servers = [
            self._serve(Dock, "dock", self._dock_goal, self._machine.start_dock, self._dock_result),
            self._serve(
                Undock,
                "undock",
                lambda request: str(request.request_id),
                self._machine.start_undock,
                lambda outcome: messages.to_result(Undock, outcome),
            ),
        ]
        parameters.Tuning(self, self._settings, self._tune)
        self._thread = threading.Thread(target=self._loop, name="docking loop", daemon=True)
        if not held:
            self.release()

    def _tune(self, settings: DockingParameters) -> str:
        """Set parameters for the next goal; those that this node itself uses are not tunable."""
        with self._lock:
            return self._machine.tune(settings)

    def release(self) -> None:
        """Start, and begin the queued goals in their order."""
        self._closed = False
        live = "power none: electrodes are live whenever they touch"
        power = live if self._settings.always_live else f"profiles of targets: {self._targets}"
        self._log.info(f"takes goals, {power}, version {environment.package_version()}")
        self._thread.start()
        with self._lock:
            waiting, self._waiting = self._waiting, None
        for handle in waiting or ():
            handle.execute()

    def close(self) -> None:
        """Open the contactor, wait until it is open, stop the servos, end the goal and the loop. Safe to call twice.

        A node that was never released stays silent, because its commands would reach another charger of the same name.
        """
        if self._closed:
            return
        self._closed = True
        self._frames.close()
        self._stopping.set()
        self._thread.join(2.0)
        why = codes.Canceled(_SHUTTING_DOWN)
        with self._lock:
            command = self._machine.emergency(why)
            self._carry_out(command, self._observe())
            self._reports.decided(command.decisions, self._machine.status.request_id)
        end = time.monotonic() + _OPEN_TIMEOUT
        while self._count().contactor_closed and time.monotonic() < end:
            time.sleep(0.02)
        with self._lock, contextlib.suppress(Exception):  # the machine may be the defect that ends this node
            self._machine.end()
        self._count()
        if self._settings.always_live and self._machine.status.docked:
            self._log.error("the electrodes stay on the target, live: start docking_node again and undock")
        if self._is_live(self._observe()):
            self._log.error("the contactor does not open: switch the battery off; the torque stays on to avoid an arc")
        else:
            self._await_torque_off()
        self._reports.show(self._machine.status, force=True)
        self._reports.log(self._machine.status, self._observe())
        unknown = DockingOutcome(code=why.code, message=_SHUTTING_DOWN, retriable=True, energy=math.nan)
        goal = self._goal
        self._end(self._machine.outcome or unknown)
        if goal is not None:
            goal.wait_until_answered(_ANSWER)

    def _count(self) -> Observation:
        """Keep the contactor open, and let the machine count what still flows; return the observation."""
        observation = self._observe()
        self._calls.contactor(False, observation.contactor_closed)
        with self._lock, contextlib.suppress(Exception):  # as above
            decisions = self._machine.step(observation).decisions
            self._reports.decided(decisions, self._machine.status.request_id)
        return observation

    def _await_torque_off(self) -> None:
        """Switch the torque off and wait until it is, even if an order to switch it on is pending."""
        self._calls.call(Request(_LAST_REQUEST, Service.TORQUE_OFF))
        observation = self._observe()
        answered, end = observation.servo_age == math.inf, time.monotonic() + _TORQUE_TIMEOUT
        while (observation.torque_enabled or not answered) and time.monotonic() < end:
            if not self._calls.is_served(Service.TORQUE_OFF):
                return  # servo_node has ended, which switches the torque off
            time.sleep(0.02)
            observation = self._observe()
            answered |= any(reply.number == _LAST_REQUEST for reply in observation.replies)

    def destroy_node(self) -> None:
        """Close, then destroy the ROS side."""
        self.close()
        for server in getattr(self, "_servers", ()):  # missing if a parameter was refused
            server.destroy()
        super().destroy_node()

    # The loop.

    def _observe(self) -> Observation:
        return self._inputs.observation(*self._calls.take_replies())

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                self._pace()
                with self._lock:
                    self._inputs.look()
                    observation = self._observe()
                    if self._goal is not None and self._goal.handle.is_cancel_requested:
                        self._machine.cancel()
                    command = self._machine.step(observation)
                    self._carry_out(command, observation)
                    self._report(command, observation)
                    self._switch_off_when_due(observation)
            except Exception as error:  # a defect must open the contactor and end the goal, but not end the thread
                self._defect(error)

    def _pace(self) -> None:
        """Wait for the next servo_state; in IDLE only for the tick."""
        if self._machine.status.state is codes.State.IDLE:
            self._inputs.rest()
            self._stopping.wait(_TICK)
        else:
            self._inputs.wait(_TICK)

    def _switch_off_when_due(self, observation: Observation) -> None:
        """After a defect, switch the torque off as soon as the contactor is open, never before."""
        if time.monotonic() >= self._torque_off_at and not self._is_live(observation):
            self._torque_off_at = math.inf
            self._calls.call(Request(0, Service.TORQUE_OFF))

    def _is_live(self, observation: Observation) -> bool:
        return observation.contactor_closed and observation.power_age <= self._settings.age_max

    def _defect(self, error: Exception) -> None:
        """Make everything safe and end the goal after an internal error."""
        text = f"an internal error stopped docking: {type(error).__name__}: {error}"
        self._log.error(text, pause=1.0)
        with self._lock:
            try:
                observation = self._observe()
            except Exception:  # if that is the defect, nothing is known; the contactor's lease lapses by itself
                observation = Observation(time.monotonic())
            self._carry_out(self._machine.emergency(), observation)
            self._switch_off_when_due(observation)  # also here, because every tick may fail
            self._torque_off_at = min(self._torque_off_at, time.monotonic() + _TORQUE_DELAY)
            self._calls.forget()
            words = f"internal error: {error}; see the log"
            lasted = self._machine.status.elapsed
            self._end(DockingOutcome(code=codes.Code.INTERNAL, message=words, elapsed=lasted, energy=math.nan))

    def _carry_out(self, command: Command, observation: Observation) -> None:
        self._calls.contactor(command.energise, observation.contactor_closed, command.limits)
        if command.trajectory is not None:
            # Stamped with the observation: planning a line takes milliseconds, and times count from the observation.
            stamp = clock.before_now(self.get_clock(), time.monotonic() - observation.time)
            self._trajectory.publish(io.trajectory(command.trajectory, stamp, self._secret))
        for request in command.requests:
            self._calls.call(request)

    def _report(self, command: Command, observation: Observation) -> None:
        """Publish decisions and changes, hand over a finished goal, publish diagnostics when due."""
        status = self._machine.status
        self._reports.decided(command.decisions, status.request_id)
        self._reports.show(status)
        self._reports.log(status, observation)
        self._feed_back(observation.charge_current)
        self._hand_over()
        self._reports.diagnose(status, observation, self._inputs.heard)

    def _hand_over(self) -> None:
        outcome, self._machine.outcome = self._machine.outcome, None
        if outcome is not None:
            if not outcome.success:
                self._calls.forget()
            self._end(outcome)

    # Goals.

    def _serve(
        self,
        action: Any,
        name: str,
        read: Callable[[Any], Any],
        start: Callable[[Any, Observation], None],
        result: Callable[[DockingOutcome], Any],
    ) -> action_server.WorkServer:
        """Serve an action: `read` turns a request into what the machine's `start` takes."""
        return action_server.WorkServer(
            self,
            action,
            name,
            lambda handle: self._begin(ServedGoal(handle, action), name, read, start),
            lambda goal: goal is self._goal,
            lambda error: replace(DockingOutcome.refused(error), suggested_base=goals.suggested_base(error)),
            codes.DockingError,
            lambda outcome, goal: result(outcome),
            # An accepted cancel means that the arm will retract, so an ended goal accepts none.
            lambda handle: bool(handle.is_active) and handle is not self._ended,
            self._on_accepted,
        )

    def _on_accepted(self, handle: action_server.GoalHandle) -> None:
        with self._lock:
            if self._waiting is not None:
                self._waiting.append(handle)
                return
        handle.execute()

    def _begin(
        self, goal: ServedGoal, name: str, read: Callable[[Any], Any], start: Callable[[Any, Observation], None]
    ) -> ServedGoal:
        """Begin a goal; it may end at once.

        Raises:
            DockingError: it is refused.
        """
        request = goal.handle.request
        with self._lock:
            if self._clock_watch.has_no_time and not self._machine.status.docked:  # a docked charger can always undock
                raise codes.NoTime(clock.NO_TIME_YET)
        order = read(request)
        with self._lock:
            self._check_open()
            seen = self._observe()  # leaves the replies for the running goal
            try:
                start(order, seen)
                self._goal = goal
                self._torque_off_at = math.inf
                self._reports.phases.begin_goal(texts.titled(name, request.request_id), _as_text(order))
                self._reports.show(self._machine.status)
                self._hand_over()
            except codes.DockingError:
                raise
            except Exception as error:  # the machine may have begun; without this, nothing would end its goal
                self._defect(error)
                raise
        return goal

    def _check_open(self) -> None:
        """Refuse goals while the node closes, with `Busy`."""
        if self._closed and self._waiting is None:
            raise codes.Busy(f"{_SHUTTING_DOWN}; send the goal again when it is back")

    def _end(self, outcome: DockingOutcome) -> None:
        """End the goal being served with this outcome."""
        goal, self._goal = self._goal, None
        if goal is not None:
            self._ended = goal.handle
            goal.end(outcome)

    def _feed_back(self, charge_current: float) -> None:
        """Publish feedback if something changed, or when due."""
        goal, status = self._goal, self._machine.status
        news = status.state, status.alignments, status.estimate, status.waiting_for
        if goal is None or not goal.is_due(news, _FEEDBACK):
            return
        message = goal.action.Feedback(state=int(status.state), z=status.position[2])
        if goal.action is Dock:
            message.alignments, message.contact_current = status.alignments, status.contact_current
            message.misalignment = self._calls.misalignment(status.estimate)
            message.elapsed, message.waiting_for = messages.duration(status.elapsed), status.waiting_for
        else:
            message.charge_current = charge_current
        goal.feed_back(message)

    def _dock_goal(self, request: Dock.Goal) -> DockGoal:
        """Return the plain values of a Dock goal. The pose is converted once, since the robot stands still.

        What can never be served is refused first, so that nobody sends it again after a goal that is served now.
        """
        given = {name: getattr(request, name) for name in io.GIVEN}
        goal = DockGoal(None, stop_after=messages.seconds(request.stop_after), **given)
        io.check_numbers(request.electrodes)
        frame = request.electrodes.header.frame_id
        with self._lock:
            self._machine.check(goal)
            self._check_open()
            if self._frames.needs_tf(frame):  # whose first lookup takes long: live electrodes must not wait for it
                self._machine.check_free()
        try:
            charger = self._frames.charger_base_in(frame, request.electrodes.header.stamp)
        except TransformError as error:
            raise io.refusal(error) from error
        return replace(goal, electrodes=io.electrodes(request.electrodes, charger))

    def _dock_result(self, outcome: DockingOutcome) -> Dock.Result:
        return messages.to_result(
            Dock,
            outcome,
            misalignment=self._calls.misalignment(outcome.estimate),
            suggested_base_pose=io.pose_stamped(
                outcome.suggested_base, self.get_clock().now().to_msg(), self._frames.charger_base
            ),
            **{name: getattr(outcome, name) for name in (*io.MEASURED, "redockings")},
        )


def _as_text(goal: DockGoal | str) -> str:
    """Return a goal's request as text; '' for undocking."""
    if isinstance(goal, str):
        return ""
    at = "electrodes located by the camera"
    if goal.electrodes is not None:
        at = f"electrodes at {outcomes.place(*goal.electrodes.position, goal.electrodes.roll)}"
    stops = [f"{goal.stop_energy:g} J" if goal.stop_energy else "", f"{goal.stop_after:g} s" if goal.stop_after else ""]
    until = " or ".join(filter(None, stops))
    charge = "charges" if goal.start_charging else "does not charge"
    if goal.target_profile:
        charge = f"{charge} as {goal.target_profile}"
    return f"{at}, {charge}{until and f' until {until}'}{', holds the goal' if goal.hold else ''}"


def main(args: Sequence[str] | None = None) -> int:
    """Run docking_node until SIGINT or SIGTERM; return 0 after a signal, 2 if the configuration is wrong."""
    return node_support.run(DockingNode, args, has_deadlines=True)


if __name__ == "__main__":
    raise SystemExit(main())
