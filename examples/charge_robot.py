# SPDX-License-Identifier: Apache-2.0
"""Send a ChargeRobot goal and report it as VDA5050 2.x reports startCharging: a JSON line with each feedback.

The request_id is the actionId. Ctrl-C is stopCharging: the charger undocks and returns. Exit code 0: that succeeded.
    deltacharger up --scene mission_standing    # in another shell
    python3 examples/charge_robot.py [seconds to charge; 0 = until full]
"""

import json
import os
import signal
import sys

import rclpy
from deltacharger.action import ChargeRobot
from rclpy.action import ActionClient

os.environ.setdefault("ROS_DOMAIN_ID", "87")  # of simulated chargers; a real one is in the domain of its shell
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
RESULT, STAGE = ChargeRobot.Result, ChargeRobot.Feedback
FATAL = (304, 305, 306, 502, 504, 505, 506, 507, 999)  # the codes that need a person: docs/fleet.md
goal = ChargeRobot.Goal(request_id="order-1/startCharging")
goal.stop_after.sec = int(sys.argv[1]) if len(sys.argv) > 1 else 0
goal.target.header.frame_id, goal.target.pose.position.x = "map", 2.0  # the navigator's frame; m
goal.target.pose.orientation.z, goal.target.pose.orientation.w = 1.0, 0.0  # its electrodes face the charger
state = {"actionId": goal.request_id, "actionType": "startCharging", "actionStatus": "", "errors": []}
stops = []


def report(stage, status="RUNNING"):  # your MQTT client publishes what this prints
    if state["actionStatus"] != "FINISHED":  # finished once current flows; the goal goes on
        state["actionStatus"] = {STAGE.STAGE_WAIT: "WAITING", STAGE.STAGE_CHARGE: "FINISHED"}.get(stage, status)
    print(json.dumps(state | {"batteryState.charging": stage == STAGE.STAGE_CHARGE}), flush=True)


rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
signal.signal(signal.SIGINT, lambda number, frame: stops.append(number))
client = ActionClient(node := rclpy.create_node("fleet_adapter"), ChargeRobot, "charge_robot")
if not client.wait_for_server(10.0):
    sys.exit("no charger serves charge_robot: start one with `deltacharger up --scene mission_standing`")
report(STAGE.STAGE_WAIT)
sent = client.send_goal_async(goal, lambda message: report(message.feedback.stage))
rclpy.spin_until_future_complete(node, sent)
ended = sent.result().get_result_async()
while not ended.done():
    rclpy.spin_once(node, timeout_sec=0.1)
    if stops:
        stops.clear()
        sent.result().cancel_goal_async()
result = ended.result().result
if not result.success:
    name = next(name for name in dir(RESULT) if name.isupper() and getattr(RESULT, name) == result.error_code)
    error = {"errorType": name, "errorLevel": "FATAL" if result.error_code in FATAL else "WARNING"}
    error["errorReferences"] = [{"referenceKey": "actionId", "referenceValue": goal.request_id}]
    state["errors"] = [error | {"errorDescription": result.error_message}]
report(None, "FAILED")
sys.exit(not result.success)
