# SPDX-License-Identifier: Apache-2.0
"""docking_recorder_node: one MCAP file per docking in a bounded folder.

Subscribes to a record's topics (mcap_recording.TOPICS), undecoded. Requests the results of all dock and undock goals,
and docking_node's parameters. Publishes /diagnostics. It commands nothing: a full disk, an unwritable folder, a missing
library or its own end never affects docking. One thread reads the topics and writes.
"""

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from deltacharger.action import Dock, Undock
from rclpy.node import Node

from deltacharger_bringup.records.node_parameters import ParameterReader
from deltacharger_bringup.records.recording import docking_recorder, folder, mcap_recording
from deltacharger_core import environment, files, mcap_file, real_time
from deltacharger_core.ros import diagnostics, log, messages, node_support, parameters, qos

_POLL = 0.02  # s between reads of the topics
_TICK = 0.2  # s between calls of the recorder's `tick`
_DIAGNOSTICS = 1.0  # s
_GOALS_MAX = 100  # goals whose results were requested
_ID = slice(4, 20)  # of the goal's id in a feedback's CDR, after the encapsulation header


class DockingRecorderNode(Node):
    """Records dockings; docs/records.md describes the files."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("docking_recorder_node", **kwargs)
        self._log = log.Log(self)
        given = parameters.declare_all(self, folder.DockingRecorderNodeParameters)
        parameters.reject_unknown(self)
        environment.prepare()
        self._folder = files.given_path(given.folder)
        self._recorder = docking_recorder.DockingRecorder(
            folder.RecordFolder(self._folder, given.max_megabytes * 10**6),
            {self.resolve_topic_name(topic.name): topic for topic in mcap_recording.TOPICS},
            {"version": environment.package_version(), "scene": given.scene, "namespace": self.get_namespace()},
        )
        try:
            mcap_file.require_mcap()
            for topic in mcap_recording.TOPICS:
                mcap_recording.schema_text(topic.kind)  # report a missing definition now, not at the first docking
        except mcap_file.RecordingError as error:
            self._recorder.fail(error)
            self._log.error(self._recorder.problem)
        self._state = self.resolve_topic_name(mcap_recording.STATE)
        self._feedback = {
            self.resolve_topic_name(f"{action}/_action/feedback"): action for action in mcap_recording.ACTIONS
        }
        self._asked: deque[bytes] = deque(maxlen=_GOALS_MAX)
        self._received: deque[Callable[[], None]] = deque()
        self._stopping = threading.Event()
        self._results: dict[str, Any] = {
            action: self.create_client(
                kind.Impl.GetResultService, f"{action}/_action/get_result", qos_profile=qos.SERVICE
            )
            for action, kind in zip(mcap_recording.ACTIONS, (Dock, Undock), strict=True)
        }
        self._docking_parameters = ParameterReader(self, "docking_node")
        self._diagnostics = diagnostics.Diagnostics(self)
        self._topics = mcap_recording.PolledTopics(self, mcap_recording.TOPICS)
        self._thread = threading.Thread(target=self._loop, name="docking recorder", daemon=True)
        self._thread.start()

    @property
    def problem(self) -> str:
        """Why the current or last docking is not recorded; '' = it is."""
        return self._recorder.problem

    def close(self) -> None:
        """Write the received messages, and complete the current record. Safe to call twice."""
        self._stopping.set()
        self._thread.join(10.0)

    def _take(self, message: mcap_file.Raw) -> None:
        self._recorder.take_message(time.monotonic() - real_time.HOST.age(1e-9 * message.received), message)
        action = self._feedback.get(message.topic)
        if action is not None:
            self._ask_result(action, message.data[_ID])

    def _ask_result(self, action: str, goal: bytes) -> None:
        """Request once the result of a goal of any client; the answer arrives when the goal ends."""
        if goal in self._asked or len(goal) != _ID.stop - _ID.start:  # a foreign feedback may be short
            return
        self._asked.append(goal)
        client = self._results[action]

        def on_result(done: Any) -> None:
            answer = done.result() if done.exception() is None else None
            if answer is not None and answer.status:
                self._received.append(lambda: self._recorder.take_result(messages.to_outcome(action, answer.result)))

        request = client.srv_type.Request()
        request.goal_id.uuid = list(goal)
        client.call_async(request).add_done_callback(on_result)

    def _on_parameters(self, values: dict[str, Any]) -> None:
        self._received.append(lambda: self._recorder.take_parameters(values))

    def _loop(self) -> None:
        ticked = diagnosed = 0.0
        recorded: Path | None = None
        while True:
            last = self._stopping.is_set()
            try:
                self._work()
                if last:
                    self._recorder.close()
                    return
                now = time.monotonic()
                if now - ticked >= _TICK:
                    ticked = now
                    self._recorder.tick(now, self.count_publishers(self._state) > 0)
                if self._recorder.path not in (None, recorded) and self._docking_parameters.is_ready():
                    self._docking_parameters.ask(self._on_parameters)
                recorded = self._recorder.path
                if now - diagnosed >= _DIAGNOSTICS:
                    diagnosed = now
                    self._diagnose()
            except Exception as error:  # no error here may affect docking
                if last:
                    return
                self._recorder.fail(error)
                self._log.error(f"unexpected error while recording: {type(error).__name__}: {error}")
            self._stopping.wait(_POLL)

    def _work(self) -> None:
        for message in self._topics.take_messages():
            self._take(message)
        while self._received:
            self._received.popleft()()

    def _diagnose(self) -> None:
        recorder = self._recorder
        level, text = diagnostics.OK, "waiting for a docking"
        if recorder.path is not None:
            text = f"recording {recorder.path.name}"
        if recorder.problem:
            level, text = diagnostics.ERROR, recorder.problem
        self._diagnostics.report(level, text, {"folder": self._folder}, "recording")


def main(args: Sequence[str] | None = None) -> int:
    """Run docking_recorder_node until SIGINT or SIGTERM; 0 after a signal, 2 if it cannot start as configured."""
    return node_support.run(DockingRecorderNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
