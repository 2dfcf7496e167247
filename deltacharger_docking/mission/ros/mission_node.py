# SPDX-License-Identifier: Apache-2.0
"""mission_node: the action charge_robot, the paper's strategy of operation, by the mission state machine.

Calls the actions dock, undock and navigate_to_pose (Nav2) and the service detect_electrodes; subscribes to
docking_state; publishes /diagnostics. One thread steps the machine. It drives nothing itself: if it is absent, the
navigator continues to its goal, and docking_node supervises charging.
"""

import contextlib
import math
import threading
import time
from collections.abc import Sequence
from typing import Any

from deltacharger.action import ChargeRobot
from rclpy.node import Node

from deltacharger_core import frames, texts
from deltacharger_core.ros import action_server, diagnostics, messages, node_support, parameters
from deltacharger_core.ros.frames import Frames, TransformError
from deltacharger_core.ros.log import Log
from deltacharger_docking.codes import Busy, Canceled, DockingError, Rejected
from deltacharger_docking.mission import dialogue, machine, places
from deltacharger_docking.mission.parameters import MissionParameters
from deltacharger_docking.mission.ros import others as io
from deltacharger_docking.mission.ros.others import Others
from deltacharger_docking.ros.messages import MEASURED, refusal
from deltacharger_docking.ros.reports import PhaseLog

_TICK = 0.05  # s
_FEEDBACK = 1.0  # s between feedbacks without a change
_DIAGNOSTICS = 1.0  # s
_CLOSING = 3.0  # s for cancels to arrive and the contactor to open
_SHUT_DOWN = "mission_node was shut down; the robot stays where it is, undock before you drive it"


def load_navigation(name: str) -> Any:
    """Return Nav2's action NavigateToPose, None without navigation.

    Raises:
        StartupError: it is not installed.
    """
    if name == "none":
        return None
    try:
        from nav2_msgs.action import NavigateToPose
    except ImportError as error:
        raise node_support.StartupError(
            f"driving needs the package nav2_msgs of Nav2 ({error}): install it (docs/mission.md), or set the "
            "parameter navigation to 'none'"
        ) from error
    return NavigateToPose


class _Mission(action_server.Work):
    """The mission being served."""

    def __init__(self, handle: action_server.GoalHandle, log: Log, docked: Any) -> None:
        super().__init__(handle)
        self.docked = docked  # the result of its last docking
        self.log = PhaseLog(log, dialogue.Stage.WAIT)
        self.log.begin_goal(texts.titled("charge_robot", handle.request.request_id))
        self.is_canceled = False  # the machine knows it


