# SPDX-License-Identifier: Apache-2.0
"""Base class of programs that move a charger's arm without docking_node."""

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
