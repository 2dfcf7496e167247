"""Answers how far the electrodes are off, from the tactile frames that arrive.

Topics: subscribes `tactile_frame`; publishes `misalignment` (only with `rate` > 0).
Services: `predict_misalignment` averages frames that are sampled after the request.
Parameters: model, frames, rate, max_age, timeout.
It drives nothing; uncommanded it only listens.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from deltacharger.msg import Misalignment, TactileFrame
from deltacharger.srv import PredictMisalignment
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_bringup import node_support
from deltacharger_tactile import MODEL_PATH, PoseEstimator
from deltacharger_tactile.errors import TactileError
from deltacharger_tactile.parameters import COLUMNS, ROWS

_FRAMES_MAX = 240


@dataclass(frozen=True)
class _Frame:
    sampled: float
    stamp: Any
    tared: bool
    left: NDArray[np.float64]
    right: NDArray[np.float64]


class _Refused(Exception):
    """Frames do not allow an estimate; the message says what to do."""


class MisalignmentNode(Node):
    """Serves the pose estimator on the newest tactile frames."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("misalignment_node", **kwargs)
        path = node_support.declare(self, "model", "", "Model file (npz); empty = the packaged one.")
        self._default_frames = node_support.declare(
            self, "frames", 12, "Frames averaged where a request says 0.", 1, _FRAMES_MAX
        )
        rate = node_support.declare(self, "rate", 0.0, "Rate of the topic misalignment, Hz; 0 = off.", 0.0, 120.0)
        self._max_age = node_support.declare(
            self, "max_age", 0.1, "Oldest sampling of the newest frame that still counts, s.", 0.01, 10.0
        )
        self._timeout = node_support.declare(
            self,
            "timeout",
            1.0,
            "Longest wait for frames beyond the time that they take at 120 Hz, s.",
            0.05,
            30.0,
        )
        node_support.reject_unknown(self)
        self._model = _load(self, path)
        self._frames: deque[_Frame] = deque(maxlen=_FRAMES_MAX)
        self._arrived = threading.Condition()
        self._closed = False
        self._publisher = self.create_publisher(Misalignment, "misalignment", QoSProfile(depth=1))
        self.create_subscription(
            TactileFrame,
            "tactile_frame",
            self._receive,
            qos_profile_sensor_data,
            callback_group=MutuallyExclusiveCallbackGroup(),
        )
        self.create_service(
            PredictMisalignment,
            "predict_misalignment",
            self._predict,
            callback_group=ReentrantCallbackGroup(),
        )
        self._thread: threading.Thread | None = None
        if rate > 0.0:
            self._thread = threading.Thread(target=self._publish, args=(1.0 / rate,), name="misalignment", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Release waiting requests and join the publisher."""
        with self._arrived:
            self._closed = True
            self._arrived.notify_all()
        if self._thread is not None:
            self._thread.join(2.0)
            self._thread = None

    def _now(self) -> float:
        return float(self.get_clock().now().nanoseconds) * 1e-9

    def _receive(self, message: TactileFrame) -> None:
        if (message.rows, message.columns) != (ROWS, COLUMNS) or {len(message.left), len(message.right)} != {
            ROWS * COLUMNS
        }:
            self.get_logger().error(
                f"tactile_frame is {message.rows} × {message.columns} with {len(message.left)} and "
                f"{len(message.right)} values, the model needs 10 × 10; ignored",
                throttle_duration_sec=5.0,
            )
            return
        stamp = message.header.stamp
        shape = (ROWS, COLUMNS)
        frame = _Frame(
            stamp.sec + 1e-9 * stamp.nanosec,
            stamp,
            message.tared,
            np.asarray(message.left, dtype=float).reshape(shape),
            np.asarray(message.right, dtype=float).reshape(shape),
        )
        with self._arrived:
            self._frames.append(frame)
            self._arrived.notify_all()

    def _predict(
        self, request: PredictMisalignment.Request, response: PredictMisalignment.Response
    ) -> PredictMisalignment.Response:
        wanted = request.frames or self._default_frames
        response.success = False
        if wanted > _FRAMES_MAX:
            response.message = f"{wanted} frames asked for, at most {_FRAMES_MAX} are kept; ask for fewer"
            return response
        try:
            frames = self._wait(wanted, self._now())
            response.misalignment = self._estimate(frames)
        except _Refused as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _wait(self, wanted: int, since: float) -> list[_Frame]:
        """Wait until `wanted` frames sampled after `since` (s, ROS clock) have arrived."""
        deadline = time.monotonic() + self._timeout + wanted / 120.0
        with self._arrived:
            while True:
                fresh = [frame for frame in self._frames if frame.sampled > since]
                if self._closed:
                    raise _Refused("the node is closing")
                if len(fresh) >= wanted:
                    return fresh[:wanted]
                left = deadline - time.monotonic()
                if left <= 0.0:
                    raise _Refused(self._why_too_few(len(fresh), wanted))
                self._arrived.wait(left)

    def _why_too_few(self, fresh: int, wanted: int) -> str:
        if not self._frames:
            return "no tactile_frame has arrived; check that tactile_node runs"
        age = self._now() - self._frames[-1].sampled
        return (
            f"{fresh} of {wanted} fresh frames in time, the newest is {age:.2f} s old; "
            "check tactile_node and that both hosts' clocks agree"
        )

    def _estimate(self, frames: Sequence[_Frame]) -> Misalignment:
        """Average the frames and estimate.

        Raises:
            _Refused: the frames are stale or not tared.
        """
        age = self._now() - frames[-1].sampled
        if age > self._max_age:
            raise _Refused(f"the newest tactile frame is {age:.3f} s old, more than max_age {self._max_age:g} s")
        if not all(frame.tared for frame in frames):
            raise _Refused("the tactile frames are not tared; call the service tare out of contact")
        # A taxel that was dead in one of the frames is dead in the average.
        left = np.mean([frame.left for frame in frames], axis=0)
        right = np.mean([frame.right for frame in frames], axis=0)
        estimate = self._model.predict(left, right)
        message = Misalignment()
        message.header.stamp = frames[-1].stamp
        message.header.frame_id = "end_effector"
        message.contact, message.sure, message.in_range = estimate.contact, estimate.sure, estimate.in_range
        for name in ("angle", "vertical", "horizontal"):
            setattr(message, name, estimate.__dict__[name])
            setattr(message, f"{name}_stddev", estimate.__dict__[f"{name}_stddev"])
            setattr(message, f"{name}_probability", estimate.__dict__[f"{name}_probability"].astype(np.float32))
        message.left_force, message.right_force = estimate.left_force, estimate.right_force
        message.model = self._model.name
        return message

    def _publish(self, period: float) -> None:
        following = time.monotonic() + period
        with self._arrived:
            while not self._closed:
                left = following - time.monotonic()
                if left > 0.0:
                    self._arrived.wait(left)
                    continue
                following = max(following + period, time.monotonic())
                frames = list(self._frames)[-self._default_frames :]
                if not frames:
                    continue
                try:
                    message = self._estimate(frames)
                except _Refused:
                    continue  # a stale or untared estimate is not published: subscribers watch its age
                self._publisher.publish(message)


def _load(node: Node, path: str) -> PoseEstimator:
    try:
        return PoseEstimator.load(path or MODEL_PATH)
    except (TactileError, OSError) as error:
        raise node_support.StartupError(f"{node.get_name()}: parameter 'model': {error}") from error


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal."""
    return node_support.run(MisalignmentNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
