# SPDX-License-Identifier: Apache-2.0
"""ChargeRobot for a fleet: one goal, reported like startCharging of VDA5050 2.x, one JSON line per change.

Copy it into an adapter and replace the print by your MQTT client. The action's id is the goal's request_id, so that an
order sent twice does not start a second mission. Ctrl-C is stopCharging: the goal is cancelled, and the charger undocks
and returns. Exit code 0 if the robot was charged, else 1.

    deltacharger up --scene mission_standing     # in another shell
    python examples/charge_robot.py --stop-after-s 5
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import signal
import sys
import threading
from typing import Any

from deltacharger_core import environment

environment.prepare()  # before rclpy if ROS is from pip; a ROS installation needs neither call
environment.isolate()  # the domain of simulated chargers, unless ROS_DOMAIN_ID is set

import rclpy  # noqa: E402
from deltacharger.action import ChargeRobot  # noqa: E402
from deltacharger.msg import DockingState  # noqa: E402
from rclpy.action import ActionClient  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from rclpy.signals import SignalHandlerOptions  # noqa: E402

FEEDBACK, RESULT = ChargeRobot.Feedback, ChargeRobot.Result
CODES = {value: name for name in dir(RESULT) if name.isupper() and isinstance(value := getattr(RESULT, name), int)}
A_PERSON_MUST_ACT = {  # the codes of errorLevel FATAL in docs/fleet.md
    *(RESULT.SERVO_FAULT, RESULT.STUCK, RESULT.SHORT_CIRCUIT, RESULT.REVERSE_POLARITY, RESULT.VOLTAGE_OUT_OF_RANGE),
    *(RESULT.REVERSE_CURRENT, RESULT.CONTACTOR_WELDED, RESULT.INTERNAL),
}


class Action:
    """The state of startCharging, reported at every change."""

    def __init__(self, action_id: str) -> None:
        self.action_id = action_id
        self.status = "WAITING"
        self.charging = False
        self.errors: list[dict[str, Any]] = []
        self._told = ""

    def on_feedback(self, message: Any) -> None:
        if self.status == "WAITING" and message.feedback.stage != FEEDBACK.STAGE_WAIT:
            self.status = "RUNNING"  # startCharging is FINISHED when current flows, and has no INITIALIZING
        self.tell()

    def on_state(self, message: DockingState) -> None:
        self.charging = message.charging and message.request_id == self.action_id
        if self.charging:
            self.status = "FINISHED"
        self.tell()

    def on_result(self, result: Any) -> None:
        if not result.success:
            self.status = "FINISHED" if self.status == "FINISHED" else "FAILED"
            self.errors.append(
                {
                    "errorType": CODES[result.error_code],
                    "errorLevel": "FATAL" if result.error_code in A_PERSON_MUST_ACT else "WARNING",
                    "errorDescription": result.error_message,
                    "errorReferences": [{"referenceKey": "actionId", "referenceValue": self.action_id}],
                }
            )
        self.charging = False
        self.tell()

    def tell(self) -> None:
        state = {"actionId": self.action_id, "actionType": "startCharging", "actionStatus": self.status}
        line = json.dumps({**state, "batteryState.charging": self.charging, "errors": self.errors})
        if line != self._told:
            self._told = line
            print(line, flush=True)  # publish the robot's state here with your MQTT client


def goal_of(options: argparse.Namespace) -> ChargeRobot.Goal:
    goal = ChargeRobot.Goal(request_id=options.id, stop_energy=options.stop_energy_j)
    goal.stop_after.sec = options.stop_after_s
    goal.target.header.frame_id = options.frame
    goal.target.pose.position.x, goal.target.pose.position.y = options.x, options.y
    half = math.radians(options.yaw_deg) / 2
    goal.target.pose.orientation.z, goal.target.pose.orientation.w = math.sin(half), math.cos(half)
    return goal


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--id", default="order-1/startCharging", help="actionId; the goal's request_id")
    parser.add_argument("--frame", default="map", help="the navigator's frame")
    parser.add_argument("--x", type=float, default=2.0, help="where the robot to be charged stands, m")
    parser.add_argument("--y", type=float, default=0.0, help="m")
    parser.add_argument("--yaw-deg", type=float, default=180.0, help="which way its electrodes face")
    parser.add_argument("--stop-energy-j", type=float, default=0.0, help="0 = until it is full")
    parser.add_argument("--stop-after-s", type=int, default=0, help="0 = until it is full")
    parser.add_argument("--namespace", default="", help="of the charger")
    options = parser.parse_args()
    action = Action(options.id)
    with contextlib.ExitStack() as stack:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # else after Ctrl-C the goal could not be cancelled
        stack.callback(rclpy.try_shutdown)
        node = rclpy.create_node("fleet_adapter", namespace=options.namespace)
        latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(DockingState, "docking_state", action.on_state, latched)
        client = ActionClient(node, ChargeRobot, "charge_robot")
        if not client.wait_for_server(10.0):
            print("no charger serves charge_robot: start one by `deltacharger up --scene mission`", file=sys.stderr)
            return 1
        action.tell()
        sent = client.send_goal_async(goal_of(options), action.on_feedback)
        rclpy.spin_until_future_complete(node, sent)
        ended = sent.result().get_result_async()  # every goal is accepted; an impossible one ends with its code
        stop = threading.Event()  # an exception inside a callback could lose the result
        signal.signal(signal.SIGINT, lambda *_: stop.set())
        while not ended.done():
            rclpy.spin_once(node, timeout_sec=0.1)
            if stop.is_set():
                stop.clear()
                sent.result().cancel_goal_async()
        result = ended.result().result
        action.on_result(result)
        measured = not math.isnan(result.energy)  # unknown to a charger without a contactor
        delivered = f"{result.energy:.0f} J delivered" if measured else result.error_message
        print(f"{delivered}, returned: {result.returned}", file=sys.stderr)
        return 0 if result.success else 1


if __name__ == "__main__":
    sys.exit(main())
