# SPDX-License-Identifier: Apache-2.0
"""Client programs: a node for any of them, and a client of the charger's actions for fleet managers and scripts.

The client has its own small node and executor, so it works in any program::

    with ChargerClient() as charger:
        charger.wait_until_ready(5.0)
        outcome = charger.dock(DockRequest(Pose(0.0, 0.0, 0.080)), on_progress=print)
        print(outcome.success, outcome.error_message)
"""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import rclpy
from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from rclpy.action.client import ActionClient
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from deltacharger_core.frames import CHARGER_BASE
from deltacharger_core.ros import action_caller, executor, messages, outcomes, qos

_STATE = "docking_state"
_LATCHED = 1.0  # s to receive the latched docking_state
_INPUTS = ("servo_state", "tactile_frame", "charger_power")
_LOST_AFTER = 5.0  # s without an action server in the graph, or without its answer, before it counts as lost
_CANCEL_GRACE = 60.0  # s that a cancelled goal may take to make itself safe and retract
_LAST_ANSWER = 0.5  # s for the response to a goal that is to be cancelled
_GUEST_POLL = 0.02  # s between checks of a condition
_POLL = 0.1  # s between checks of deadline, cancel request and server while a goal runs

Self = TypeVar("Self", bound="Guest")
ProgressCallback = Callable[[outcomes.Progress], None]


class ClientError(RuntimeError):
    """The charger is missing, disappeared or did not answer in time."""


