"""Between messages and the state machine's plain values. Part of docking_node."""

from __future__ import annotations

import math
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration
from deltacharger.msg import ChargerPower, Misalignment, ServoState, TactileFrame
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe, SetContactor
from geometry_msgs.msg import Pose, PoseStamped
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rclpy.time import Time
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from deltacharger_docking.clearance import Estimate
from deltacharger_docking.codes import Rejected
from deltacharger_docking.observation import (
    Detection,
    Observation,
    Reply,
    Request,
    Service,
    Waypoint,
)
from deltacharger_kinematics.geometry import Vector

JOINTS = ("limb_0_arm_joint", "limb_1_arm_joint", "limb_2_arm_joint")
CONTACT_FORCE = 1.0  # N; the pads' smallest reading (paper: 1–9 N)
LEASE = 0.25  # s; longest lease that tactile_node grants
_RENEWAL = 0.1  # s between renewals of the lease
_DISCOVERY = 1.5  # s that a service may take to appear: nodes that start together find each other so late
_HOLDER = "docking_node"
_LOOKING = 0.9  # of the time for a detection: why nothing was found must arrive before docking gives up


class Inputs:
    """The latest of each topic, as one `Observation`."""

    def __init__(self, node: Node, group: ReentrantCallbackGroup, wake: Callable[[], None]) -> None:
        self._clock = node.get_clock()
        self._wake = wake
        self._servo: ServoState | None = None
        self._servo_time = -math.inf
        self._tactile: TactileFrame | None = None
        self._tactile_time = -math.inf
        self._power: ChargerPower | None = None
        self._power_time = -math.inf
        latest = QoSProfile(depth=1)
        node.create_subscription(ServoState, "servo_state", self._on_servo, latest, callback_group=group)
        node.create_subscription(
            TactileFrame, "tactile_frame", self._on_tactile, qos_profile_sensor_data, callback_group=group
        )
        node.create_subscription(ChargerPower, "charger_power", self._on_power, latest, callback_group=group)

    def _age_at_arrival(self, stamp: Any) -> float:
        """Return how long ago (s) the message was measured, so that a stale one is not fresh because it is new."""
        return max((self._clock.now() - Time.from_msg(stamp)).nanoseconds * 1e-9, 0.0)

    def _on_servo(self, message: ServoState) -> None:
        if len(message.position) == 3 and all(message.valid):
            self._servo_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
        self._servo = message
        self._wake()

    def _on_tactile(self, message: TactileFrame) -> None:
        self._tactile_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
        self._tactile = message

    def _on_power(self, message: ChargerPower) -> None:
        self._power_time = time.monotonic() - self._age_at_arrival(message.header.stamp)
        self._power = message

    def observation(self, replies: tuple[Reply, ...] = (), contactor_refusal: str = "") -> Observation:
        """Return what is known now."""
        now = time.monotonic()
        servo, tactile, power = self._servo, self._tactile, self._power
        values: dict[str, Any] = {"time": now, "replies": replies, "contactor_refusal": contactor_refusal}
        if servo is not None and len(servo.position) == 3:
            reserve = list(servo.thermal_reserve) or [math.inf]
            values.update(
                angles=tuple(servo.position),
                currents=tuple(servo.current),
                servos_valid=all(servo.valid),
                servo_age=now - self._servo_time,
                hardware_error=int(np.bitwise_or.reduce(np.array(servo.hardware_error, dtype=np.uint8))),
                torque_enabled=all(servo.torque_enabled),
                thermal_reserve=min(reserve),
            )
        if tactile is not None:
            values.update(tactile_age=now - self._tactile_time, tactile_contact=_touches(tactile), tared=tactile.tared)
        if power is not None:
            values.update(
                power_age=now - self._power_time,
                contactor_closed=power.contactor_closed,
                charge_current=power.charge_current,
                target_voltage=power.target_voltage,
                power_fault=power.fault,
            )
        return Observation(**values)


def _touches(frame: TactileFrame) -> bool:
    return any(float(np.nanmax(np.asarray(pad), initial=0.0)) >= CONTACT_FORCE for pad in (frame.left, frame.right))


