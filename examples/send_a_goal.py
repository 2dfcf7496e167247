# SPDX-License-Identifier: Apache-2.0
"""A Dock goal with feedback, sent by rclpy's action client alone, as a fleet's program would.

Sends the goal to the running charger of this ROS domain. If there is none, it starts the charger of a scene: emulated
hardware for scene `simulated`, mock nodes for scene `mocks`. Prints each phase as it begins, then the result. Exit code
0 if the target is charged, else 1.

    deltacharger up                         # in another shell; optional
    python examples/send_a_goal.py [scene]
"""

from __future__ import annotations

import contextlib
import sys
from typing import Any

from deltacharger_core import environment

environment.prepare()  # before rclpy if ROS is from pip; a ROS installation needs neither call
environment.isolate()  # the domain of simulated chargers, unless ROS_DOMAIN_ID is set

import rclpy  # noqa: E402
from deltacharger.action import Dock  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402

PHASES = {getattr(Dock.Feedback, name): name[6:].lower() for name in dir(Dock.Feedback) if name.startswith("STATE_")}


def own_charger(stack: contextlib.ExitStack, scene: str) -> None:
    from deltacharger_scenes.composition import Composition
    from deltacharger_scenes.scene import load_scene

    print(f"no charger answers; starting that of the scene '{scene}'")
    stack.enter_context(Composition(load_scene(scene), rclpy.get_default_context()))


def main() -> int:
    seen: list[int] = []

    def on_feedback(message: Any) -> None:
        feedback = message.feedback
        if seen[-1:] != [feedback.state]:
            seen.append(feedback.state)
            current = feedback.contact_current
            print(
                f"{PHASES[feedback.state]:<9} z {1000 * feedback.z:5.1f} mm, contact current {current:6.3f} A",
                flush=True,
            )

    goal = Dock.Goal(request_id="example")
    goal.electrodes.header.frame_id = "charger_base"  # '' would use the camera
    goal.electrodes.pose.position.z = 0.080  # m
    with contextlib.ExitStack() as stack:
        rclpy.init()
        stack.callback(rclpy.try_shutdown)
        node = rclpy.create_node("example_client")
        client = ActionClient(node, Dock, "dock")
        if not client.wait_for_server(4.0):
            own_charger(stack, sys.argv[1] if len(sys.argv) > 1 else "simulated")
            client.wait_for_server()
        sent = client.send_goal_async(goal, on_feedback)
        rclpy.spin_until_future_complete(node, sent)
        ended = sent.result().get_result_async()  # every goal is accepted; an impossible one ends with its code
        rclpy.spin_until_future_complete(node, ended)
        result = ended.result().result
        if result.success:  # its message names what a charger without a contactor cannot measure
            charging = f"charging with {result.charge_current:.1f} A after {result.alignments} alignments"
            print(result.error_message or charging)
        else:
            print(f"failed with {result.error_code}: {result.error_message}")
        return 0 if result.success else 1


if __name__ == "__main__":
    sys.exit(main())