class Guest:
    """Base of client programs; leaves the graph at the end of a `with` block.

    Args:
        name: beginning of the node's name.
        context: a running rclpy context.
        namespace: namespace of the charger.

    Attributes:
        node: the ROS node.
        waitables: action clients and servers of the node, destroyed after it was served.
    """

    def __init__(self, name: str, context: Context, namespace: str) -> None:
        self.node = Node(
            f"{name}_{uuid.uuid4().hex[:8]}",
            context=context,
            namespace=namespace,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],  # not needed
        )
        self._spinner: executor.Spinner | None = None
        self.waitables: list[Any] = []
        self._open = True

    def serve(self) -> None:
        """Start to serve the node."""
        self._spinner = executor.Spinner(self.node)

    def wait(
        self,
        condition: Callable[[], bool],
        timeout: float,
        check: Callable[[], None] | None = None,
        stop: threading.Event | None = None,
    ) -> bool:
        """Wait for `condition` at most `timeout` s or until `stop` is set; return whether it became true.

        Args:
            condition: polled.
            timeout: s.
            check: called at each poll; may raise.
            stop: ends the wait early when set.
        """
        end = time.monotonic() + timeout
        while not condition():
            if check is not None:
                check()
            if time.monotonic() > end or (stop is not None and stop.is_set()):
                return False
            time.sleep(_GUEST_POLL)
        return True

    def close(self) -> None:
        """Leave the graph. Safe to call twice."""
        if not self._open:
            return
        self._open = False
        if self._spinner is not None:
            self._spinner.close(*self.waitables)
        else:
            self.node.destroy_node()

    def __enter__(self: Self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


class ChargerClient(Guest):
    """Send Dock and Undock goals and wait for their results.

    Args:
        namespace: namespace of the charger; '' = none.
        context: a running rclpy context; None = start one of its own.
    """

    def __init__(self, namespace: str = "", context: Context | None = None) -> None:
        self._owned: Context | None = None
        if context is None:
            context = self._owned = Context()
            rclpy.init(context=context, args=[], signal_handler_options=SignalHandlerOptions.NO)
        super().__init__("charger_client", context, namespace)
        self._dock: ActionClient[Any, Any, Any] = ActionClient(self.node, Dock, "dock", **qos.ACTION)
        self._undock: ActionClient[Any, Any, Any] = ActionClient(self.node, Undock, "undock", **qos.ACTION)
        self.waitables = [self._dock, self._undock]
        self._echoes = [action_caller.Echo(self.node, action) for action in (self._dock, self._undock)]
        self._charger_base = ""  # full frame name from docking_state
        self.node.create_subscription(DockingState, _STATE, self._on_state, qos.STATE)
        self.serve()

    def close(self) -> None:
        """Leave the graph. A running goal continues without this client. Safe to call twice."""
        super().close()
        if self._owned is not None:
            rclpy.try_shutdown(context=self._owned)
            self._owned = None

    def answers(self) -> bool:
        """Whether both actions have a server now that has answered this client. Call it regularly until it has."""
        return all(echo.answers() for echo in self._echoes)

    def is_ready(self) -> bool:
        """Whether both actions answer and their inputs have publishers now."""
        return self.answers() and all(self.node.count_publishers(topic) for topic in _INPUTS)

    def has_detector(self) -> bool:
        """Whether the service detect_electrodes has a server now."""
        return self.node.count_services("detect_electrodes") > 0

    def wait_until_ready(self, timeout: float, stop: threading.Event | None = None) -> bool:
        """Wait until `is_ready`.

        Args:
            timeout: s; discovery alone takes up to 3 s. A charger that was discovered has 5 s to answer in any case.
            stop: ends the wait early when set.

        Returns:
            Whether it is ready.

        Raises:
            ClientError: a charger was discovered, but does not answer.
        """
        return self._wait(self.is_ready, timeout, stop)

    def wait_until_it_answers(self, timeout: float, stop: threading.Event | None = None) -> bool:
        """Wait until `answers`; arguments, result and errors as in `wait_until_ready`."""
        return self._wait(self.answers, timeout, stop)

    def _wait(self, condition: Callable[[], bool], timeout: float, stop: threading.Event | None) -> bool:
        if self.wait(condition, timeout, self._refuse_silence, stop):
            return True
        silent = any(echo.silence for echo in self._echoes)
        return silent and self.wait(self.answers, _LOST_AFTER, self._refuse_silence, stop) and condition()

    def _refuse_silence(self) -> None:
        if max(echo.silence for echo in self._echoes) > _LOST_AFTER:
            domain = self.node.context.get_domain_id()
            raise ClientError(
                f"a charger is in ROS domain {domain}, but its answers do not arrive: {action_caller.ONE_USER}"
            )

    def dock(
        self,
        request: outcomes.DockRequest,
        on_progress: ProgressCallback | None = None,
        cancel: threading.Event | None = None,
        deadline: float = math.inf,
        give_up: threading.Event | None = None,
    ) -> outcomes.Outcome:
        """Send a Dock goal and wait for its result.

        Args:
            request: the goal.
            on_progress: called for each feedback message, from the client's own thread.
            cancel: when set, cancel the goal and wait for its result.
            deadline: s after which the goal is cancelled; the outcome is CANCELED or an earlier end.
            give_up: when set, stop waiting for the result.

        Raises:
            ClientError: the charger does not answer or disappears while the goal runs, or `give_up` was set.
        """
        goal = Dock.Goal()
        if request.electrodes is not None:
            messages.fill_pose(goal.electrodes, self._named(request.electrodes))
        goal.critical_angle = float(request.critical_angle)
        goal.start_charging = request.start_charging
        goal.hold = request.hold
        goal.stop_energy = float(request.stop_energy)
        goal.stop_after = messages.duration(request.stop_after)
        goal.request_id = request.request_id
        goal.target_profile = request.target_profile
        return self._execute("dock", self._dock, goal, on_progress, cancel, deadline, give_up)

    def _named(self, pose: outcomes.Pose) -> outcomes.Pose:
        """Return a pose with the charger's full name of charger_base, which may have a prefix."""
        if pose.frame_id != CHARGER_BASE:
            return pose
        if self.node.count_publishers(_STATE):
            self.wait(lambda: bool(self._charger_base), _LATCHED)
        return replace(pose, frame_id=self._charger_base or CHARGER_BASE)

    def _on_state(self, message: DockingState) -> None:
        self._charger_base = message.header.frame_id

    def undock(
        self,
        request_id: str = "",
        on_progress: ProgressCallback | None = None,
        cancel: threading.Event | None = None,
        deadline: float = math.inf,
    ) -> outcomes.Outcome:
        """Send an Undock goal and wait for its result; arguments and errors as in `dock`."""
        return self._execute("undock", self._undock, Undock.Goal(request_id=request_id), on_progress, cancel, deadline)

    def _execute(
        self,
        action: str,
        client: ActionClient[Any, Any, Any],
        goal: Any,
        on_progress: ProgressCallback | None,
        cancel: threading.Event | None,
        deadline: float,
        give_up: threading.Event | None = None,
    ) -> outcomes.Outcome:
        if not self.answers() and not self.wait_until_it_answers(_LOST_AFTER, cancel):
            raise ClientError(f"no charger answers the action '{action}': start one with `deltacharger up`")
        started = time.monotonic()

        def on_feedback(message: Any) -> None:
            if on_progress is not None:
                on_progress(messages.to_progress(message.feedback, time.monotonic() - started))

        running = action_caller.SentGoal(self.node, client, goal, on_feedback)
        stop = cancel or threading.Event()
        lost_since = canceled_at = math.inf
        while not running.finished.wait(_POLL):
            now = time.monotonic()
            running.check()
            if give_up is not None and give_up.is_set():
                raise ClientError(f"gave up waiting for the end of '{action}'")
            if stop.is_set() or now - started > deadline:
                canceled_at = min(canceled_at, now)
                running.cancel()
            if not running.accepted and (now - canceled_at > _LAST_ANSWER or now - started > _LOST_AFTER):
                running.cancel()
                raise ClientError(f"the charger did not answer the goal '{action}' in {now - started:.1f} s")
            if now - canceled_at > _CANCEL_GRACE:
                raise ClientError(f"the charger did not end '{action}' within {_CANCEL_GRACE:.0f} s of the cancel")
            if client.server_is_ready():
                lost_since = math.inf
                continue
            lost_since = min(lost_since, now)
            if now - lost_since > _LOST_AFTER:
                raise ClientError(
                    f"the charger disappeared while it served '{action}': if only the network failed, the goal goes "
                    "on; if docking_node ended, the board opens the contactor by itself: check its log"
                )
        if running.end == action_caller.LOST:
            raise ClientError(
                f"the charger no longer knows the goal '{action}': docking_node has restarted, or the goal ended more "
                "than an hour ago; docking_state tells whether it charges, which undocking would end"
            )
        if running.error is not None:
            raise ClientError(f"the charger did not accept the goal '{action}': {running.error}")
        if running.result is None:
            raise ClientError(f"the charger rejected the goal '{action}' without a reason")
        return messages.to_outcome(action, running.result)
