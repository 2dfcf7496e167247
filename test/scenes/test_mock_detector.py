# SPDX-License-Identifier: Apache-2.0
"""The mock detector reports the given lean, or none."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from deltacharger.srv import DetectElectrodes
from rclpy.node import Node

from deltacharger_core.rotation import rotation
from deltacharger_scenes.mocks.mock_detector_node import MockDetectorNode

from ..chargers import DEADLINE, Spin
from ..nodes import call, options

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("fault", ["none", "no_normal"])
def test_the_lean_is_as_given_or_unknown(context: Any, namespace: str, spin: Spin, fault: str) -> None:
    given = {"yaw": 0.1, "pitch": -0.2, "roll": 0.3, "lean_stddev": 0.02, "fault": fault}
    spin(MockDetectorNode(**options(context, namespace, **given)))
    asking = spin(Node("asking", **options(context, namespace)))
    client: Any = asking.create_client(DetectElectrodes, "detect_electrodes")
    assert client.wait_for_service(DEADLINE)
    pose = call(client, DetectElectrodes.Request()).detection.pose
    q = pose.pose.orientation
    axes = np.array(rotation(q.x, q.y, q.z, q.w))
    covariance = np.reshape(pose.covariance, (6, 6))
    lean = (math.atan2(axes[0, 2], axes[2, 2]), math.atan2(-axes[1, 2], axes[2, 2]))
    known = fault == "none"
    assert math.atan2(axes[1, 0], axes[0, 0]) == pytest.approx(0.3)
    assert lean == pytest.approx((0.1, -0.2) if known else (0.0, 0.0))
    assert np.sqrt(np.diag(covariance)[3:5]) == pytest.approx([0.02 if known else math.nan] * 2, nan_ok=True)
