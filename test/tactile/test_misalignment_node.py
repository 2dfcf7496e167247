"""misalignment_node seen by a real ROS client that publishes tactile frames."""

from __future__ import annotations

import os
import threading
import time
from array import array
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
os.environ.setdefault("ROS_DOMAIN_ID", "57")

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("deltacharger.msg")

from deltacharger.msg import Misalignment, TactileFrame  # noqa: E402
from deltacharger.srv import PredictMisalignment  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import qos_profile_sensor_data  # noqa: E402

from deltacharger_bringup.node_support import Spinner, StartupError  # noqa: E402
from deltacharger_tactile.misalignment_node import MisalignmentNode  # noqa: E402
from deltacharger_tactile.source import ContactSource  # noqa: E402

TRUTH = (0.001, 0.003, 0.08)


def wait_for(condition: Callable[[], object], timeout: float = 5.0) -> None:
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, "the condition did not come true in time"
        time.sleep(0.002)


class Pads(Node):
    """What tactile_node is to misalignment_node: 120 Hz of one simulated docking."""

    def __init__(self, context: Any) -> None:
        super().__init__("pads", context=context)
        self.publisher = self.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self.client = self.create_client(PredictMisalignment, "predict_misalignment")
        self.heard: list[Misalignment] = []
        self.create_subscription(Misalignment, "misalignment", self.heard.append, 1)
        self.tared, self.delay, self.streaming = True, 0.0, False
        source = ContactSource(rig_seed=21, seed=3)
        tare = np.mean([source.sample(i / 120, None, 0.0) for i in range(60)], axis=0)
        source.begin_docking()
        self.frames = [np.maximum(source.sample(1 + i / 120, TRUTH, 65.0) - tare, 0.0) for i in range(120)]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._stream, daemon=True)
        self._thread.start()

    def _stream(self) -> None:
        count = 0
        while not self._stop.wait(1 / 120):
            if not self.streaming:
                continue
            left, right = self.frames[count % len(self.frames)]
            message = TactileFrame(rows=10, columns=10, pitch=0.0024, tared=self.tared, sequence=count)
            stamp = self.get_clock().now().nanoseconds - int(1e9 * self.delay)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            message.left = array("f", left.ravel().astype(np.float32).tobytes())
            message.right = array("f", right.ravel().astype(np.float32).tobytes())
            self.publisher.publish(message)
            count += 1

    def ask(self, frames: int = 0) -> Any:
        future = self.client.call_async(PredictMisalignment.Request(frames=frames))
        wait_for(future.done)
        return future.result()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2.0)


@pytest.fixture(scope="module")
def context() -> Iterator[Any]:
    own = rclpy.Context()
    own.init(args=[])
    yield own
    own.try_shutdown()


@pytest.fixture
def pads(context: Any) -> Iterator[Pads]:
    node = MisalignmentNode(
        context=context,
        parameter_overrides=[Parameter("rate", value=20.0), Parameter("timeout", value=0.4)],
    )
    spinner = Spinner(node)
    client = Pads(context)
    client_spinner = Spinner(client)
    wait_for(client.client.service_is_ready)
    wait_for(lambda: client.publisher.get_subscription_count() == 1)
    yield client
    client_spinner.close()
    spinner.close()
    node.close()


def test_answers_from_fresh_frames_and_publishes(pads: Pads) -> None:
    pads.streaming = True
    asked = pads.get_clock().now().nanoseconds
    answer = pads.ask()
    assert answer.success, answer.message
    found = answer.misalignment
    assert found.header.frame_id == "end_effector"
    assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec > asked
    assert found.contact
    assert found.in_range
    assert found.sure
    assert abs(found.angle - TRUTH[2]) < 4 * found.angle_stddev
    assert abs(found.vertical - TRUTH[1]) < 4 * found.vertical_stddev
    assert abs(found.horizontal - TRUTH[0]) < 4 * found.horizontal_stddev
    assert len(found.angle_probability) == 6
    assert found.model.startswith("pose")
    assert found.left_force > 10
    wait_for(lambda: pads.heard)
    assert pads.heard[-1].in_range


def test_refuses_without_frames_untared_and_stale(pads: Pads) -> None:
    silent = pads.ask()
    assert not silent.success
    assert "tactile_node" in silent.message
    pads.tared, pads.streaming = False, True
    untared = pads.ask(4)
    assert not untared.success
    assert "tare" in untared.message
    pads.tared, pads.delay = True, 2.0  # every stamp lies before the request now
    stale = pads.ask(4)
    assert not stale.success
    assert "old" in stale.message
    assert not pads.heard
    too_many = pads.ask(1000)
    assert not too_many.success
    assert "240" in too_many.message


def test_a_bad_model_stops_the_start(context: Any) -> None:
    with pytest.raises(StartupError, match="model"):
        MisalignmentNode(context=context, parameter_overrides=[Parameter("model", value="/nowhere.npz")])
    with pytest.raises(StartupError, match="max_age"):
        MisalignmentNode(context=context, parameter_overrides=[Parameter("maxage", value=1.0)])
