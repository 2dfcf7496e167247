# SPDX-License-Identifier: Apache-2.0
"""Move the arm of a running charger without docking_node: for measurements, not for docking.

The clients subscribe to servo_state and docking_state, publish joint_trajectory, and call set_torque. They never move
the arm while docking_node serves a goal or is docked. `MeasuringArm` measures servos: its goals are whole ticks, its
angles and currents unfiltered.
"""

import dataclasses
import math
import secrets
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from deltacharger.msg import DockingState, ServoState
from rclpy.context import Context
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from deltacharger_bringup.records.node_parameters import ParameterReader
from deltacharger_core import machine, servo_types
from deltacharger_core.ros import qos
from deltacharger_core.ros.client import Guest
from deltacharger_docking import arm, codes
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros.messages import trajectory
from deltacharger_kinematics import DeltaGeometry, scalar, trajectory_feed
from deltacharger_kinematics.calibration import data, servo_fit
from deltacharger_kinematics.geometry import Vector

SPEED = 0.06  # m/s, peak; a person may stand close by
STILL = 2.5 * data.TICK  # rad; an arm whose angles vary by less is at rest
_WINDOW = 0.5  # s over which it must be at rest, and over which its angles are averaged
_FEWEST = 10  # messages in that window
_SILENCE = 1.0  # s without servo_state
_STANDSTILL = 5.0  # s after the end of a motion
_ANSWER = 5.0  # s for a service
_LATE = 0.03  # s until a goal reaches the servos: transport and one bus cycle
_PATIENCE = 2.0  # s that a reading may wait beyond its end for its first message


class ArmError(RuntimeError):
    """The arm cannot be moved, or no longer; the message states why and what to do."""


class ArmGuest(Guest, ABC):
    """Reads docking_state; publishes joint_trajectory and calls set_torque while docking_node does not use the arm.

    Args:
        name: prefix of the node's name.
        context: a running rclpy context.
        namespace: of the charger.
        stop: ends every wait when set.
    """

    def __init__(self, name: str, context: Context, namespace: str, stop: threading.Event | None) -> None:
        super().__init__(name, context, namespace)
        self._stop = stop or threading.Event()
        self._docking: DockingState | None = None
        self.node.create_subscription(DockingState, "docking_state", self._on_docking_state, qos.STATE)
        self._publisher = self.node.create_publisher(JointTrajectory, "joint_trajectory", qos.LATEST)
        self._torque: Any = self.node.create_client(SetBool, "set_torque", qos_profile=qos.SERVICE)

    def close(self) -> None:
        """Stop the arm, switch off the torque that this program switched on, and destroy the node. Safe to call twice.

        If docking_node has started a goal, it controls arm and torque, and they stay as they are.
        """
        if not self._open:
            return
        try:
            if not self._is_taken():
                self._release_arm()
        finally:
            super().close()

    @abstractmethod
    def _release_arm(self) -> None:
        """Stop the arm and switch off the torque if this program drives it."""

    def _is_docking_known(self) -> bool:
        """Whether docking_node has published its state, or no docking_node runs."""
        return self._docking is not None or not self.node.count_publishers("docking_state")

    def _ask(self, name: str) -> dict[str, Any]:
        """Return a node's parameters; empty if it does not answer."""
        reader, answers = ParameterReader(self.node, name), list[dict[str, Any]]()
        if self._wait(reader.is_ready, _ANSWER):
            reader.ask(answers.append)
            self._wait(lambda: bool(answers), _ANSWER)
        return answers[0] if answers else {}

    def _is_taken(self) -> bool:
        docking = self._docking
        return docking is not None and (docking.state != DockingState.STATE_IDLE or docking.docked or docking.charging)

    def _check_free(self) -> None:
        if self._is_taken():
            raise ArmError(
                "docking_node is at work or docked and controls the arm: wait until it has finished, or run "
                "`deltacharger undock`"
            )

    def _on_docking_state(self, message: DockingState) -> None:
        self._docking = message

    def _wait(
        self,
        condition: Callable[[], bool],
        timeout: float,
        check: Callable[[], None] | None = None,
        patient: bool = False,
    ) -> bool:
        """Wait for `condition` and call `check` at each poll; unless `patient`, stop waiting when `stop` is set."""
        return self.wait(condition, timeout, check, None if patient else self._stop)


