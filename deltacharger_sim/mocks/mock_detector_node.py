# SPDX-License-Identifier: Apache-2.0
"""mock_detector_node: electrode_detector_node without a camera, for tests of the layers above it.

Publishes: electrode_detection on request. Serves: detect_electrodes.
Parameters: reported pose of the electrodes (x, y, z, roll in charger_base), and `fault`, which may be changed at
runtime:

nothing        it finds no electrodes
beyond_reach   the electrodes are reported 0.5 m away
leaning        the faces are yawed by 10 degrees
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ElectrodeDetection
from deltacharger.srv import DetectElectrodes
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from deltacharger_core.frames import CHARGER_BASE, FrameParameters
from deltacharger_core.ros import messages, node_support, parameters, qos
from deltacharger_sim.mocks.parameters import DETECTOR_FAULTS, MockDetectorNodeParameters, fault_switch
from deltacharger_vision.mount import Placed, leaning_normal
from deltacharger_vision.ros.messages import detection_message

_FAR = 0.5  # m
_YAW = math.radians(10.0)
_DEVIATIONS = (0.001, 0.001, 0.001, 0.009, 0.009, 0.004)  # m and rad, standard deviations
_CAMERA = (0.0, 0.12, -0.12)  # m


class MockDetectorNode(Node):
    """See the module's docstring."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("electrode_detector_node", **kwargs)
        given = parameters.declare_all(self, MockDetectorNodeParameters)
        self._frame_id = parameters.declare_all(self, FrameParameters).named(CHARGER_BASE)
        parameters.reject_unknown(self)
        self._given = given
        self._fault = fault_switch(self, DETECTOR_FAULTS)
        self._detections = self.create_publisher(ElectrodeDetection, "electrode_detection", qos.DEFAULT_DEPTH)
        self.create_service(
            DetectElectrodes,
            "detect_electrodes",
            self._on_detect,
            callback_group=ReentrantCallbackGroup(),
            qos_profile=qos.SERVICE,
        )

    def close(self) -> None:
        """No effect: this node commands nothing."""

    def _on_detect(
        self, request: DetectElectrodes.Request, response: DetectElectrodes.Response
    ) -> DetectElectrodes.Response:
        fault = self._fault()
        if fault == "nothing":
            messages.unknown(response)
            response.message = "no electrodes in the image; turn the robot toward the target or clean the lens"
            return response
        detection = self._detection(fault)
        self._detections.publish(detection)
        response.success = True
        response.message = "found"
        response.detection = detection
        return response

    def _detection(self, fault: str) -> ElectrodeDetection:
        given, stamp = self._given, self.get_clock().now().to_msg()
        position = np.array([given.x, given.y, _FAR if fault == "beyond_reach" else given.z])
        normal = leaning_normal(_YAW if fault == "leaning" else 0.0, 0.0)
        placed = Placed(position, given.roll, normal, np.diag(np.square(_DEVIATIONS)))
        return detection_message(placed, stamp, 0.95, math.dist(position, _CAMERA), self._frame_id)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(MockDetectorNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
