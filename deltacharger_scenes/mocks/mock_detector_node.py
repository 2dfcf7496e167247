# SPDX-License-Identifier: Apache-2.0
"""mock_detector_node: electrode_detector_node without a camera, for tests of everything above it.

Publishes: electrode_detection when asked. Serves: detect_electrodes.
Parameters: where the electrodes seem to be (x, y, z, roll in charger_base), its uncertainty, and `fault`, which may be
set while it runs:

nothing        it finds no electrodes
stale          the image is 10 s old
beyond_reach   the electrodes seem to be 0.5 m away
unsure_roll    the roll's standard deviation is 10 degrees
leaning        the faces seem to be yawed by 10 degrees; else their lean is unknown
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.node import Node

from deltacharger_ros import node_support, qos
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.qos import SERVICE
from deltacharger_ros.unknown import unknown
from deltacharger_scenes.mocks.fault_switch import FaultSwitch
from deltacharger_scenes.mocks.parameters import DETECTOR_FAULTS, MockDetectorNodeParameters

_STALE_AGE = 10.0  # s
_FAR = 0.5  # m
_ABOUT_X, _ABOUT_Y, _ABOUT_Z = 21, 28, 35  # of the 6 × 6 covariance, row-major: variances of the rotations
_YAW, _YAW_STDDEV = math.radians(10.0), math.radians(0.5)
_UNSURE_ROLL = math.radians(10.0)


class MockDetectorNode(Node):
    """See the module's docstring."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("electrode_detector_node", **kwargs)
        given = declare_all(self, MockDetectorNodeParameters)
        reject_unknown(self)
        self._given = given
        self._fault = FaultSwitch(self, DETECTOR_FAULTS, given.fault_delay)
        self._detections = self.create_publisher(ElectrodeDetection, "electrode_detection", qos.DEFAULT_DEPTH)
        self.create_service(
            DetectElectrodes,
            "detect_electrodes",
            self._on_detect,
            callback_group=ReentrantCallbackGroup(),
            qos_profile=SERVICE,
        )

    def close(self) -> None:
        """Nothing to make safe: this node drives nothing."""

    def _on_detect(
        self, request: DetectElectrodes.Request, response: DetectElectrodes.Response
    ) -> DetectElectrodes.Response:
        fault = self._fault.active()
        if fault == "nothing":
            unknown(response)
            response.message = "no electrodes in the image; turn the robot toward the target or clean the lens"
            return response
        detection = self._detection(fault)
        self._detections.publish(detection)
        response.success = True
        response.message = "found"
        response.detection = detection
        return response

    def _detection(self, fault: str) -> ElectrodeDetection:
        detection = ElectrodeDetection()
        stamp = self.get_clock().now()
        if fault == "stale":
            stamp -= Duration(seconds=_STALE_AGE)
        detection.header.stamp = stamp.to_msg()
        detection.header.frame_id = "charger_base"
        pose = detection.pose.pose
        pose.position.x, pose.position.y = self._given.x, self._given.y
        pose.position.z = _FAR if fault == "beyond_reach" else self._given.z
        leans, roll = fault == "leaning", 0.5 * self._given.roll
        yaw = 0.5 * _YAW if leans else 0.0
        turn = pose.orientation  # by the yaw about y, of what is rolled about z
        turn.x, turn.y = math.sin(yaw) * math.sin(roll), math.sin(yaw) * math.cos(roll)
        turn.z, turn.w = math.cos(yaw) * math.sin(roll), math.cos(yaw) * math.cos(roll)
        covariance = [0.0] * 36
        for index in (0, 7, 14):
            covariance[index] = self._given.position_stddev**2
        covariance[_ABOUT_X] = covariance[_ABOUT_Y] = _YAW_STDDEV**2 if leans else math.nan
        covariance[_ABOUT_Z] = (_UNSURE_ROLL if fault == "unsure_roll" else self._given.roll_stddev) ** 2
        detection.pose.covariance = covariance
        detection.roll = math.atan2(math.tan(2.0 * roll), math.cos(2.0 * yaw))  # as the camera sees it
        detection.confidence = 0.95
        detection.range = math.dist((pose.position.x, pose.position.y, pose.position.z), (0.0, 0.12, -0.12))
        return detection


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; the executable."""
    return node_support.run(MockDetectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