class ArmClient(ArmGuest):
    """Moves the platform from pose to pose and reads the arm's angles at rest.

    Args:
        context: a running rclpy context.
        geometry: converts positions to angles.
        namespace: of the charger.
        stop: ends every wait with ArmError when set.

    Attributes:
        is_released: whether servo_node has switched off the torque that this program switched on.
    """

    def __init__(
        self, context: Context, geometry: DeltaGeometry, namespace: str = "", stop: threading.Event | None = None
    ) -> None:
        super().__init__("arm_client", context, namespace, stop)
        self._planner = arm.Planner(DockingParameters(), geometry)
        self._kinematics = scalar.ScalarDelta(geometry)
        self._commanded: Vector | None = None
        self._secret = secrets.token_hex(16)  # identifies this program to servo_node
        self._switched_on = self.is_released = False
        self._lock = threading.Lock()
        self._state: ServoState | None = None
        self._angles: deque[tuple[float, tuple[float, ...]]] = deque()
        self._heard = -math.inf
        self.node.create_subscription(ServoState, "servo_state", self._on_servo_state, qos.LATEST)
        self.serve()

    def wait_until_ready(self, timeout: float) -> None:
        """Wait for servo_state, servo_node's service and, if docking_node runs, its state.

        Raises:
            ArmError: one of them is missing after `timeout` s.
        """

        def ready() -> bool:
            heard = self._publisher.get_subscription_count() > 0 and self._torque.service_is_ready()
            return self._is_docking_known() and heard and len(self._window()) >= _FEWEST

        if not self._wait(ready, timeout):
            raise ArmError("servo_node does not answer: start the charger with `deltacharger up`, in this ROS domain")

    def encoder(self) -> data.Encoder | None:
        """Return servo_node's encoder parameters; None if it does not answer."""
        parameters = self._ask("servo_node")
        values = tuple(parameters.get(name, ()) for name in ("zero_ticks", "direction"))
        return data.Encoder(*values) if [len(value) for value in values] == [3, 3] else None

    def start(self) -> None:
        """Switch the torque on, holding the present position.

        Raises:
            ArmError: another program moves the arm, or the servos refuse the torque.
        """
        self._check_free()
        if any(self._servo_state().torque_enabled):
            raise ArmError(
                "torque is already on, so another program moves the arm: stop that program, or `deltacharger undock`"
            )
        self._switched_on = True
        problem = self._call_torque(True)
        if problem:
            raise ArmError(f"servo_node did not switch the torque on: {problem}")
        if not self._wait(lambda: all(self._servo_state().torque_enabled), _ANSWER):
            raise ArmError("the servos did not switch their torque on: check servo_node's diagnostics")
        self.rest()
        self._commanded = self.position()

    def move(self, goal: Vector) -> None:
        """Move to `goal` (m, charger_base) on a straight line and wait until the arm is at rest.

        Raises:
            ArmError: the line leaves the workspace, the arm does not come to rest, or it may no longer be moved.
        """
        self.check()
        try:
            waypoints = self._planner.line(self._commanded or self.position(), goal, SPEED)
        except codes.Unreachable as error:
            raise ArmError(str(error)) from error
        self._publish(waypoints)
        self._commanded = goal
        over = time.monotonic() + waypoints[-1].time + _WINDOW
        self._wait(lambda: time.monotonic() >= over, math.inf, self.check)
        self.rest()

    def rest(self) -> None:
        """Wait until no angle has moved by more than `STILL` for half a second.

        Raises:
            ArmError: it does not come to rest, or may no longer be moved.
        """
        if not self._wait(self._is_still, _STANDSTILL, self.check):
            raise ArmError("the arm does not come to rest: remove what pushes it, or reduce the servos' stiffness")

    def go_home(self) -> None:
        """Move to the rest position of docking; errors as in `move`."""
        self.move(DockingParameters().home)

    def check(self) -> None:
        """Raise ArmError if the arm may no longer be moved."""
        self._check_free()
        state = self._servo_state()
        if time.monotonic() - self._heard > _SILENCE:
            raise ArmError("servo_state has stopped: check servo_node and its cable")
        if any(state.hardware_error):
            raise ArmError(f"a servo reports hardware error {list(state.hardware_error)}; see `reboot_servos`")
        if self._commanded is not None and not all(state.torque_enabled):
            why = machine.in_words(state.stray) or "check servo_node's diagnostics"
            raise ArmError(f"the servos lost their torque: {why}")

    def angles(self) -> Vector:
        """Return the arm angles (rad), averaged over the last half second; call it after `rest`."""
        first, second, third = np.mean(self._window(), axis=0)
        return float(first), float(second), float(third)

    def position(self) -> Vector:
        """Return the platform's position (m) by forward kinematics; NaN if the angles have no solution."""
        return self._kinematics.forward(*self.angles())

    def _is_still(self) -> bool:
        angles = self._window()
        return len(angles) >= _FEWEST and float(np.ptp(angles, axis=0).max()) <= STILL

    def _release_arm(self) -> None:
        if self._switched_on:
            self._publish(())
            self.is_released = not self._call_torque(False)

    def _check_free(self) -> None:
        if self._stop.is_set():
            raise ArmError("interrupted")
        super()._check_free()

    def _servo_state(self) -> ServoState:
        if self._state is None:
            raise ArmError("no servo_state received: start servo_node")
        return self._state

    def _on_servo_state(self, message: ServoState) -> None:
        now = time.monotonic()
        with self._lock:
            self._state = message
            if len(message.position) == 3 and all(message.valid):
                self._heard = now
                self._angles.append((now, tuple(message.position)))
            while self._angles and now - self._angles[0][0] > _WINDOW:
                self._angles.popleft()

    def _window(self) -> np.ndarray:
        with self._lock:
            return np.array([angles for _, angles in self._angles])

    def _publish(self, waypoints: Any) -> None:
        self._publisher.publish(trajectory(waypoints, self.node.get_clock().now().to_msg(), self._secret))

    def _call_torque(self, on: bool) -> str:
        """Return '' if servo_node switched the torque, else the reason."""
        future = self._torque.call_async(SetBool.Request(data=on))
        if not self._wait(future.done, _ANSWER, patient=True):  # switch the torque off even when `stop` is set
            return "servo_node does not answer set_torque"
        reply = future.result()
        return "" if reply.success else str(reply.message)


