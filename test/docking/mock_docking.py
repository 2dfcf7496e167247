# SPDX-License-Identifier: Apache-2.0
"""docking_node's interface without an arm: dock, undock and docking_state, at once under any load of the computer."""

from __future__ import annotations

import math
import threading
import time
from typing import Any

from deltacharger.action import Dock, Undock
from deltacharger.msg import DockingState
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_ros.executor import Spinner
from deltacharger_ros.messages import unknown_misalignment

from ..nodes import options

POWER = 240.0  # W
APPROACH = 0.5  # s


class MockDocking(Node):
    """Docks with anything, and charges until a stop condition or a cancel.

    Attributes:
        docked, charging: as in docking_state.
        undockings: how often it undocked.
    """

    def __init__(self, context: Any, namespace: str) -> None:
        super().__init__("docking_node", **options(context, namespace))
        self.docked = self.charging = False
        self.undockings = 0
        self._stopping = threading.Event()
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._state = self.create_publisher(DockingState, "docking_state", latched)
        group = ReentrantCallbackGroup()
        self._servers: list[Any] = [
            ActionServer(
                self,
                kind,
                name,
                execute_callback=execute,
                cancel_callback=lambda handle: CancelResponse.ACCEPT,
                callback_group=group,
            )
            for kind, name, execute in ((Dock, "dock", self._dock), (Undock, "undock", self._undock))
        ]
        self.tell(DockingState.STATE_IDLE)
        self._spinner = Spinner(self)

    def stop(self) -> None:
        """Disappear like a killed node: goals are no longer answered. Safe to call twice."""
        self._spinner._end()
        for server in self._servers:
            server.destroy()
        self._servers = []
        self._stopping.set()
        self._spinner.close()

    def tell(self, state: int, docked: bool = False, charging: bool = False, request_id: str = "") -> None:
        """Publish docking_state."""
        self.docked, self.charging = docked, charging
        self._state.publish(DockingState(state=state, docked=docked, charging=charging, request_id=request_id))

    def _dock(self, handle: Any) -> Dock.Result:
        goal, began = handle.request, time.monotonic()
        assert goal.hold
        assert goal.electrodes.header.frame_id == "", "the camera is asked"
        self.tell(DockingState.STATE_APPROACH, request_id=goal.request_id)
        result = Dock.Result(misalignment=unknown_misalignment(), contact_current=0.45, contact_force=17.0)
        result.charge_current = 10.0
        stop_after = goal.stop_after.sec + 1e-9 * goal.stop_after.nanosec
        while not self._stopping.wait(0.02):
            charged = max(time.monotonic() - began - APPROACH, 0.0)
            result.energy = POWER * charged
            if charged and not self.charging:
                self.tell(DockingState.STATE_CHARGING, True, True, goal.request_id)
            if handle.is_cancel_requested:
                self.tell(DockingState.STATE_IDLE)
                result.error_code, result.retriable = Dock.Result.CANCELED, True
                result.error_message, result.charge_current = "cancelled by the client", math.nan
                handle.canceled()
                return result
            if stop_after and charged >= stop_after:
                self.tell(DockingState.STATE_IDLE, docked=True)
                result.success = True
                handle.succeed()
                return result
        handle.abort()
        return result

    def _undock(self, handle: Any) -> Undock.Result:
        self.undockings += 1
        self.tell(DockingState.STATE_IDLE)
        handle.succeed()
        return Undock.Result(success=True)
