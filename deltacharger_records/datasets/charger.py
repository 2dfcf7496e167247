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
from rclpy.serialization import deserialize_message
from std_srvs.srv import Trigger

from deltacharger_core.mcap_file import Raw, RecordingError
from deltacharger_docking.codes import TactileStale
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockingOutcome, Observation, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros import messages as io
from deltacharger_docking.ros.inputs import Inputs
from deltacharger_docking.ros.services import Services
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_records.datasets.arm_client import ArmError, ArmGuest
from deltacharger_records.datasets.journal import Docking, Journal, Settings
from deltacharger_records.datasets.session import NotKept, Part, Rested, TouchSession
from deltacharger_records.node_parameters import docking_settings
from deltacharger_records.raw_topics import listen
from deltacharger_records.recording import mcap_recording
from deltacharger_ros.clock import before_now
from deltacharger_ros.log import Log
from deltacharger_ros.qos import SERVICE

_RECORDED = ("tactile_frame", "servo_state", "charger_power", mcap_recording.STATE)
TOPICS = tuple(topic for topic in mcap_recording.TOPICS if topic.name in _RECORDED)
"""Topics recorded of each docking, as received."""
_SIDE = 10  # taxels
_TICK = 0.02  # s; loop period while servo_state is missing
_ANSWER = 5.0  # s for a service
_SETTLED = 2.0  # s until discovery knows the names of other nodes
_LATE = 3.0  # s that discovery of docking_node may take beyond the other nodes
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
_TERMINALS = "/dev/pts/"


class Tape:
    """Collects the messages of one docking at a time. `take` may be called from any thread.

    Args:
        latched: topic that publishes changes only; its last message before a docking belongs to it.
    """

    def __init__(self, latched: str) -> None:
        self.messages: list[Raw] = []
        self._latched = latched
        self._last: Raw | None = None
        self._rolling = False
        self._lock = threading.Lock()

    def take(self, message: Raw) -> None:
        """Append a message during a docking."""
        with self._lock:
            if message.topic == self._latched:
                self._last = message
            if self._rolling:
                self.messages.append(message)

    def start(self) -> None:
        """Begin a docking."""
        with self._lock:
            self.messages = [] if self._last is None else [self._last]
            self._rolling = True

    def stop(self) -> list[Raw]:
        """Return the messages since `start`."""
        with self._lock:
            self._rolling = False
            return self.messages


class SessionKeeper:
    """A `Keeper` that writes the dockings of one session into a journal.

    Args:
        journal: to write into.
        part: of the recording.
        settings: as passed to the journal's `check`.
        numbers: of the part's poses, in the session's order.
        tape: that receives the topics.
        names: full name of each topic by its relative one.
        now: the ROS clock, ns.
        report: called with each docking after it is on the disk.

    Attributes:
        count: dockings on the disk.
    """

    def __init__(
        self,
        journal: Journal,
        part: Part,
        settings: Settings,
        numbers: Sequence[int],
        tape: Tape,
        names: dict[str, str],
        now: Callable[[], int],
        report: Callable[[Docking], None],
    ) -> None:
        self.count = 0
        self._journal, self._part, self._settings = journal, part, settings
        self._numbers, self._poses = numbers, part.poses()
        self._tape, self._now, self._report = tape, now, report
        self._tactile = names["tactile_frame"]
        self._topics = {names[topic.name]: topic for topic in TOPICS}
        self._session = journal.next_session
        self._number = 0
        self._since = 0
        self._looked = 0
        self._frames: list[NDArray[np.float32]] = []
        self._writer = ThreadPoolExecutor(1, "writer")
        self._writing: Future[Docking] | None = None

    def begin(self, number: int) -> None:
        """Start the tape."""
        self._number = self._numbers[number]
        self._tape.start()

    def start_frames(self) -> None:
        """Count only frames sampled from now on."""
        self._since, self._looked, self._frames = self._now(), len(self._tape.messages), []

    def has_frames(self) -> bool:
        """Take the new frames; TactileStale if they are unusable."""
        messages, wanted = self._tape.messages, self._settings.frames * self._settings.rows
        while self._looked < len(messages) and len(self._frames) < wanted:
            message = messages[self._looked]
            self._looked += 1
            if message.topic == self._tactile:
                frame = deserialize_message(message.data, TactileFrame)
                stamp = frame.header.stamp
                if stamp.sec * 1_000_000_000 + stamp.nanosec > self._since:
                    self._frames.append(_pads(frame))
        return len(self._frames) >= wanted

    def keep(self, touch: Rested) -> None:
        """Write the docking in a separate thread."""
        pose, target = self._poses[self._number], self._part.target
        shape = (self._settings.rows, self._settings.frames, 2, _SIDE, _SIDE)
        docking = Docking(
            attempt=self._journal.next_attempt,
            session=self._session,
            part=self._part.name,
            number=self._number,
            horizontal=pose.horizontal,
            vertical=pose.vertical,
            angle=pose.angle,
            x=target[0] - touch.position[0],
            y=target[1] - touch.position[1],
            current=touch.current,
            time=time.time(),
            frames=np.stack(self._frames).reshape(shape).mean(axis=1),
        )
        self._writing = self._writer.submit(self._write, docking, self._tape.stop())

    def kept(self) -> bool:
        """Whether it is on the disk; NotKept if it cannot be written."""
        if self._writing is None:
            return True
        if not self._writing.done():
            return False
        writing, self._writing = self._writing, None
        try:
            docking = writing.result()
        except (OSError, RecordingError) as error:
            raise NotKept(f"the docking cannot be written: {error}") from error
        self.count += 1
        self._report(docking)
        return True

    def close(self) -> None:
        """Wait for the writing thread; NotKept as in `kept`."""
        self._writer.shutdown()
        self.kept()

    def _write(self, docking: Docking, messages: Sequence[Raw]) -> Docking:
        self._journal.store(docking, self._part, self._settings, self._topics, messages)
        return docking


