# SPDX-License-Identifier: Apache-2.0
"""What every program shares that moves a charger's arm itself, beside docking_node."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

from deltacharger.msg import DockingState
from rclpy.context import Context
from std_srvs.srv import SetBool
from trajectory_msgs.msg import JointTrajectory

from deltacharger_records.node_parameters import ParameterReader
from deltacharger_ros import qos
from deltacharger_ros.guest import Guest

_ANSWER = 5.0  # s for a service


class ArmError(RuntimeError):
    """The arm cannot be moved, or not any more; the message says why and what to do."""


class ArmGuest(Guest, ABC):
    """Hears docking_state; may publish joint_trajectory and call set_torque while docking_node does not need the arm.

    Args:
        name: what the node's name begins with.
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
        """Stop the arm, switch off the torque that this program switched on, and leave the graph. Safe to call twice.

        Where docking_node has begun to serve a goal meanwhile, arm and torque are its own and stay as they are.
        """
        if not self._open:
            return
        try:
            if not self._is_taken():
                self._let_go()
        finally:
            super().close()

    @abstractmethod
    def _let_go(self) -> None:
        """Stop the arm and switch off the torque, where this program drives it."""

    def _told(self) -> bool:
        """Whether docking_node has told its state, or there is none."""
        return self._docking is not None or not self.node.count_publishers("docking_state")

    def _ask(self, name: str) -> dict[str, Any]:
        """Return a node's parameters; empty where it does not answer."""
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
                "docking_node is at work or docked, and the arm is its own: let it end, or `deltacharger undock`"
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
        """Wait for `condition`, asking `check` meanwhile; unless `patient`, no longer than until `stop` is set."""
        return self.wait(condition, timeout, check, None if patient else self._stop)
