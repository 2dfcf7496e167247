# SPDX-License-Identifier: Apache-2.0
"""docking_node: the actions dock and undock over the docking state machine.

Subscribes to servo_state, tactile_frame, charger_power. Calls set_torque, tare, probe, set_contactor,
predict_misalignment and detect_electrodes. Publishes joint_trajectory, docking_state, docking_decision and
/diagnostics. One thread, paced by servo_state, steps the machine, publishes its commands and renews the contactor's
lease. If that thread hangs, the lease lapses.
"""

from __future__ import annotations

import contextlib
import math
import secrets
import threading
import time
from collections.abc import Sequence
from typing import Any

from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core import runtime
from deltacharger_core.environment import package_version
from deltacharger_core.frames import END_EFFECTOR, TransformParameters
from deltacharger_docking.codes import Canceled, Code, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockingOutcome, Observation, Request, Service
from deltacharger_docking.parameters import DockingNodeParameters, DockingParameters, ProfileNames, TargetProfile
from deltacharger_docking.ros import messages as io
from deltacharger_docking.ros.goals import Goals
from deltacharger_docking.ros.inputs import Inputs
from deltacharger_docking.ros.reports import Reports
from deltacharger_docking.ros.services import Services
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_kinematics.parameters import GeometryFileParameters
from deltacharger_ros import node_support, qos
from deltacharger_ros.clock import before_now
from deltacharger_ros.frames import Frames
from deltacharger_ros.log import Log
from deltacharger_ros.parameters import declare_all, declare_file, declare_with_servos, reject_unknown
from deltacharger_ros.tuning import Tuning

_SERVOS_FOLLOW = {"servo_stiffness": "stiffness", "torque_constant": "torque_constant"}  # names in servos_file
_TICK = 0.02  # s; period without servo_state
_LOOK, _LOOK_AT_REST = 0.5, 1.0  # s between checks for second sources; each check takes 0.1 ms
_OPEN_TIMEOUT = 0.6  # s for the contactor to open when the node closes
_TORQUE_DELAY = 0.5  # s from opening after a defect to torque off
_LAST_REQUEST = -1  # number of the final request to switch the torque off
_SHUTTING_DOWN = "the charger is shutting down"
_TORQUE_TIMEOUT = 1.0  # s for the torque to go off; servo_node takes 0.3 s at most


