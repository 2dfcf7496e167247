# SPDX-License-Identifier: Apache-2.0
"""Goals as raw messages, as the charger's client never sends them."""

from __future__ import annotations

from typing import Any

from deltacharger.action import Dock, Undock
from rclpy.action.client import ActionClient

from deltacharger_ros.client import ChargerClient

from ..chargers import DEADLINE
from ..nodes import answer


def pose(*place: float, frame: str = "charger_base", w: float = 1.0, **turn: float) -> Dock.Goal:
    """Return a goal at a place (m; default 80 mm ahead) in a frame, with this orientation."""
    goal = Dock.Goal()
    at, goal.electrodes.header.frame_id = goal.electrodes.pose.position, frame
    at.x, at.y, at.z = place or (0.0, 0.0, 0.080)
    for name, value in {"w": w, **turn}.items():
        setattr(goal.electrodes.pose.orientation, name, value)
    return goal


def goal_with(**fields: Any) -> Dock.Goal:
    """Return a goal at the usual place with these fields."""
    goal = pose()
    for name, value in fields.items():
        setattr(goal, name, value)
    return goal


class RawGoals:
    """Action clients on the node of a charger's client."""

    def __init__(self, client: ChargerClient) -> None:
        self._client = client
        self._actions: dict[Any, Any] = {
            kind: ActionClient(client.node, kind, name) for kind, name in ((Dock, "dock"), (Undock, "undock"))
        }
        client.waitables += self._actions.values()
        assert all(action.wait_for_server(DEADLINE) for action in self._actions.values())

    def send(self, goal: Any) -> Any:
        """Send a goal and return its handle; every goal is accepted."""
        action = self._actions[Dock if isinstance(goal, Dock.Goal) else Undock]
        handle = answer(answer(self._client.node.executor.call_soon(action.send_goal_async, goal)))
        assert handle.accepted
        return handle

    def result(self, goal: Any) -> Any:
        """Send a goal and return its result."""
        return answer(self.send(goal).get_result_async()).result
