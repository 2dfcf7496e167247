# SPDX-License-Identifier: Apache-2.0
"""Send a Dock goal as a fleet's own program would: with rclpy's action client and the interfaces, nothing else.

Prints each phase, then the result. Exit code 0 if charging has begun, else 1.

    deltacharger up                  # in another shell
    python3 examples/send_a_goal.py [z of the electrodes in charger_base, m]
"""

import os
import sys
from typing import Any

import rclpy
from deltacharger.action import Dock
from rclpy.action import ActionClient

os.environ.setdefault("ROS_DOMAIN_ID", "87")  # of simulated chargers; a real one is in the domain of its shell
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
PHASES = {getattr(Dock.Feedback, name): name[6:].lower() for name in dir(Dock.Feedback) if name.startswith("STATE_")}
shown: list[int] = []


def on_feedback(message: Any) -> None:
    feedback = message.feedback
    if shown[-1:] != [feedback.state]:
        shown.append(feedback.state)
        values = f"z {1000 * feedback.z:5.1f} mm, contact current {feedback.contact_current:6.3f} A"
        print(f"{PHASES[feedback.state]:<9} {values}", flush=True)


goal = Dock.Goal(request_id="example")
goal.electrodes.header.frame_id = "charger_base"  # '' would ask the camera
goal.electrodes.pose.position.z = float(sys.argv[1]) if len(sys.argv) > 1 else 0.080  # m
rclpy.init()
node = rclpy.create_node("example_client")
client = ActionClient(node, Dock, "dock")
if not client.wait_for_server(5.0):
    sys.exit("no charger answers: start one with `deltacharger up`")
sent = client.send_goal_async(goal, on_feedback)
rclpy.spin_until_future_complete(node, sent)
ended = sent.result().get_result_async()  # every goal is accepted; a goal that cannot be served fails with a code
rclpy.spin_until_future_complete(node, ended)
result = ended.result().result
rclpy.shutdown()
if not result.success:
    sys.exit(f"failed with {result.error_code}: {result.error_message}")
print(result.error_message or f"charging with {result.charge_current:.1f} A")  # `power: none` measures no charge