class MeasuringArm(ArmClient):
    """An `ArmClient` that also implements `ServoArm`."""

    _goals: Vector | None = None
    _log: tuple[list[Vector], list[Vector]] = ([], [])  # angles (rad) and currents (A) since a reading began

    def parameters_of(self, name: str) -> dict[str, Any]:
        """Return a node's parameters; empty if it does not answer."""
        return self._ask(name)

    def start(self) -> None:
        """Switch the torque on as `ArmClient.start` does, and hold the position by known goals."""
        here = servo_fit.whole_ticks(self.angles())
        super().start()
        self._goals = here
        self._publish([trajectory_feed.Waypoint(_LATE, here, ())])  # type: ignore[arg-type]  # no bound: servo_node's own

    def clock(self) -> float:
        """Return the time, s."""
        return time.monotonic()

    def goals(self) -> Vector:
        """Return the commanded angles, rad."""
        return self._goals or servo_fit.whole_ticks(self.angles())

    def follow(self, line: Sequence[tuple[float, Vector]], bound: Vector) -> None:
        """Move the goals along a line, see `ServoArm`.

        Raises:
            ArmError: the arm may no longer be moved.
        """
        self.check()
        self._publish([trajectory_feed.Waypoint(at, servo_fit.whole_ticks(goals), bound) for at, goals in line])
        self._goals = servo_fit.whole_ticks(line[-1][1])
        over = time.monotonic() + line[-1][0] + _LATE
        self._wait(lambda: time.monotonic() >= over, math.inf, self.check)

    def read(self, seconds: float) -> servo_fit.ArmReadings:
        """Return the servo_state readings of the next `seconds`, at least one message.

        Raises:
            ArmError: the arm may no longer be moved.
        """
        with self._lock:
            self._log = [], []
            angles, currents = self._log
        over = time.monotonic() + seconds
        self._wait(lambda: time.monotonic() >= over and len(currents) > 0, seconds + _PATIENCE, self.check)
        self.check()
        with self._lock:
            return servo_fit.ArmReadings(np.array(angles).reshape(-1, 3), np.array(currents).reshape(-1, 3))

    def retire(self, stiffness: float) -> None:
        """Move to docking's rest position; `stiffness` (N·m/rad) compensates the weight; errors as in `move`."""
        known = min(max(stiffness, servo_types.STIFFNESS_MIN), servo_types.STIFFNESS_MAX)
        self._planner = arm.Planner(
            dataclasses.replace(DockingParameters(), servo_stiffness=known), self._kinematics.geometry
        )
        self._commanded = self.position()
        self.go_home()

    def _on_servo_state(self, message: ServoState) -> None:
        super()._on_servo_state(message)
        if len(message.position) == len(message.current) == 3 and all(message.valid):
            with self._lock:
                angles, currents = self._log
                angles.append(tuple(message.position))
                currents.append(tuple(message.current))