def _pads(frame: TactileFrame) -> NDArray[np.float32]:
    """Return both pads (2, 10, 10), N.

    Raises:
        TactileStale: they have another shape, or are no longer tared.
    """
    pads = (frame.left, frame.right)
    if (frame.rows, frame.columns) != (_SIDE, _SIDE) or {len(pad) for pad in pads} != {_SIDE * _SIDE}:
        raise TactileStale(f"tactile_frame is {frame.rows} × {frame.columns}; data sets hold {_SIDE} × {_SIDE}")
    if not frame.tared:
        raise TactileStale("the frames are no longer tared because the board has restarted: check its supply")
    return np.array(pads, dtype=np.float32).reshape(2, _SIDE, _SIDE)


class RecordingCharger(ArmGuest):
    """Drives a charger through recording sessions.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        stop: ends a session, and every wait, when set; the arm is retracted first.

    Attributes:
        tape: receives all topics of `names`.
        names: full name of each topic by its relative one.
        is_driving: whether this program may have switched the torque on.
    """

    def __init__(self, context: Context, namespace: str = "", stop: threading.Event | None = None) -> None:
        super().__init__("recording", context, namespace, stop)
        self._machine: DockingMachine | None = None
        self.is_driving = False
        self.names = {topic.name: self.node.resolve_topic_name(topic.name) for topic in TOPICS}
        self.tape = Tape(self.names["docking_state"])
        self._inputs = Inputs(self.node, Log(self.node))
        self._calls = Services(self.node)
        listen(self.node, TOPICS, self.tape.take)
        self._tare: Any = self.node.create_client(Trigger, "tare", qos_profile=SERVICE)
        self.serve()

    @property
    def name(self) -> str:
        """Name of the node that drives the arm."""
        return str(self.node.get_name())

    @property
    def has_docking_node(self) -> bool:
        """Whether docking_state has a publisher."""
        return bool(self.node.count_publishers("docking_state"))

    def now(self) -> int:
        """The ROS clock, ns."""
        return int(self.node.get_clock().now().nanoseconds)

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
                raise ArmError("interrupted")
            missing = ", ".join(name for name, is_there in needs.items() if not is_there())
            raise ArmError(
                f"charger does not answer (missing: {missing}): start one with `deltacharger up`, in this ROS domain"
            )
        self._wait(lambda: self._docking is not None, _LATE)

    def settings(self) -> tuple[DockingParameters, DeltaGeometry]:
        """Return docking_node's parameters, or the defaults without docking_node; call `wait_until_ready` first.

        Raises:
            ArmError: docking_node does not report its parameters, or they cannot be used on this computer.
        """
        if not self.has_docking_node:
            return DockingParameters(), DeltaGeometry()
        values = self._ask("docking_node")
        if not values:
            raise ArmError("docking_node does not report its parameters: check its log and its version")
        try:
            return docking_settings(values)
        except (OSError, ValueError, TypeError) as error:
            raise ArmError(
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

    def claim(self, previous: str) -> bool:
        """Refuse an arm that another program moves; return whether `previous` left the torque on.

        This program must then switch that torque off.

        Args:
            previous: name of the node that was killed while it drove the arm; '' = none.

        Raises:
            ArmError: docking_node is at work or docked, or another program moves the arm or switched its torque on.
        """
        self._check_free()
        topic = self.node.resolve_topic_name("joint_trajectory")

        def others() -> set[str]:
            return {info.node_name for info in self.node.get_publishers_info_by_topic(topic)}

        self._wait(lambda: _UNKNOWN not in others(), _SETTLED)
        # Discovery lists a dead program without a name; live ones have names.
        unwanted = others() - {"docking_node", self.name, previous, _UNKNOWN}
        if unwanted:
            raise ArmError(f"another program moves the arm ({', '.join(sorted(unwanted))}): stop it")
        if not self._observe().torque_enabled:
            return False
        if not previous:
            raise ArmError("torque is already on, so another program moves the arm: stop that program")
        self.is_driving = True
        return True

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
        replies, _ = self._calls.take()
        return self._inputs.observation(replies)

    def _carry_out(self, command: Command, observation: Observation) -> None:
        if command.trajectory is not None:
            # Not the instant of sending: planning a line takes milliseconds, and times count from the observation.
            stamp = before_now(self.node.get_clock(), time.monotonic() - observation.time)
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