class Services:
    """Calls services for the machine without waiting and collects the replies; renews the contactor's lease."""

    def __init__(self, node: Node, group: ReentrantCallbackGroup, clock_age: Callable[[Any], float]) -> None:
        self._lock = threading.Lock()
        self._replies: list[Reply] = []
        self._refusal = ""
        self._felt: tuple[Estimate | None, Misalignment] = None, _unknown()
        self._age = clock_age
        self._renewed = -math.inf
        self._undelivered: list[tuple[Request, float]] = []  # and until when their services are waited for, s
        self._wanted = False
        self._clients: dict[Service, Any] = {
            Service.TORQUE_ON: node.create_client(SetBool, "set_torque", callback_group=group),
            Service.TARE: node.create_client(Trigger, "tare", callback_group=group),
            Service.PROBE: node.create_client(Probe, "probe", callback_group=group),
            Service.ESTIMATE: node.create_client(PredictMisalignment, "predict_misalignment", callback_group=group),
            Service.DETECT: node.create_client(DetectElectrodes, "detect_electrodes", callback_group=group),
        }
        self._clients[Service.TORQUE_OFF] = self._clients[Service.TORQUE_ON]
        self._contactor: Any = node.create_client(SetContactor, "set_contactor", callback_group=group)
        self._clients[Service.OPEN] = self._contactor

    def call(self, request: Request) -> None:
        """Send a request; its reply appears in `take`. A service that is not there yet is waited for a moment."""
        if self._clients[request.service].service_is_ready():
            self._send(request)
        else:
            self._undelivered.append((request, time.monotonic() + _DISCOVERY))

    def _deliver(self) -> None:
        """Send what waits for its service, or tell that nobody serves it."""
        waiting, self._undelivered = self._undelivered, []
        for request, end in waiting:
            client = self._clients[request.service]
            if client.service_is_ready():
                self._send(request)
            elif time.monotonic() < end:
                self._undelivered.append((request, end))
            else:
                self._put(Reply(request.number, False, f"no node serves {client.srv_name}"))

    def _send(self, request: Request) -> None:
        client = self._clients[request.service]
        message: Any
        if request.service in (Service.TORQUE_ON, Service.TORQUE_OFF):
            message = SetBool.Request(data=request.service is Service.TORQUE_ON)
        elif request.service is Service.OPEN:
            message = SetContactor.Request(close=False, holder=_HOLDER)
        elif request.service is Service.ESTIMATE:
            message = PredictMisalignment.Request(frames=request.frames)
        elif request.service is Service.DETECT:
            message = DetectElectrodes.Request(timeout=duration(_LOOKING * request.timeout))
        else:
            message = client.srv_type.Request()
        future = client.call_async(message)
        future.add_done_callback(lambda done: self._answer(request, done))

    def take(self) -> tuple[tuple[Reply, ...], str]:
        """Return the replies since the last call, and why the contactor was refused ('' = it was not)."""
        self._deliver()
        with self._lock:
            replies, self._replies = tuple(self._replies), []
            return replies, self._refusal

    def misalignment(self, value: Estimate | None) -> Misalignment:
        """Return the message that the machine's last estimate came from; NaN where there is none."""
        felt, message = self._felt
        return message if value is not None and value is felt else _unknown()

    def contactor(self, wanted: bool, closed: bool) -> None:
        """Renew the lease while `wanted`, ten times a second; open at once when it no longer is."""
        now = time.monotonic()
        changed, self._wanted = wanted != self._wanted, wanted
        if changed:
            with self._lock:
                self._refusal = ""
        if not (changed or ((wanted or closed) and now - self._renewed >= _RENEWAL)):
            return
        self._renewed = now
        if not self._contactor.service_is_ready():
            if wanted:
                with self._lock:
                    self._refusal = "no node serves set_contactor"
            return
        message = SetContactor.Request(close=wanted, holder=_HOLDER, lease=duration(LEASE))
        self._contactor.call_async(message).add_done_callback(lambda done: self._contactor_answer(wanted, done))

    def _contactor_answer(self, wanted: bool, done: Any) -> None:
        try:
            answer = done.result()
        except Exception:  # as in `_answer`; a renewal that got no answer lapses by itself
            return
        if wanted and self._wanted and answer is not None and not answer.success:
            with self._lock:
                self._refusal = answer.message

    def _answer(self, request: Request, done: Any) -> None:
        try:
            answer = done.result()
        except Exception as error:  # a service that fails in its node must not end docking's executor
            self._put(Reply(request.number, False, str(error)))
            return
        reply = Reply(request.number, answer.success, answer.message)
        if answer.success and request.service is Service.ESTIMATE:
            felt = estimate(answer.misalignment)
            self._felt = felt, answer.misalignment
            reply = Reply(request.number, True, answer.message, estimate=felt)
        elif answer.success and request.service is Service.PROBE:
            reply = Reply(
                request.number,
                True,
                answer.message,
                resistance=answer.resistance,
                target_voltage=answer.target_voltage,
            )
        elif answer.success and request.service is Service.DETECT:
            seen = answer.detection
            point = seen.pose.pose.position
            stddev = math.sqrt(max(seen.pose.covariance[35], 0.0))
            found = Detection((point.x, point.y, point.z), seen.roll, stddev, self._age(seen.header.stamp))
            reply = Reply(request.number, True, answer.message, detection=found)
        self._put(reply)

    def _put(self, reply: Reply) -> None:
        with self._lock:
            self._replies.append(reply)