class MissionNode(Node):
    """Serves charge_robot; its calls are in the module docstring, its parameters in docs/mission.md."""

    def __init__(self, **kwargs: Any) -> None:
        self._closed = True  # nothing to cancel before the node is complete
        super().__init__("mission_node", **kwargs)
        self._given = given = parameters.declare_all(self, MissionParameters)
        transforms = parameters.declare_all(self, frames.TransformParameters)
        parameters.reject_unknown(self)
        try:
            mount = places.BaseMount(given.base_pose)
        except ValueError as error:
            raise node_support.StartupError(f"mission_node: parameter 'base_pose': {error}") from error
        navigate_to_pose = load_navigation(given.navigation)
        self._drives = navigate_to_pose is not None
        self._frames = Frames(self, transforms, given.base_frame, given.base_pose)
        self._end_effector = transforms.named(frames.END_EFFECTOR)
        home = places.Place(given.home_x, given.home_y, given.home_yaw, given.map_frame) if self._drives else None
        self._machine = machine.MissionMachine(given, mount, home)
        self._others = Others(self, navigate_to_pose, given, transforms)
        self._diagnostics = diagnostics.Diagnostics(self)
        self._log = Log(self)
        self._lock = threading.RLock()
        self._mission: _Mission | None = None
        self._diagnosed = -math.inf
        self._stopping = threading.Event()
        self._server = action_server.WorkServer(
            self,
            ChargeRobot,
            "charge_robot",
            self._begin,
            lambda mission: mission is self._mission,
            dialogue.MissionOutcome.refused,
            DockingError,
            lambda outcome, mission: _result(outcome, self._unknown_dock() if mission is None else mission.docked),
        )
        self._closed = False
        self._thread = threading.Thread(target=self._loop, name="mission loop", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Cancel docking and driving, wait until charging has ended, and end the goal. Safe to call twice.

        docking_node opens the contactor, undocks and moves the arm home by itself after its goal is cancelled. The base
        stops where it is: a process that ends cannot supervise the way home.
        """
        if self._closed:
            return
        self._closed = True
        self._frames.close()
        self._stopping.set()
        self._thread.join(2.0)
        with self._lock:
            self._others.carry_out(self._machine.emergency())
        end = time.monotonic() + _CLOSING
        while self._others.is_at_work and time.monotonic() < end:
            self._others.observe()
            time.sleep(_TICK)
        self._end_with(Canceled(_SHUT_DOWN))

    def destroy_node(self) -> None:
        """Close, then destroy the ROS side."""
        self.close()
        if hasattr(self, "_server"):  # missing if a parameter was refused
            self._server.destroy()
            self._others.destroy()
        super().destroy_node()

    def _loop(self) -> None:
        while not self._stopping.wait(_TICK):
            try:
                with self._lock:
                    self._others.carry_out(self._machine.step(self._others.observe()))
                    self._report()
            except Exception as error:  # a defect must cancel everything and end the goal, but not end the thread
                self._log.error(f"an internal error stopped the mission: {type(error).__name__}: {error}", pause=1.0)
                with self._lock:
                    with contextlib.suppress(Exception):  # the machine may be the defect; the goal must still end
                        self._others.carry_out(self._machine.emergency())
                    self._end_with(DockingError(f"internal error: {error}; the robot stays where it is, see the log"))

    def _report(self) -> None:
        """Hand over a finished mission, publish feedback if the stage changed, and diagnostics when due."""
        mission, status = self._mission, self._machine.status
        if mission is not None:
            if mission.handle.is_cancel_requested and not mission.is_canceled:
                mission.is_canceled = True
                self._machine.cancel()
            if mission.is_due(status.stage, _FEEDBACK):
                mission.feed_back(
                    ChargeRobot.Feedback(stage=int(status.stage), elapsed=messages.duration(status.elapsed))
                )
            entered = [] if status.stage is mission.log.phase else [status.stage]
            mission.log.show(status, entered, status.elapsed, *(entered and _figures(status)))
        outcome, self._machine.outcome = self._machine.outcome, None
        if outcome is not None:
            self._end(outcome)
        if time.monotonic() - self._diagnosed > _DIAGNOSTICS:
            self._diagnosed = time.monotonic()
            self._diagnose()

    def _end_with(self, error: DockingError) -> None:
        self._end(self._machine.ended_by(error, time.monotonic()))

    def _end(self, outcome: dialogue.MissionOutcome) -> None:
        mission, self._mission = self._mission, None
        if mission is not None:
            mission.docked = self._others.dock_result
            mission.end(outcome)

    def _diagnose(self) -> None:
        status = self._machine.status
        stage = status.stage.name if self._machine.busy else "IDLE"
        level, text = (
            (diagnostics.WARN, f"{status.code.name}: {status.message}") if status.code else (diagnostics.OK, stage)
        )
        entries = {
            "stage": stage,
            "request_id": status.request_id,
            "elapsed": texts.quantity(status.elapsed, ".1f", "s"),
            "views": status.views,
            "moves": status.moves,
            "place": status.place or "unknown",
            "drives": self._drives,
        }
        self._diagnostics.report(level, text, entries, "mission")

    def _begin(self, handle: action_server.GoalHandle) -> _Mission:
        """Begin a mission.

        Raises:
            DockingError: the goal is refused.
        """
        goal, mount = io.goal(handle.request, self._given), self._mount()
        with self._lock:
            self._machine.check(goal)
            if self._closed:
                raise Busy("mission_node is shutting down; send the goal again when it is back")
            try:
                self._machine.start(goal, self._others.observe(), mount)
            except DockingError:
                raise
            except Exception:  # it may have begun; without this, nothing would end it
                self._others.carry_out(self._machine.emergency())
                raise
            self._others.dock_result = self._unknown_dock()
            self._mission = mission = _Mission(handle, self._log, self._others.dock_result)
            return mission

    def _unknown_dock(self) -> Any:
        return io.unknown_dock(self._end_effector)

    def _mount(self) -> places.BaseMount:
        """Return the mount of the arm; may wait for tf.

        Raises:
            Rejected: it is unknown at present.
        """
        try:
            return places.BaseMount(self._frames.base_pose())
        except TransformError as error:
            raise refusal(error) from error
        except ValueError as error:
            raise Rejected(f"charger_base on the robot, by tf: {error}") from error


def _figures(status: dialogue.MissionStatus) -> list[str]:
    at = [] if status.place is None else [f"base at {status.place}"]
    return at + [f"{name} {count}" for name, count in (("views", status.views), ("moves", status.moves)) if count]


def _result(outcome: dialogue.MissionOutcome, dock: Any) -> ChargeRobot.Result:
    """Return a mission's result, with the values of the last docking."""
    details = {name: getattr(dock, name) for name in (*MEASURED, "misalignment", "suggested_base_pose")}
    return messages.to_result(ChargeRobot, outcome, returned=outcome.returned, **details)


def main(args: Sequence[str] | None = None) -> int:
    """Run mission_node until SIGINT or SIGTERM; return 0 after a signal, 2 if the configuration is wrong."""
    return node_support.run(MissionNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