class DockingNode(Node):
    """Serves dock and undock; topics and services in the module docstring, parameters in docs/parameters.md.

    Args:
        held: command and publish nothing, and queue goals, until `release`.
        kwargs: of rclpy's Node.
    """

    def __init__(self, held: bool = False, **kwargs: Any) -> None:
        self._closed = True  # nothing to make safe before the node is complete and released
        super().__init__("docking_node", **kwargs)
        robot, transforms = declare_all(self, DockingNodeParameters), declare_all(self, TransformParameters)
        defaults = DockingParameters.of(robot.servo)
        self._settings = declare_with_servos(self, defaults, _SERVOS_FOLLOW, form="{text}, {unit}")
        geometry = declare_file(self, GeometryFileParameters, load_geometry) or DeltaGeometry()
        names = declare_all(self, ProfileNames).target_profiles
        profiles = {name: declare_all(self, TargetProfile, prefix=f"{name}.") for name in names}
        reject_unknown(self)
        self._frames = frames = Frames(self, transforms, robot.base_frame, robot.base_pose)
        self._targets = ", ".join(profiles) or "none, so it charges nothing (docs/targets.md)"
        self._machine = DockingMachine(self._settings, geometry, profiles=profiles)
        self._lock = threading.RLock()
        self._log = Log(self)
        self._stopping = threading.Event()
        self._torque_off_at = math.inf
        self._slowest_tick = 0.0
        self._inputs = Inputs(self, self._log)
        self._calls = Services(
            self, lambda detection: io.in_charger_base(detection, frames), transforms.named(END_EFFECTOR)
        )
        self._secret = secrets.token_hex(16)  # shows servo_node that this process sends the trajectories
        self._trajectory = self.create_publisher(JointTrajectory, "joint_trajectory", qos.LATEST)
        ages_max = (self._settings.servo_age_max, self._settings.tactile_age_max, self._settings.power_age_max)
        self._reports = Reports(self, self._log, ages_max, frames.charger_base)
        observe = self._inputs.observation  # leaves the replies for the running goal
        self._goals = Goals(
            self,
            self._machine,
            self._lock,
            observe,
            self._begun,
            self._defect,
            self._calls.misalignment,
            robot,
            frames,
        )
        Tuning(self, self._settings, self._tune)
        self._thread = threading.Thread(target=self._loop, name="docking loop", daemon=True)
        if not held:
            self.release()

    def _tune(self, settings: DockingParameters) -> str:
        """Set parameters for the next goal; those that this node itself uses are not tunable."""
        with self._lock:
            return self._machine.tune(settings)

    def release(self) -> None:
        """Start, and begin the queued goals."""
        self._closed = False
        live = "power none: electrodes are live whenever they touch"
        power = live if self._settings.always_live else f"profiles of targets: {self._targets}"
        self._log.info(f"takes goals, {power}, version {package_version()}")
        self._thread.start()
        self._goals.release()

    def close(self) -> None:
        """Open the contactor, wait until it is open, stop the servos, end the goal and the loop. Safe to call twice.

        A node that was never released stays silent, because its commands would reach another charger of the same name.
        """
        if self._closed:
            return
        self._closed = True
        self._goals.refuse(f"{_SHUTTING_DOWN}; send the goal again when it is back")
        self._frames.close()
        self._stopping.set()
        self._thread.join(2.0)
        why = Canceled(_SHUTTING_DOWN)
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
            self._log.error(
                "the electrodes stay on the target, live and unmonitored: start docking_node again and undock, or "
                "separate them by hand; next time, undock first"
            )
        if self._is_live(self._observe()):
            self._log.error("the contactor does not open: switch the battery off; the torque stays on to avoid an arc")
        else:
            self._await_torque_off()
        self._reports.show(self._machine.status, force=True)
        self._reports.log(self._machine.status, (), self._observe())
        unknown = DockingOutcome(code=why.code, message=_SHUTTING_DOWN, retriable=True, energy=math.nan)
        self._goals.close(self._machine.outcome or unknown)

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
        if hasattr(self, "_goals"):
            self._goals.destroy()
        super().destroy_node()

    def _observe(self) -> Observation:
        return self._inputs.observation(*self._calls.take())

    def _loop(self) -> None:
        while not self._stopping.is_set():
            started = time.monotonic()
            try:
                self._pace()
                started = time.monotonic()
                with self._lock:
                    self._inputs.look(self._between_looks())
                    observation = self._observe()
                    self._goals.forward_cancel()
                    command = self._machine.step(observation)
                    self._carry_out(command, observation)
                    self._report(command, observation)
                    self._switch_off_when_due(observation)
            except Exception as error:  # a defect must open the contactor and end the goal, but not end the thread
                self._defect(error)
            self._slowest_tick = max(self._slowest_tick, time.monotonic() - started)

    def _pace(self) -> None:
        """Wait for the next servo_state; in IDLE only for the tick."""
        if self._machine.status.state is State.IDLE:
            self._inputs.rest()
            self._stopping.wait(_TICK)
        else:
            self._inputs.wait(_TICK)

    def _between_looks(self) -> float:
        """Return the pause (s) between checks for second sources: long at rest, none in ENERGISE."""
        status = self._machine.status
        if status.state is State.ENERGISE:
            return 0.0
        return _LOOK_AT_REST if status.state is State.IDLE and not status.docked else _LOOK

    def _switch_off_when_due(self, observation: Observation) -> None:
        """After a defect, switch the torque off as soon as the contactor is open, never before."""
        if time.monotonic() >= self._torque_off_at and not self._is_live(observation):
            self._torque_off_at = math.inf
            self._calls.call(Request(0, Service.TORQUE_OFF))

    def _is_live(self, observation: Observation) -> bool:
        return observation.contactor_closed and observation.power_age <= self._settings.power_age_max

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
            self._goals.end(DockingOutcome(code=Code.INTERNAL, message=words, elapsed=lasted, energy=math.nan))

    def _carry_out(self, command: Command, observation: Observation) -> None:
        self._calls.contactor(command.energise, observation.contactor_closed, command.limits)
        if command.trajectory is not None:
            # Stamped with the observation: planning a line takes milliseconds, and times count from the observation.
            stamp = before_now(self.get_clock(), time.monotonic() - observation.time)
            self._trajectory.publish(io.trajectory(command.trajectory, stamp, self._secret))
        for request in command.requests:
            self._calls.call(request)

    def _report(self, command: Command, observation: Observation) -> None:
        """Publish decisions and changes, hand over a finished goal, publish diagnostics when due."""
        status = self._machine.status
        self._reports.decided(command.decisions, status.request_id)
        self._reports.show(status, command.states)
        self._reports.log(status, command.states, observation)
        self._goals.feed_back(command.states, observation.charge_current)
        self._hand_over()
        if self._reports.diagnose(status, observation, self._slowest_tick, self._inputs.refused):
            self._slowest_tick = 0.0

    def _begun(self, title: str, order: str) -> None:
        """Report a goal that has just begun; it may already have ended."""
        self._torque_off_at = math.inf
        self._reports.begin(title, order)
        self._reports.show(self._machine.status)
        self._hand_over()

    def _hand_over(self) -> None:
        outcome, self._machine.outcome = self._machine.outcome, None
        if outcome is not None:
            if not outcome.success:
                self._calls.forget()
            self._goals.end(outcome)


def main(args: Sequence[str] | None = None) -> int:
    """Run docking_node until SIGINT or SIGTERM; return 0 after a signal, 2 if the configuration is wrong.

    Like `deltacharger up`, the process locks its ROS domain and namespace, so a second charger of this user on this
    computer is refused.
    """
    with contextlib.ExitStack() as lock:
        return node_support.run(lambda: _alone(DockingNode(held=True), lock), args, has_deadlines=True)


def _alone(node: DockingNode, lock: contextlib.ExitStack) -> DockingNode:
    """Release a node if it is the only one of its name on this computer.

    Raises:
        StartupError: another process runs a charger of this domain and namespace.
    """
    domain = node.context.get_domain_id()
    try:
        lock.enter_context(runtime.only_one(domain, node.get_namespace()))
    except runtime.Taken as taken:
        node.destroy_node()
        raise node_support.StartupError(
            f"docking_node: a charger of this namespace already runs in ROS domain {domain} ({taken}): stop it, or "
            "choose another ROS_DOMAIN_ID or namespace"
        ) from taken
    except OSError as error:  # the lock is not essential: docking also checks for second sources over ROS
        Log(node).warning(f"the lock against a second charger is not available: {error}")
    node.release()
    return node


if __name__ == "__main__":
    raise SystemExit(main())
