# SPDX-License-Identifier: Apache-2.0
"""mock_navigator_node: Nav2's navigate_to_pose without Nav2, for tests and demonstrations.

Serves: navigate_to_pose. It moves only its assumed pose of the base: straight to the goal, then turning.
Parameters: initial x and speed of the base, and `fault`, which may be changed at runtime: `abort` lets it give up
half-way.
"""

import math
import threading
import time
from collections.abc import Sequence
from typing import Any

from rclpy.action.server import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from deltacharger_core.ros import messages, node_support, parameters
from deltacharger_docking.mission.places import Place
from deltacharger_docking.mission.ros import mission_node, others
from deltacharger_docking.mission.ros.others import place as read_place
from deltacharger_sim.mocks.parameters import NAVIGATOR_FAULTS, MockNavigatorNodeParameters, fault_switch

_FRAME = "map"
_TICK = 0.02  # s
_TF_ERROR = 9002  # Nav2's codes since Kilted
_UNKNOWN = 9000


class MockNavigatorNode(Node):
    """See the module's docstring.

    Attributes:
        arrived: places reached, in order; for tests.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("mock_navigator_node", **kwargs)
        given = parameters.declare_all(self, MockNavigatorNodeParameters)
        parameters.reject_unknown(self)
        self._speed = given.speed
        self._fault = fault_switch(self, NAVIGATOR_FAULTS)
        self._action = mission_node.load_navigation("nav2")
        self._place = Place(given.x, 0.0, 0.0, _FRAME)
        self.arrived: list[Place] = []
        self._stopping = threading.Event()
        self._server: Any = ActionServer(
            self,
            self._action,
            "navigate_to_pose",
            execute_callback=self._execute,
            cancel_callback=lambda handle: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    @property
    def place(self) -> Place:
        """Assumed pose of the base; for tests."""
        return self._place

    def close(self) -> None:
        """Stop the current goal; the node commands nothing."""
        self._stopping.set()

    def destroy_node(self) -> None:
        """Release the ROS side."""
        if hasattr(self, "_server"):  # missing if its parameters were rejected
            self._server.destroy()
        super().destroy_node()

    def _execute(self, handle: Any) -> Any:
        result = self._action.Result()
        goal = read_place(handle.request.pose)
        if goal is None or goal.frame != _FRAME:
            result.error_code, result.error_msg = _TF_ERROR, "the pose of the base is unknown in that frame"
            handle.abort()
            return result
        halfway = 0.5 * self._place.distance(goal)
        started = last = time.monotonic()
        while not self._stopping.wait(_TICK):
            now = time.monotonic()
            if handle.is_cancel_requested:
                handle.canceled()
                return result
            if self._fault() == "abort" and self._place.distance(goal) <= halfway:
                result.error_code, result.error_msg = _UNKNOWN, "the way is blocked"
                handle.abort()
                return result
            self._advance(goal, now - last)
            last = now
            self._feed_back(handle, goal, now - started)
            if self._place == goal:
                self.arrived.append(goal)
                handle.succeed()
                return result
        handle.abort()
        return result

    def _advance(self, end: Place, seconds: float) -> None:
        """Move the assumed pose: straight to the goal, then to its heading."""
        here, reach = self._place, self._speed * seconds
        left = here.distance(end)
        if left > reach:
            share = reach / left
            x, y = here.x + share * (end.x - here.x), here.y + share * (end.y - here.y)
            self._place = Place(x, y, here.yaw, _FRAME)
            return
        turn = math.remainder(end.yaw - here.yaw, 2.0 * math.pi)
        step = 2.0 * reach
        yaw = end.yaw if abs(turn) <= step else here.yaw + math.copysign(step, turn)
        self._place = Place(end.x, end.y, yaw, _FRAME)

    def _feed_back(self, handle: Any, end: Place, seconds: float) -> None:
        message = self._action.Feedback(
            navigation_time=messages.duration(seconds), distance_remaining=self._place.distance(end)
        )
        others.fill_pose(message.current_pose, self._place)
        message.current_pose.header.stamp = self.get_clock().now().to_msg()
        handle.publish_feedback(message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(MockNavigatorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
