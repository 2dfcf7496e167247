# SPDX-License-Identifier: Apache-2.0
"""A mission's requests to other nodes: their actions, the detector, and docking's state."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from deltacharger.srv import DetectElectrodes
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_mission.dialogue import DockingReport, End, MissionObservation, Task, TaskReply, TaskRequest
from deltacharger_mission.ros.messages import fill_pose, read_detection, read_dock, read_drive, read_state, unknown_dock
from deltacharger_ros.action_caller import FORGOTTEN, LOST, REFUSED, ActionCaller, OnEnd, result_of
from deltacharger_ros.messages import duration
from deltacharger_ros.qos import SERVICE

_LOST_TIMEOUT = 5.0  # s that an action may have no server before its goal is lost
_ENDS = {
    GoalStatus.STATUS_SUCCEEDED: End.DONE,
    GoalStatus.STATUS_CANCELED: End.CANCELED,
    REFUSED: End.REFUSED,
    **dict.fromkeys((LOST, FORGOTTEN), End.LOST),
}


class Others:
    """Sends a mission's requests to other nodes and collects their replies.

    Args:
        node: owns clients and subscription.
        navigate_to_pose: type of that action; None without navigation.
        trees: behavior trees for a drive and for a small move near the target; empty = the navigator's own.
        place: returns a detection in charger_base.
        end_effector: full name of this frame.
    """

    def __init__(
        self,
        node: Node,
        navigate_to_pose: Any,
        trees: tuple[str, str],
        place: Callable[[Any], Any],
        end_effector: str,
    ) -> None:
        self._place = place
        self._end_effector = end_effector
        self._navigate_to_pose = navigate_to_pose
        self._trees = trees
        self._lock = threading.Lock()
        self._replies: list[TaskReply] = []
        self._docking: DockingReport | None = None
        self._delivered = 0.0  # J, by earlier dockings of this mission
        self.dock_result = unknown_dock(end_effector)
        self._detector: Any = node.create_client(DetectElectrodes, Task.DETECT.value, qos_profile=SERVICE)
        self._callers = {
            task: ActionCaller(node, kind, task.value, self._on_end(read), _LOST_TIMEOUT)
            for task, kind, read in (
                (Task.DOCK, Dock, self._read_dock),
                (Task.UNDOCK, Undock, read_dock),
                (Task.DRIVE, navigate_to_pose, read_drive),
            )
            if kind is not None
        }
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(DockingState, "docking_state", self._on_state, latched)

    @property
    def is_at_work(self) -> bool:
        """Whether a cancel has not been sent yet, a docking has no result, or docking_state still reports charging."""
        charging = self._docking is not None and self._docking.charging
        docks = not self._callers[Task.DOCK].is_idle
        return charging or docks or not all(caller.is_settled for caller in self._callers.values())

    def observe(self) -> MissionObservation:
        """Return the present observation; every reply is returned once."""
        for caller in self._callers.values():
            caller.tick()
        served = {task for task, caller in self._callers.items() if caller.is_served}
        if self._detector.service_is_ready():
            served.add(Task.DETECT)
        with self._lock:
            replies, self._replies = tuple(self._replies), []
        return MissionObservation(time.monotonic(), frozenset(served), self._docking, replies)

    def carry_out(self, command: Any) -> None:
        """Send the requests, and cancel those that are no longer wanted."""
        for request in command.requests:
            if request.task is Task.DETECT:
                self._look(request)
            else:
                self._callers[request.task].send(request.number, self._message(request))
        for number in command.cancels:
            for caller in self._callers.values():
                caller.cancel(number)

    def destroy(self) -> None:
        """Destroy the ROS side."""
        for caller in self._callers.values():
            caller.destroy()

    def _look(self, request: TaskRequest) -> None:
        """Request a detection, if the detector is available."""
        if not self._detector.service_is_ready():
            self._put(read_detection(request.number, None))
            return
        future = self._detector.call_async(DetectElectrodes.Request(timeout=duration(request.timeout)))
        future.add_done_callback(lambda done: self._put(read_detection(request.number, result_of(done), self._place)))

    def _message(self, request: TaskRequest) -> Any:
        if request.task is Task.UNDOCK:
            return Undock.Goal()
        if request.task is Task.DOCK:
            assert request.goal is not None
            self._delivered = self.dock_result.energy
            self.dock_result = unknown_dock(self._end_effector, math.nan)  # until its result is known
            return Dock.Goal(  # an empty frame_id: docking asks the camera again, at rest and near the target
                hold=True,
                stop_energy=request.goal.stop_energy,
                stop_after=duration(request.goal.stop_after),
                request_id=request.goal.request_id,
                target_profile=request.goal.target_profile,
            )
        assert request.place is not None
        goal = self._navigate_to_pose.Goal(behavior_tree=self._trees[request.precise])
        fill_pose(goal.pose, request.place)  # stamp 0: the newest available transform
        return goal

    def _on_end(self, read: Callable[[int, End, Any, Any], TaskReply]) -> OnEnd:
        return lambda number, end, *result: self._put(read(number, _ENDS.get(end, End.FAILED), *result))

    def _put(self, reply: TaskReply) -> None:
        with self._lock:
            self._replies.append(reply)

    def _on_state(self, message: DockingState) -> None:
        self._docking = read_state(message) or self._docking

    def _read_dock(self, number: int, end: End, result: Any, feedback: Any) -> TaskReply:
        if result is not None:
            result.energy += self._delivered
            self.dock_result = result
        elif end is not End.LOST:  # it never began
            self.dock_result = unknown_dock(self._end_effector, self._delivered)
        return read_dock(number, end, result, feedback)
