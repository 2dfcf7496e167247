# SPDX-License-Identifier: Apache-2.0
"""misalignment_node with a real ROS client that publishes tactile frames; estimates are in test_perception.py."""

import math
import threading
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deltacharger.msg import Misalignment, TactileFrame
from deltacharger.srv import PredictMisalignment
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data

from deltacharger_tactile import errors, misalignment_node
from deltacharger_tactile.calibration.rig import TactileCalibration

from ..chargers import Spin, wait_until
from ..nodes import call, numbers, options
from .test_perception import TRUTH, docked

pytestmark = pytest.mark.ros


class Pads(Node):
    """Replaces tactile_node: 120 Hz of one simulated docking."""

    def __init__(self, context: Any) -> None:
        super().__init__("pads", **options(context))
        self.publisher = self.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self.client = self.create_client(PredictMisalignment, "predict_misalignment")
        self.received: list[Misalignment] = []
        self.create_subscription(Misalignment, "misalignment", self.received.append, 1)
        self.frames, self.tared, self.delay, self.streaming, self._sent = docked(), True, 0.0, False, 0
        self.create_timer(1 / 120, self._stream)

    def _stream(self) -> None:
        if not self.streaming:
            return
        left, right = self.frames[self._sent % len(self.frames)]
        message = TactileFrame(rows=10, columns=10, pitch=0.0024, tared=self.tared, sequence=self._sent)
        stamp = self.get_clock().now().nanoseconds - int(1e9 * self.delay)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        message.left = array("f", left.ravel().astype(np.float32).tobytes())
        message.right = array("f", right.ravel().astype(np.float32).tobytes())
        self.publisher.publish(message)
        self._sent += 1

    def ask(self, frames: int = 0, model: str = "") -> Any:
        return call(self.client, PredictMisalignment.Request(frames=frames, model=model))


@pytest.fixture
def pads(context: Any, spin: Spin, request: pytest.FixtureRequest, tmp_path: Path) -> Pads:
    # An answer's age depends on this computer's load: these tests show other laws.
    TactileCalibration(rig=8).save(tmp_path / "pads.yaml")
    files = {"calibration": str(tmp_path / "pads.yaml"), "classifiers": "tree"}
    spin(
        misalignment_node.MisalignmentNode(
            **options(context, rate=20.0, max_age=1.0, **files, **getattr(request, "param", {}))
        )
    )
    client: Pads = spin(Pads(context))
    wait_until(lambda: client.client.service_is_ready())
    wait_until(lambda: client.publisher.get_subscription_count() == 1)
    return client


@pytest.mark.version
def test_answers_come_from_fresh_frames_and_list_them(pads: Pads) -> None:
    pads.streaming = True
    asked = pads.get_clock().now().nanoseconds
    answer, second = pads.ask(), pads.ask(12)
    found = answer.misalignment
    assert answer.success, answer.message
    assert found.header.frame_id == "end_effector"
    assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec > asked
    assert (found.contact, found.in_range, found.sure) == (True, True, True)
    across = TRUTH[1] * math.cos(TRUTH[2]) - TRUTH[0] * math.sin(TRUTH[2])
    for name, true in zip(("horizontal", "vertical", "angle", "across"), (*TRUTH, across), strict=True):
        assert abs(getattr(found, name) - true) < 4 * getattr(found, f"{name}_stddev")
    assert np.isnan([found.yaw, found.pitch, found.yaw_stddev, found.pitch_stddev]).all()
    assert (len(found.angle_probability), found.model, found.left_force > 10) == (6, "pose-2+rig8+tree", True)
    assert pads.ask(model="svm").misalignment.model == "pose-2+rig8+svm"
    one, two = list(answer.sequences), list(second.sequences)
    assert len(one) == len(two) == 12
    assert sorted({*one, *two}) == one + two, "each once, increasing, the second's all later"
    wait_until(lambda: pads.received)
    assert pads.received[-1].in_range


@pytest.mark.parametrize("pads", [{"timeout": 0.1}], indirect=True)
def test_refusals_are_unknown_and_list_no_frames(pads: Pads) -> None:
    refused = [("tactile_node", pads.ask(4)), ("240", pads.ask(1000)), ("packaged", pads.ask(model="x" * 100_000))]
    pads.tared, pads.streaming = False, True
    refused.append(("tare", wait_until(lambda: next((each for each in [pads.ask(4)] if "tare" in each.message), None))))
    pads.tared, pads.delay = True, 2.0  # every stamp is now before the request
    refused.append(("old", pads.ask(4)))
    for noun, answer in refused:
        assert not answer.success
        assert noun in answer.message
        assert len(answer.message) < 300
        assert all(map(math.isnan, numbers(answer.misalignment)))
        assert not len(answer.sequences)
    assert not pads.received


def test_a_closing_node_releases_its_requests(context: Any) -> None:
    node = misalignment_node.MisalignmentNode(**options(context, timeout=2.0))
    response, asked = PredictMisalignment.Response(), PredictMisalignment.Request()
    waiting = threading.Thread(target=node._predict, args=(asked, response))
    waiting.start()
    node.close()
    waiting.join()
    node.destroy_node()
    assert (response.success, "clos" in response.message) == (False, True)


@pytest.mark.parametrize(("rows", "columns", "values"), [(5, 20, 100), (10, 10, 99)])
def test_a_frame_of_another_shape_is_refused(rows: int, columns: int, values: int) -> None:
    message = TactileFrame(rows=rows, columns=columns, pitch=0.0024, tared=True)
    message.left = message.right = array("f", [1.0] * values)
    with pytest.raises(errors.FrameError):
        misalignment_node.to_frame(message, 0.0)
