# SPDX-License-Identifier: Apache-2.0
"""Drive a running charger through a recording, and read docking_node's parameters and state.

It subscribes to docking_node's topics, publishes joint_trajectory, and calls set_torque and tare. It calls nothing
else, so the contactor stays open. It never moves the arm while docking_node serves a goal or is docked.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.context import Context
from std_srvs.srv import Trigger

from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockingOutcome, Observation, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros import messages as io
from deltacharger_docking.ros.inputs import Inputs
from deltacharger_docking.ros.services import Services
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_records.datasets.arm_guest import ArmError, ArmGuest
from deltacharger_records.datasets.keeper import TOPICS, Tape
from deltacharger_records.datasets.session import TouchSession
from deltacharger_records.node_parameters import docking_settings
from deltacharger_ros.clock import before_now
from deltacharger_ros.log import Log
from deltacharger_ros.qos import SERVICE
from deltacharger_ros.raw_topics import listen

_TICK = 0.02  # s; loop period while servo_state is missing
_ANSWER = 5.0  # s for a service
_SETTLED = 2.0  # s until discovery knows the names of other nodes
_LATE = 3.0  # s that discovery of docking_node may take beyond the other nodes
_UNKNOWN = "_NODE_NAME_UNKNOWN_"
_TERMINALS = "/dev/pts/"


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
