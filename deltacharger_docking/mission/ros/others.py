# SPDX-License-Identifier: Apache-2.0
"""A mission's requests to other nodes: their actions, the detector, docking's state; and messages as plain values."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from action_msgs.msg import GoalStatus
from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from deltacharger.srv import DetectElectrodes
from geometry_msgs.msg import PoseStamped
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_core import frames, texts
from deltacharger_core.ros import action_caller, messages, qos
from deltacharger_docking import codes, observation
from deltacharger_docking.mission import dialogue, places
from deltacharger_docking.mission.parameters import MissionParameters
from deltacharger_docking.ros.messages import seen
from deltacharger_kinematics.geometry import Vector

_LOST_TIMEOUT = 5.0  # s that an action may have no server before its goal is lost
_ENDS = {
    GoalStatus.STATUS_SUCCEEDED: dialogue.End.DONE,
    GoalStatus.STATUS_CANCELED: dialogue.End.CANCELED,
    action_caller.REFUSED: dialogue.End.REFUSED,
    action_caller.LOST: dialogue.End.LOST,
}


class Others:
    """Sends a mission's requests to other nodes and collects their replies.

    Args:
        node: owns clients and subscription.
        navigate_to_pose: type of that action; None without navigation.
        parameters: of missions.
        transforms: how the charger's frames are named.
    """

    def __init__(
        self, node: Node, navigate_to_pose: Any, parameters: MissionParameters, transforms: frames.TransformParameters
    ) -> None:
        self._charger_base, self._end_effector = (
            transforms.named(frames.CHARGER_BASE),
            transforms.named(frames.END_EFFECTOR),
        )
        self._navigate_to_pose = navigate_to_pose
        self._parameters = parameters
        self._lock = threading.Lock()
        self._replies: list[dialogue.TaskReply] = []
        self._docking: dialogue.DockingReport | None = None
        self.dock_result = unknown_dock(self._end_effector)
        self._detector: Any = node.create_client(DetectElectrodes, dialogue.Task.DETECT.value, qos_profile=qos.SERVICE)
        self._callers = {
            task: action_caller.ActionCaller(node, kind, task.value, self._on_end(read), _LOST_TIMEOUT)
            for task, kind, read in (
                (dialogue.Task.DOCK, Dock, self._read_dock),
                (dialogue.Task.UNDOCK, Undock, read_dock),
                (dialogue.Task.DRIVE, navigate_to_pose, read_drive),
            )
            if kind is not None
        }
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(DockingState, "docking_state", self._on_state, latched)

    @property
    def is_at_work(self) -> bool:
        """Whether a cancel has not been sent yet, a docking has no result, or docking_state still reports charging."""
        charging = self._docking is not None and self._docking.charging
        docks = not self._callers[dialogue.Task.DOCK].is_idle
        return charging or docks or not all(caller.is_settled for caller in self._callers.values())

    def observe(self) -> dialogue.MissionObservation:
        """Return the present observation; every reply is returned once."""
        for caller in self._callers.values():
            caller.tick()
        served = {task for task, caller in self._callers.items() if caller.is_served}
        if self._detector.service_is_ready():
            served.add(dialogue.Task.DETECT)
        with self._lock:
            replies, self._replies = tuple(self._replies), []
        return dialogue.MissionObservation(time.monotonic(), frozenset(served), self._docking, replies)

    def carry_out(self, command: dialogue.MissionCommand) -> None:
        """Send the requests, and cancel those that are no longer wanted."""
        for request in command.requests:
            if request.task is dialogue.Task.DETECT:
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

    def _look(self, request: dialogue.TaskRequest) -> None:
        """Request a detection, if the detector is available."""
        if not self._detector.service_is_ready():
            self._put(read_detection(request.number, None))
            return
        future = self._detector.call_async(DetectElectrodes.Request(timeout=messages.duration(request.timeout)))
        frame = self._charger_base
        future.add_done_callback(
            lambda done: self._put(read_detection(request.number, action_caller.result_of(done), frame))
        )

    def _message(self, request: dialogue.TaskRequest) -> Any:
        if request.task is dialogue.Task.UNDOCK:
            return Undock.Goal()
        if request.task is dialogue.Task.DOCK:
            assert request.goal is not None
            self.dock_result = unknown_dock(self._end_effector, math.nan)  # until its result is known
            given = {name: getattr(request.goal, name) for name in ("stop_energy", "request_id", "target_profile")}
            # An empty frame_id: docking asks the camera again, at rest and near the target.
            return Dock.Goal(hold=True, stop_after=messages.duration(request.goal.stop_after), **given)
        assert request.place is not None
        trees = self._parameters.behavior_tree, self._parameters.precise_behavior_tree
        goal = self._navigate_to_pose.Goal(behavior_tree=trees[request.precise])
        fill_pose(goal.pose, request.place)  # stamp 0: the newest available transform
        return goal

    def _on_end(self, read: Callable[[int, dialogue.End, Any, Any], dialogue.TaskReply]) -> action_caller.OnEnd:
        return lambda number, end, *result: self._put(read(number, _ENDS.get(end, dialogue.End.FAILED), *result))

    def _put(self, reply: dialogue.TaskReply) -> None:
        with self._lock:
            self._replies.append(reply)

    def _on_state(self, message: DockingState) -> None:
        self._docking = read_state(message) or self._docking

    def _read_dock(self, number: int, end: dialogue.End, result: Any, feedback: Any) -> dialogue.TaskReply:
        if result is not None:
            self.dock_result = result
        elif end is not dialogue.End.LOST:  # it never began
            self.dock_result = unknown_dock(self._end_effector)
        return read_dock(number, end, result, feedback)


def read_dock(number: int, end: dialogue.End, result: Any, feedback: Any) -> dialogue.TaskReply:
    """Return the reply of a docking or an undocking; `result` is None if docking_node sent none."""
    if result is None:
        return dialogue.TaskReply(
            number, end, codes.Code.REJECTED, "docking_node did not accept the goal; check its log", True
        )
    pose = getattr(result, "suggested_base_pose", None)
    base = _suggested_base(pose.pose) if pose is not None and pose.header.frame_id else None
    code = codes.Code(result.error_code) if result.error_code in set(codes.Code) else codes.Code.INTERNAL
    ended = dialogue.End.DONE if result.success else dialogue.End.FAILED if end is dialogue.End.DONE else end
    return dialogue.TaskReply(number, ended, code, texts.cut(result.error_message), result.retriable, suggested=base)


def read_drive(number: int, end: dialogue.End, result: Any, feedback: Any) -> dialogue.TaskReply:
    """Return the reply of a drive; results before Kilted have no text, and before Iron no code."""
    code, words = getattr(result, "error_code", 0), texts.cut(getattr(result, "error_msg", ""))
    message = " ".join(part for part in (words, f"(error {code} of the navigator)" if code else "") if part)
    return dialogue.TaskReply(
        number, end, message=message, place=None if feedback is None else place(feedback.current_pose)
    )


def read_detection(number: int, answer: Any, frame: str = frames.CHARGER_BASE) -> dialogue.TaskReply:
    """Return the reply of detect_electrodes; None = there was none. `frame` is the full name of charger_base.

    An implausible detection counts as failed, so that the robot is not sent to it.
    """
    if answer is None:
        return dialogue.TaskReply(number, dialogue.End.LOST)
    if not answer.success:
        return dialogue.TaskReply(number, dialogue.End.FAILED, message=texts.cut(answer.message))
    try:
        if problem := texts.far(_numbers(answer.detection.pose.pose.position)):
            return dialogue.TaskReply(number, dialogue.End.FAILED, message=f"the detection's place: {problem}")
        return dialogue.TaskReply(number, dialogue.End.DONE, electrodes=seen(answer.detection, 0.0, frame))
    except ValueError as error:
        return dialogue.TaskReply(number, dialogue.End.FAILED, message=str(error))


def _suggested_base(pose: Any) -> observation.BasePose | None:
    """Return a suggested pose; None if it is not finite or implausibly far."""
    point, turn = _numbers(pose.position), pose.orientation
    yaw, _ = frames.lean(frames.rotation(turn.x, turn.y, turn.z, turn.w))
    return observation.BasePose(*point, yaw) if not texts.far(point) and math.isfinite(yaw) else None


def read_state(message: Any) -> dialogue.DockingReport | None:
    """Return the content of docking_state; None if its state is invalid."""
    if message.state not in set(codes.State):
        return None
    return dialogue.DockingReport(codes.State(message.state), message.docked, message.charging)


def unknown_dock(frame_id: str = frames.END_EFFECTOR, energy: float = 0.0) -> Any:
    """Return the result of a docking of which none is known: measurements are NaN; J of earlier ones."""
    result = messages.unknown(Dock.Result())
    result.misalignment.header.frame_id = frame_id
    result.energy, result.suggested_base_pose = energy, PoseStamped()
    return result


def goal(request: Any, parameters: MissionParameters) -> dialogue.MissionGoal:
    """Return a ChargeRobot goal as plain values; without navigation its target counts for nothing.

    Raises:
        Rejected: the target is in another frame than map_frame, or is not a pose on the ground of a site.
    """
    where = None
    if parameters.navigation != "none":
        frame, here = request.target.header.frame_id, place(request.target)
        if frame != parameters.map_frame:
            raise codes.Rejected(f"target.header.frame_id is '{frame[:60]}': give the target in {parameters.map_frame}")
        if here is None:
            raise codes.Rejected("the target's pose is not finite, or its quaternion is zero: send numbers")
        if problem := texts.far((here.x, here.y), texts.ON_MAP):
            raise codes.Rejected(f"the target's place in {here.frame}: {problem}")
        where = here.at(parameters.electrodes_x, parameters.electrodes_y, parameters.electrodes_yaw)
    stop_after = messages.seconds(request.stop_after)
    return dialogue.MissionGoal(where, request.stop_energy, stop_after, request.request_id, request.target_profile)


def place(message: PoseStamped) -> places.Place | None:
    """Return a pose as a place on the ground; None if it is not finite or its quaternion is zero."""
    point, turn = message.pose.position, message.pose.orientation
    length = math.hypot(turn.x, turn.y, turn.z, turn.w)
    if not (math.isfinite(point.x) and math.isfinite(point.y) and math.isfinite(length) and length > 0.0):
        return None
    x, y, z, w = (part / length for part in (turn.x, turn.y, turn.z, turn.w))
    sine, cosine = w * z + x * y, 0.5 - y**2 - z**2
    return places.Place(point.x, point.y, math.atan2(sine, cosine), message.header.frame_id)


def fill_pose(message: PoseStamped, where: places.Place) -> None:
    """Write a place into a PoseStamped, except its stamp."""
    message.header.frame_id = where.frame
    message.pose.position.x, message.pose.position.y = where.x, where.y
    message.pose.orientation.z, message.pose.orientation.w = math.sin(0.5 * where.yaw), math.cos(0.5 * where.yaw)


def _numbers(point: Any) -> Vector:
    return point.x, point.y, point.z
