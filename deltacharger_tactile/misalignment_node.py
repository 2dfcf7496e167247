# SPDX-License-Identifier: Apache-2.0
"""Estimates the misalignment of the electrodes from tactile frames.

Topics: subscribes `tactile_frame` while a request waits or `rate` > 0; publishes `misalignment` if `rate` > 0.
Services: `predict_misalignment` averages frames that are sampled after the request.
Parameters: model, calibration, classifiers, rate, max_age, timeout, frame_prefix.
The node moves nothing.
"""

import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import Misalignment, TactileFrame
from deltacharger.srv import PredictMisalignment
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_core.frames import END_EFFECTOR, FrameParameters
from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_core.ros import clock, log, messages, node_support, on_demand, parameters, qos
from deltacharger_tactile import errors, estimator
from deltacharger_tactile.parameters import FRAMES, FRAMES_MAX, MisalignmentNodeParameters
from deltacharger_tactile.perception import Frame, FrameWindow, Perception, PerceptionError, Refused


def to_frame(message: TactileFrame, sampled: float) -> Frame:
    """Convert a message to a frame sampled at `sampled`, s monotonic.

    Raises:
        FrameError: the message does not hold two pads of 10 × 10.
    """
    sizes = {len(message.left), len(message.right)}
    if (message.rows, message.columns) != (ROWS, COLUMNS) or sizes != {ROWS * COLUMNS}:
        raise errors.FrameError(*((message.rows, message.columns, len(pad)) for pad in (message.left, message.right)))
    left, right = (np.asarray(pad, dtype=float).reshape(ROWS, COLUMNS) for pad in (message.left, message.right))
    return Frame(sampled, message.header.stamp, message.sequence, message.tared, left, right)


def to_message(estimate: estimator.Estimate, name: str, stamp: Any, frame_id: str) -> Misalignment:
    """Convert an estimate of one frame pair to a message.

    Args:
        estimate: pose of the target in end_effector.
        name: of the model.
        stamp: of the newest frame used.
        frame_id: full name of end_effector.
    """
    message = messages.unknown_misalignment(frame_id)  # yaw and pitch stay NaN: the pads do not measure them
    message.header.stamp = stamp
    message.contact, message.sure, message.in_range = estimate.contact, estimate.sure, estimate.in_range
    for axis in ("angle", "vertical", "horizontal"):
        for field in (axis, f"{axis}_stddev"):
            setattr(message, field, getattr(estimate, field))
        setattr(message, f"{axis}_probability", getattr(estimate, f"{axis}_probability").astype(np.float32))
    message.across, message.across_stddev = estimate.across, estimate.across_stddev
    message.left_force, message.right_force = estimate.left_force, estimate.right_force
    message.model = name
    return message


class MisalignmentNode(Node):
    """Estimates the pose from the newest tactile frames."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("misalignment_node", **kwargs)
        self._log = log.Log(self)
        given = parameters.declare_all(self, MisalignmentNodeParameters)
        self._frame_id = parameters.declare_all(self, FrameParameters).named(END_EFFECTOR)
        parameters.reject_unknown(self)
        self._given = given
        try:
            self._perception = Perception.load(given.model, given.calibration, given.classifiers)
        except PerceptionError as error:
            raise node_support.StartupError(f"{self.get_name()}: {error}") from error
        if self._perception.doubt:
            self._log.warning(self._perception.doubt)
        self._window = FrameWindow(time.monotonic)
        self._publisher = self.create_publisher(Misalignment, "misalignment", QoSProfile(depth=1))
        self._frames = on_demand.OnDemandSubscription(
            self, TactileFrame, "tactile_frame", self._receive, qos_profile_sensor_data
        )
        self.create_service(
            PredictMisalignment,
            "predict_misalignment",
            self._predict,
            callback_group=ReentrantCallbackGroup(),
            qos_profile=qos.SERVICE,
        )
        self._regularly = parameters.Regularly(self._publish, "misalignment", given.rate)

    def close(self) -> None:
        """Release waiting requests and stop the publisher."""
        self._window.close()
        self._regularly.stop()

    def _receive(self, message: TactileFrame) -> None:
        try:
            sampled = time.monotonic() - clock.stamp_age(self.get_clock(), message.header.stamp)
            self._window.add_frame(to_frame(message, sampled))
        except errors.FrameError:
            self._log.error(
                f"tactile_frame is {message.rows} × {message.columns} with {len(message.left)} and "
                f"{len(message.right)} values, the model needs 10 × 10; ignored",
                pause=5.0,
            )

    def _predict(
        self, request: PredictMisalignment.Request, response: PredictMisalignment.Response
    ) -> PredictMisalignment.Response:
        given = self._given
        wanted = request.frames or FRAMES
        response.misalignment = messages.unknown_misalignment(self._frame_id)
        if wanted > FRAMES_MAX:
            kept = FRAMES_MAX
            response.message = f"{wanted} frames requested, at most {kept} are kept; request fewer"
            return response
        try:
            perception = self._perception.answering(request.model)
            with self._frames.listening():
                frames = self._window.fresh(wanted, given.timeout)
                response.misalignment = self._estimate(frames, perception, given.max_age)
                response.sequences = [frame.sequence for frame in frames]
        except (PerceptionError, Refused) as error:
            response.message = str(error)
            return response
        response.success = True
        return response

    def _estimate(self, frames: Sequence[Frame], perception: Perception, max_age: float) -> Misalignment:
        """Average the frames and estimate.

        Raises:
            Refused: the frames are stale or not tared.
        """
        left, right = self._window.average(frames, max_age)
        return to_message(perception.predict(left, right), perception.name, frames[-1].stamp, self._frame_id)

    def _publish(self, period: float, stopping: threading.Event) -> None:
        following = time.monotonic() + period
        with self._frames.listening():
            while not stopping.wait(max(following - time.monotonic(), 0.0)):
                following = max(following + period, time.monotonic())
                given = self._given
                frames = self._window.newest(FRAMES)
                if not frames:
                    continue
                try:
                    message = self._estimate(frames, self._perception, given.max_age)
                except Refused:
                    continue  # stale or untared estimates are not published: subscribers check the age
                self._publisher.publish(message)


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until a signal."""
    return node_support.run(MisalignmentNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
