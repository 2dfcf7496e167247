# SPDX-License-Identifier: Apache-2.0
"""Whether an action's server answers a client, which discovery does not tell."""

from __future__ import annotations

import math
import time
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.node import Node

from deltacharger_ros.sent_goal import new_handle

ONE_USER = (
    "run both as one user, since root and others do not hear each other, and containers with --ipc=host and --user "
    "(docs/security.md); else docking_node hangs: read its log"
)
"""What to do if a charger is discovered, but does not answer."""

_ASK_EVERY = 1.0  # s


class Echo:
    """Asks an action's server for the result of a goal that nobody has, until it answers.

    Fast DDS discovers over UDP but delivers over shared memory, which two users or two containers may not share: a goal
    would be accepted and its answers lost. Every action server answers this question at once, and it changes nothing.

    Args:
        node: node of the client, served by a `Spinner`.
        client: of the action.
    """

    def __init__(self, node: Node, client: ActionClient[Any, Any, Any]) -> None:
        self._node, self._client = node, client
        self._heard = False
        self._since = math.nan  # when the server was discovered; NaN = it is not
        self._ask_at = -math.inf
        self._question: Any = None

    @property
    def silence(self) -> float:
        """How long (s) the server has been there without an answer; 0 if it has answered, or is not there."""
        return 0.0 if self._heard or math.isnan(self._since) else time.monotonic() - self._since

    def answers(self) -> bool:
        """Return whether the server is there and has answered. Call it regularly: it asks."""
        now = time.monotonic()
        executor: Any = self._node.executor
        if not self._client.server_is_ready():
            self._heard, self._since = False, math.nan
        elif math.isnan(self._since):
            self._since = self._ask_at = now
        if not (self._heard or math.isnan(self._since)) and now >= self._ask_at and executor is not None:
            self._ask_at = now + _ASK_EVERY
            executor.call_soon(self._ask)
        return self._heard

    def _ask(self) -> None:
        if self._question is not None:
            self._question.cancel()  # rclpy would keep it
        self._question = new_handle(self._client).get_result_async()
        self._question.add_done_callback(self._on_answer)

    def _on_answer(self, question: Any) -> None:
        if not question.cancelled() and question.exception() is None:
            self._heard = True
