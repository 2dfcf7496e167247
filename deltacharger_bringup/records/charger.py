# SPDX-License-Identifier: Apache-2.0
"""Drive a running charger through a recording, and make dockings in a journal from its topics.

It reads docking_node's parameters and state, subscribes to docking_node's topics, publishes joint_trajectory, and calls
set_torque and tare. It calls nothing else, so the contactor stays open. It never moves the arm while docking_node
serves a goal or is docked.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
from deltacharger.msg import TactileFrame
from numpy.typing import NDArray
from rclpy.context import Context
from std_srvs.srv import Trigger

from deltacharger_bringup.records import arm_client, node_parameters
from deltacharger_bringup.records.session import Docking, Journal, NotKept, Part, Rested, Settings, TouchSession
from deltacharger_core.frames import TransformParameters
from deltacharger_core.ros import clock, log, qos
from deltacharger_docking import codes, parameters
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockingOutcome, Observation, Request, Service
from deltacharger_docking.ros import inputs, messages as io, services
from deltacharger_kinematics.geometry import DeltaGeometry

_SIDE = 10  # taxels
_TICK = 0.02  # s; loop period while servo_state is missing
_ANSWER = 5.0  # s for a service
_SETTLED = 2.0  # s until discovery knows the names of other nodes
_LATE = 3.0  # s that discovery of docking_node may take beyond the other nodes
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
_TERMINALS = "/dev/pts/"


class SessionKeeper:
    """A `Keeper` that writes the dockings of one session into a journal.

    Args:
        charger: that makes the dockings.
        journal: to write into.
        part: of the recording.
        settings: as passed to the journal's `check`.
        numbers: of the part's poses, in the session's order.
        report: called with each docking after it is on the disk.
    """

    def __init__(
        self,
        charger: RecordingCharger,
        journal: Journal,
        part: Part,
        settings: Settings,
        numbers: Sequence[int],
        report: Callable[[Docking], None],
    ) -> None:
        self._charger, self._journal, self._part, self._settings = charger, journal, part, settings
        self._numbers, self._poses, self._report = numbers, part.poses(), report
        self._session = journal.next_session
        self._number = 0
        self._frames: list[NDArray[np.float32]] = []
        self._writer = ThreadPoolExecutor(1, "writer")
        self._writing: Future[Docking] | None = None

    def begin_docking(self, number: int) -> None:
        """Note which docking begins."""
        self._number = self._numbers[number]

    def start_frames(self) -> None:
        """Count only frames sampled from now on."""
        self._frames = []
        self._charger.start_frames()

    def has_frames(self) -> bool:
        """Take the new frames; TactileStale if they are unusable."""
        wanted, frames = self._settings.frames, self._charger.frames
        self._frames += [_pads(frame) for frame in frames[len(self._frames) : wanted]]
        return len(self._frames) == wanted

    def keep(self, touch: Rested) -> None:
        """Write the docking in a separate thread."""
        target = self._part.target
        docking = Docking(
            number=self._number,
            session=self._session,
            pose=self._poses[self._number],
            x=target[0] - touch.position[0],
            y=target[1] - touch.position[1],
            current=touch.current,
            pads=np.mean(self._frames, axis=0),
        )
        self._writing = self._writer.submit(self._write, docking)

    def kept(self) -> bool:
        """Whether it is on the disk; NotKept if it cannot be written."""
        if self._writing is None:
            return True
        if not self._writing.done():
            return False
        writing, self._writing = self._writing, None
        try:
            self._report(writing.result())
        except OSError as error:
            raise NotKept(f"the docking cannot be written: {error}") from error
        return True

    def close(self) -> None:
        """Wait for the writing thread; NotKept as in `kept`."""
        self._writer.shutdown()
        self.kept()

    def _write(self, docking: Docking) -> Docking:
        self._journal.add_docking(docking, self._part, self._settings)
        return docking


def _pads(frame: TactileFrame) -> NDArray[np.float32]:
    """Return both pads (2, 10, 10), N.

    Raises:
        TactileStale: they have another shape, or are no longer tared.
    """
    pads = (frame.left, frame.right)
    if (frame.rows, frame.columns) != (_SIDE, _SIDE) or {len(pad) for pad in pads} != {_SIDE * _SIDE}:
        raise codes.TactileStale(f"tactile_frame is {frame.rows} × {frame.columns}; data sets hold {_SIDE} × {_SIDE}")
    if not frame.tared:
        raise codes.TactileStale("the frames are no longer tared because the board has restarted: check its supply")
    return np.array(pads, dtype=np.float32).reshape(2, _SIDE, _SIDE)


class RecordingCharger(arm_client.ArmGuest):
    """Drives a charger through recording sessions.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        stop: ends a session, and every wait, when set; the arm is retracted first.

    Attributes:
        frames: the pads' frames sampled since `start_frames`.
        is_driving: whether this program may have switched the torque on.
    """

    def __init__(self, context: Context, namespace: str = "", stop: threading.Event | None = None) -> None:
        super().__init__("recording", context, namespace, stop)
        self._machine: DockingMachine | None = None
        self.is_driving = False
        self.frames: list[TactileFrame] = []
        self._since = math.inf  # ns by the ROS clock
        self._inputs = inputs.Inputs(self.node, log.Log(self.node))
        self._calls = services.Services(self.node, TransformParameters())
        self.node.create_subscription(TactileFrame, "tactile_frame", self._on_frame, qos.SENSOR)
        self._tare: Any = self.node.create_client(Trigger, "tare", qos_profile=qos.SERVICE)
        self.serve()

    @property
    def has_docking_node(self) -> bool:
        """Whether docking_state has a publisher."""
        return bool(self.node.count_publishers("docking_state"))

    def start_frames(self) -> None:
        """Collect the frames sampled from now on."""
        self.frames, self._since = [], int(self.node.get_clock().now().nanoseconds)

    def _on_frame(self, message: TactileFrame) -> None:
        stamp = message.header.stamp
        if stamp.sec * 1_000_000_000 + stamp.nanosec > self._since:
            self.frames.append(message)

    def wait_until_ready(self, timeout: float) -> None:
        """Wait for the charger's topics and services and, if docking_node runs, its state.

        Raises:
            ArmError: names what is missing after `timeout` s.
        """
        needs: dict[str, Callable[[], bool]] = {
            "servo_node": lambda: self._torque.service_is_ready() and math.isfinite(self._observe().servo_age),
            "tactile_node": lambda: self._tare.service_is_ready() and math.isfinite(self._observe().tactile_age),
            "a subscriber of joint_trajectory": lambda: self._publisher.get_subscription_count() > 0,
            "docking_state": self._is_docking_known,
        }
        if not self._wait(lambda: all(is_there() for is_there in needs.values()), timeout):
            if self._stop.is_set():
                raise arm_client.ArmError("interrupted")
            missing = ", ".join(name for name, is_there in needs.items() if not is_there())
            raise arm_client.ArmError(
                f"charger does not answer (missing: {missing}): start one with `deltacharger up`, in this ROS domain"
            )
        self._wait(lambda: self._docking is not None, _LATE)

    def settings(self) -> tuple[parameters.DockingParameters, DeltaGeometry]:
        """Return docking_node's parameters, or the defaults without docking_node; call `wait_until_ready` first.

        Raises:
            ArmError: docking_node does not report its parameters, or they cannot be used on this computer.
        """
        if not self.has_docking_node:
            return parameters.DockingParameters(), DeltaGeometry()
        values = self._ask("docking_node")
        if not values:
            raise arm_client.ArmError("docking_node does not report its parameters: check its log and its version")
        try:
            return node_parameters.docking_settings(values)
        except (OSError, ValueError, TypeError) as error:
            raise arm_client.ArmError(
                f"docking_node's parameters cannot be used here: {error}; run the command on the charger's computer, "
                "with its version"
            ) from error

    def simulated(self) -> bool | None:
        """Whether the charger is simulated: its ports are pseudo-terminals, or its nodes are mocks without ports.

        None if unknown: the ports are on another computer, or their nodes do not answer.
        """
        found: list[bool | None] = []
        for name in ("servo_node", "tactile_node"):
            values = self._ask(name)
            if not values:
                found.append(None)
            elif "port" not in values:
                found.append(True)
            else:
                path = os.path.realpath(str(values["port"]))
                found.append(path.startswith(_TERMINALS) if os.path.exists(path) else None)
        return True if True in found else None if None in found else False

    def claim(self) -> None:
        """Refuse an arm that another program moves.

        Raises:
            ArmError: docking_node is at work or docked, or another program moves the arm or switched its torque on.
        """
        self._check_free()
        topic = self.node.resolve_topic_name("joint_trajectory")

        def others() -> set[str]:
            return {info.node_name for info in self.node.get_publishers_info_by_topic(topic)}

        self._wait(lambda: _UNKNOWN not in others(), _SETTLED)
        # Discovery lists a dead program without a name; live ones have names.
        unwanted = others() - {"docking_node", self.node.get_name(), _UNKNOWN}
        if unwanted:
            raise arm_client.ArmError(f"another program moves the arm ({', '.join(sorted(unwanted))}): stop it")
        if self._observe().torque_enabled:
            raise arm_client.ArmError(
                "torque is already on, so another program moves the arm: stop that program, or `deltacharger undock`"
            )

    def run(self, machine: DockingMachine, session: TouchSession) -> DockingOutcome:
        """Run a session to its end.

        Args:
            machine: of the arm, without a goal.
            session: to run.

        Returns:
            The outcome; the arm is home and its torque off, if the charger still permits it.

        Raises:
            ArmError: docking_node took control of the arm.
        """
        self._machine = machine
        self._check_free()
        machine.start(session.run, self._observe())
        while machine.outcome is None:
            self._inputs.wait(_TICK)
            if self._is_taken():
                machine.emergency()  # its command is not executed: docking_node controls the arm
                self._machine, self.is_driving = None, False
                self._check_free()
            if self._stop.is_set():
                machine.cancel()
            observation = self._observe()
            self._carry_out(machine.step(observation), observation)
        outcome, machine.outcome = machine.outcome, None
        self.is_driving = not self._wait_for_torque_off()
        return outcome

    def _observe(self) -> Observation:
        replies, _ = self._calls.take_replies()
        return self._inputs.observation(replies)

    def _carry_out(self, command: Command, observation: Observation) -> None:
        if command.trajectory is not None:
            # Not the instant of sending: planning a line takes milliseconds, and times count from the observation.
            stamp = clock.before_now(self.node.get_clock(), time.monotonic() - observation.time)
            self._publisher.publish(io.trajectory(command.trajectory, stamp))
        for request in command.requests:
            self.is_driving = self.is_driving or request.service is Service.TORQUE_ON
            self._calls.call(request)

    def _release_arm(self) -> None:
        """Stop the arm; switch its torque off unless the contactor is closed: a limp arm could part live electrodes."""
        if not self.is_driving:
            return
        observation = self._observe()
        if self._machine is not None:
            self._carry_out(self._machine.emergency(), observation)
        if not observation.contactor_closed:
            self._calls.call(Request(0, Service.TORQUE_OFF))
            self.is_driving = not self._wait_for_torque_off()

    def _wait_for_torque_off(self) -> bool:
        return self._wait(lambda: not self._observe().torque_enabled, _ANSWER, patient=True)
