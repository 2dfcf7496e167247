# SPDX-License-Identifier: Apache-2.0
"""The actions dock and undock: accept, monitor and answer goals, with feedback. Part of docking_node."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from deltacharger.action import Dock, Undock
from deltacharger.msg import Misalignment
from rclpy.node import Node

from deltacharger_core.texts import titled
from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.codes import Busy, DockingError, NoTime, State
from deltacharger_docking.goals import suggested_base
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import DockGoal, DockingOutcome, Observation
from deltacharger_docking.parameters import DockingNodeParameters
from deltacharger_docking.ros import messages as io
from deltacharger_docking.ros.reports import changes
from deltacharger_ros.action_server import GoalHandle, Work, WorkServer
from deltacharger_ros.clock import NO_TIME_YET, ClockWatch
from deltacharger_ros.frames import Frames, TransformError
from deltacharger_ros.messages import duration, seconds, to_result
from deltacharger_ros.outcomes import place

_ANSWER = 1.0  # s to see a goal's callback end when the node closes
_FEEDBACK = 0.2  # s between feedbacks without a change
MEASURED = (
    *("aligned", "alignments", "contact_current", "contact_force", "charge_current", "energy"),
    *("contact_force_min", "contact_force_max", "charge_end", "charge_voltage"),
)
"""Fields of a Dock result that have the same names in an outcome."""


class ServedGoal(Work):
    """A goal being served, and the state last reported to its client.

    Args:
        handle: of the goal.
        name: of the action.
        feedback: class of the feedback message.
    """

    def __init__(self, handle: GoalHandle, name: str, feedback: Any) -> None:
        super().__init__(handle)
        self.handle = handle
        self.name = name
        self.feedback = feedback
        self.state = State.IDLE


class Goals:
    """Serves dock and undock with the machine, one goal at a time; goals that arrive before `release` are queued.

    Args:
        node: owns the action servers.
        machine: executes goals; stepped by the node.
        lock: protects the machine.
        observe: returns the present observation.
        begun: called with the lock held after the machine has begun a goal, with the goal's title and its request as
            text; publishes, and hands over an outcome that exists already.
        defect: called with the lock held after an internal error at the beginning of a goal; makes the charger safe and
            ends the goal.
        misalignment: returns the message of an estimate.
        mount: limits of the electrodes' lean.
        frames: transforms goals; may block.
    """

    def __init__(
        self,
        node: Node,
        machine: DockingMachine,
        lock: threading.RLock,
        observe: Callable[[], Observation],
        begun: Callable[[str, str], None],
        defect: Callable[[Exception], None],
        misalignment: Callable[[MisalignmentEstimate | None], Misalignment],
        mount: DockingNodeParameters,
        frames: Frames,
    ) -> None:
        self._node, self._clock = node, ClockWatch(node.get_clock())
        self._machine = machine
        self._lock = lock
        self._observe = observe
        self._begun = begun
        self._defect = defect
        self._misalignment = misalignment
        self._mount = mount
        self._frames = frames
        self._goal: ServedGoal | None = None
        self._ended: GoalHandle | None = None  # of the goal that ended last
        self._refusal = ""
        self._waiting: list[GoalHandle] | None = []  # goals that arrived before `release`
        self._servers = [
            self._serve(Dock, "dock", self._dock_goal, machine.start_dock, self._dock_result),
            self._serve(
                Undock, "undock", _request_id, machine.start_undock, lambda outcome: to_result(Undock, outcome)
            ),
        ]

    def _serve(
        self,
        kind: Any,
        name: str,
        read: Callable[[Any], Any],
        start: Callable[[Any, Observation], None],
        result: Callable[[DockingOutcome], Any],
    ) -> WorkServer:
        return WorkServer(
            self._node,
            kind,
            name,
            lambda handle: self._begin(ServedGoal(handle, name, kind.Feedback), read, start),
            lambda goal: goal is self._goal,
            lambda error: replace(DockingOutcome.refused(error), suggested_base=suggested_base(error)),
            DockingError,
            lambda outcome, goal: result(outcome),
            self._may_cancel,
            self._on_accepted,
        )

    def destroy(self) -> None:
        """Destroy the ROS side."""
        for server in self._servers:
            server.destroy()

    def release(self) -> None:
        """Begin the queued goals in their order; later goals begin when they arrive."""
        with self._lock:
            waiting, self._waiting = self._waiting, None
        for handle in waiting or ():
            handle.execute()

    def refuse(self, reason: str) -> None:
        """Refuse all further goals."""
        with self._lock:
            self._refusal = reason

    def close(self, outcome: DockingOutcome) -> None:
        """End the goal being served, and give its client time to receive the result."""
        goal = self._goal
        self.end(outcome)
        if goal is not None:
            goal.wait_until_answered(_ANSWER)

    def forward_cancel(self) -> None:
        """Pass a client's cancel on to the machine; called before each step, so that no cancel is late."""
        goal = self._goal
        if goal is not None and goal.handle.is_cancel_requested:
            self._machine.cancel()

    def end(self, outcome: DockingOutcome) -> None:
        """End the goal being served with this outcome."""
        goal, self._goal = self._goal, None
        if goal is not None:
            self._ended = goal.handle
            goal.end(outcome)

    def feed_back(self, passed: Sequence[State], charge_current: float) -> None:
        """Publish feedback if something changed, once for each state passed through since the last call."""
        goal, status = self._goal, self._machine.status
        if goal is None:
            return
        states = changes(goal.state, passed, status.state)
        goal.state = status.state
        if goal.is_due((status.alignments, status.estimate, status.waiting_for), _FEEDBACK):
            states = states or [status.state]
        for state in states:
            message = goal.feedback(state=int(state), z=status.position[2])
            if isinstance(message, Dock.Feedback):
                message.alignments = status.alignments
                message.contact_current = status.contact_current
                message.misalignment = self._misalignment(status.estimate)
                message.elapsed = duration(status.elapsed)
                message.waiting_for = status.waiting_for
            else:
                message.charge_current = charge_current
            goal.feed_back(message)

    def _on_accepted(self, handle: GoalHandle) -> None:
        with self._lock:
            if self._waiting is not None:
                self._waiting.append(handle)
                return
        handle.execute()

    def _may_cancel(self, handle: GoalHandle) -> bool:
        """Return whether the goal has not ended: an accepted cancel means that the arm will retract."""
        return bool(handle.is_active) and handle is not self._ended

    def _begin(
        self, goal: ServedGoal, read: Callable[[Any], Any], start: Callable[[Any, Observation], None]
    ) -> ServedGoal:
        """Start a goal: `read` turns its request into what the machine's `start` takes.

        Raises:
            DockingError: it is refused.
        """
        request = goal.handle.request
        with self._lock:
            if self._clock.has_no_time and not self._machine.status.docked:  # a docked charger can always undock
                raise NoTime(NO_TIME_YET)
        order = read(request)
        with self._lock:
            self._check_open()
            seen = self._observe()
            try:
                start(order, seen)
                self._goal = goal
                self._begun(titled(goal.name, request.request_id), _as_text(order))
            except DockingError:
                raise
            except Exception as error:  # the machine may have begun; without this, nothing would end its goal
                self._defect(error)
                raise
        return goal

    def _check_open(self) -> None:
        """Refuse goals while the node closes.

        Raises:
            Busy: the node closes.
        """
        if self._refusal:
            raise Busy(self._refusal)

    def _dock_goal(self, request: Dock.Goal) -> DockGoal:
        """Return the plain values of a Dock goal. The pose is converted once, since the robot stands still.

        What can never be served is refused first, so that nobody sends it again after a goal that is served now.
        """
        goal = DockGoal(
            electrodes=None,
            critical_angle=request.critical_angle,
            start_charging=request.start_charging,
            hold=request.hold,
            stop_energy=request.stop_energy,
            stop_after=seconds(request.stop_after),
            request_id=request.request_id,
            target_profile=request.target_profile,
        )
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
        return replace(goal, electrodes=io.electrodes(request.electrodes, self._mount, charger))

    def _dock_result(self, outcome: DockingOutcome) -> Dock.Result:
        return to_result(
            Dock,
            outcome,
            misalignment=self._misalignment(outcome.estimate),
            suggested_base_pose=io.pose_stamped(
                outcome.suggested_base, self._node.get_clock().now().to_msg(), self._frames.charger_base
            ),
            redockings=outcome.redockings,
            **{name: getattr(outcome, name) for name in MEASURED},
        )


def _request_id(request: Undock.Goal) -> str:
    return str(request.request_id)


def _as_text(goal: DockGoal | str) -> str:
    """Return a goal's request as text; '' for undocking."""
    if isinstance(goal, str):
        return ""
    at = "electrodes located by the camera"
    if goal.electrodes is not None:
        at = f"electrodes at {place(*goal.electrodes.position, goal.electrodes.roll)}"
    stops = [f"{goal.stop_energy:g} J" if goal.stop_energy else "", f"{goal.stop_after:g} s" if goal.stop_after else ""]
    until = " or ".join(filter(None, stops))
    charge = "charges" if goal.start_charging else "does not charge"
    if goal.target_profile:
        charge = f"{charge} as {goal.target_profile}"
    return f"{at}, {charge}{until and f' until {until}'}{', holds the goal' if goal.hold else ''}"