def estimate(message: Misalignment) -> Estimate:
    """Return the plain values of a Misalignment."""
    return Estimate(
        message.angle,
        message.angle_stddev,
        message.vertical,
        message.vertical_stddev,
        message.horizontal,
        message.horizontal_stddev,
        message.contact,
        message.sure,
        message.in_range,
    )


def _unknown() -> Misalignment:
    """Return a message that says nothing was felt."""
    message = Misalignment()
    message.header.frame_id = "end_effector"
    for name in ("angle", "vertical", "horizontal"):
        setattr(message, name, math.nan)
        setattr(message, f"{name}_stddev", math.nan)
    message.left_force = message.right_force = math.nan
    return message


def duration(seconds: float) -> Duration:
    """Return s as a Duration."""
    whole = math.floor(seconds)
    return Duration(sec=int(whole), nanosec=int((seconds - whole) * 1e9))


def seconds(value: Duration) -> float:
    """Return a Duration in s."""
    return float(value.sec) + float(value.nanosec) * 1e-9


def trajectory(waypoints: Sequence[Waypoint], stamp: Any) -> JointTrajectory:
    """Return waypoints as a JointTrajectory whose efforts (N·m) bound each servo's torque.

    The velocities are for whoever interpolates with them; servo_node goes straight from point to point, and they are
    dense enough for that.
    """
    message = JointTrajectory(joint_names=list(JOINTS))
    message.header.stamp = stamp
    message.points = [
        JointTrajectoryPoint(
            positions=array("d", point.angles),
            velocities=array("d", point.velocities or ()),
            effort=array("d", point.torque_bound),
            time_from_start=duration(point.time),
        )
        for point in waypoints
    ]
    return message


def electrodes(message: PoseStamped, base_frame: str, base_pose: Sequence[float]) -> Detection | None:
    """Return a goal's electrodes in charger_base; None for an empty frame_id (ask the camera).

    Args:
        message: pose of the electrodes' midpoint, orientation = that of charger_base turned by the roll about its z.
        base_frame: name of the robot's frame.
        base_pose: x, y, z (m) and quaternion x, y, z, w of charger_base in it.

    Raises:
        Rejected: unknown frame, or a pose that is not finite.
    """
    frame = message.header.frame_id
    if not frame:
        return None
    if frame not in ("charger_base", base_frame):
        raise Rejected(f"unknown frame '{frame}': give charger_base, {base_frame}, or '' to use the camera")
    position, rotation = _matrix(message.pose)
    if not np.isfinite(position).all() or not np.isfinite(rotation).all():
        raise Rejected("the electrodes' pose is not finite; send numbers, or an empty frame_id to use the camera")
    if frame == base_frame:
        turn = _rotation(np.asarray(base_pose[3:], dtype=np.float64))
        position = turn.T @ (position - np.asarray(base_pose[:3]))
        rotation = turn.T @ rotation
    point: Vector = (float(position[0]), float(position[1]), float(position[2]))
    return Detection(point, math.atan2(rotation[1, 0], rotation[0, 0]))


def pose_stamped(position: Vector | None, stamp: Any) -> PoseStamped:
    """Return a position in charger_base as a pose; an empty frame_id for None."""
    message = PoseStamped()
    if position is not None:
        message.header.stamp = stamp
        message.header.frame_id = "charger_base"
        message.pose.position.x, message.pose.position.y, message.pose.position.z = position
    return message


def _matrix(pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    quaternion = pose.orientation
    turn = _rotation(np.array([quaternion.x, quaternion.y, quaternion.z, quaternion.w]))
    return np.array([pose.position.x, pose.position.y, pose.position.z]), turn


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """Return the rotation matrix of a quaternion (x, y, z, w) of any length; NaN for a zero one."""
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y, z, w = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
