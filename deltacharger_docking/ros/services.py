# SPDX-License-Identifier: Apache-2.0
"""What docking asks of other nodes: calls that never wait, and the contactor's lease. Part of docking_node."""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from deltacharger.msg import Misalignment
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe, SetContactor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_core.machine import LONGEST_LEASE
from deltacharger_core.texts import cut
from deltacharger_docking.clearance import FeltPose
from deltacharger_docking.observation import ElectrodePose, Reply, Request, Service
from deltacharger_docking.ros.messages import estimate
from deltacharger_ros.messages import duration
from deltacharger_ros.unknown import unknown_misalignment

_RENEWAL = 0.1  # s between renewals of the lease
_DISCOVERY = 1.5  # s that a service may take to appear: nodes that start together find each other so late
_HOLDER = "docking_node"
_GIVEN_UP = 2.0  # s after which the answer to a renewal is no longer waited for
_FELT = 8  # estimates whose messages are kept; the machine tells the last one it acted on, which may not be the newest
_SAFE = (Service.OPEN, Service.TORQUE_OFF)  # what is still asked for when a goal has failed
_LOOKING = 0.9  # of the time for a detection: why nothing was found must arrive before docking gives up


class Services:
    """Calls services for the machine without waiting and collects the replies; renews the contactor's lease."""

    def __init__(self, node: Node, clock_age: Callable[[Any], float]) -> None:
        self._lock = threading.Lock()
        self._replies: list[Reply] = []
        self._refusal = ""
        self._felt: deque[tuple[FeltPose, Misalignment]] = deque(maxlen=_FELT)
        self._renewals: deque[tuple[Any, float]] = deque()  # futures without an answer, and since when
        self._age = clock_age
        self._renewed = -math.inf
        self._undelivered: list[tuple[Request, float]] = []  # and until when their services are waited for, s
        self._wanted = False
        self._token = ""  # of the closing that is wanted: who does not know it cannot renew the lease
        self._wish = 0  # counts changes of it: an answer to an earlier wish says nothing about the present one
        self._clients: dict[Service, Any] = {
            Service.TORQUE_ON: node.create_client(SetBool, "set_torque"),
            Service.TARE: node.create_client(Trigger, "tare"),
            Service.PROBE: node.create_client(Probe, "probe"),
            Service.ESTIMATE: node.create_client(PredictMisalignment, "predict_misalignment"),
            Service.DETECT: node.create_client(DetectElectrodes, "detect_electrodes"),
        }
        self._clients[Service.TORQUE_OFF] = self._clients[Service.TORQUE_ON]
        self._contactor: Any = node.create_client(SetContactor, "set_contactor")
        self._clients[Service.OPEN] = self._contactor

    def call(self, request: Request) -> None:
        """Send a request; its reply appears in `take`. A service that is not there yet is waited for a moment.

        Requests of one service keep their order: torque on never overtakes torque off.
        """
        client = self._clients[request.service]
        waits = any(self._clients[earlier.service] is client for earlier, _ in self._undelivered)
        if client.service_is_ready() and not waits:
            self._send(request)
        else:
            patience = min(request.timeout or _DISCOVERY, _DISCOVERY)
            self._undelivered.append((request, time.monotonic() + patience))

    def forget(self) -> None:
        """Send no more of what a goal that failed had asked for, but what makes the charger safe."""
        self._undelivered = [each for each in self._undelivered if each[0].service in _SAFE]

    def _deliver(self) -> None:
        """Send what waits for its service, or tell that nobody serves it."""
        waiting, self._undelivered = self._undelivered, []
        for request, end in waiting:
            client = self._clients[request.service]
            if client.service_is_ready():
                self._send(request)
            elif time.monotonic() < end:
                self._undelivered.append((request, end))
            else:
                self._put(Reply(request.number, False, f"no node serves {client.srv_name}"))

    def _send(self, request: Request) -> None:
        client = self._clients[request.service]
        message: Any
        if request.service in (Service.TORQUE_ON, Service.TORQUE_OFF):
            message = SetBool.Request(data=request.service is Service.TORQUE_ON)
        elif request.service is Service.OPEN:
            message = SetContactor.Request(close=False, holder=_HOLDER)
        elif request.service is Service.ESTIMATE:
            message = PredictMisalignment.Request(frames=request.frames)
        elif request.service is Service.DETECT:
            message = DetectElectrodes.Request(timeout=duration(_LOOKING * request.timeout))
        else:
            message = client.srv_type.Request()
        asked = time.monotonic()
        future = client.call_async(message)
        future.add_done_callback(lambda done: self._answer(request, asked, done))

    def take(self) -> tuple[tuple[Reply, ...], str]:
        """Return the replies since the last call, and why the contactor was refused ('' = it was not)."""
        self._deliver()
        with self._lock:
            replies, self._replies = tuple(self._replies), []
            return replies, self._refusal

    def misalignment(self, value: FeltPose | None) -> Misalignment:
        """Return the message that the machine's last estimate came from; NaN where there is none."""
        return next((message for felt, message in list(self._felt) if felt is value), unknown_misalignment())

    def contactor(self, wanted: bool, closed: bool) -> None:
        """Renew the lease while `wanted`, ten times a second; open at once when it no longer is."""
        now = time.monotonic()
        changed, self._wanted = wanted != self._wanted, wanted
        if changed:
            self._token = secrets.token_hex(16) if wanted else ""
            with self._lock:
                self._refusal = ""
                self._wish += 1
        if not (changed or ((wanted or closed) and now - self._renewed >= _RENEWAL)):
            return
        self._renewed = now
        if not self._contactor.service_is_ready():
            if wanted:
                with self._lock:
                    self._refusal = "no node serves set_contactor"
            return
        lease = duration(LONGEST_LEASE)
        message = SetContactor.Request(close=wanted, holder=_HOLDER, lease=lease, token=self._token)
        self._give_up_renewals(now)
        future = self._contactor.call_async(message)
        self._renewals.append((future, now))
        wish = self._wish
        future.add_done_callback(lambda done: self._contactor_answer(wanted, wish, done))

    def _give_up_renewals(self, now: float) -> None:
        """Forget calls that a hung node never answers; each would be kept for ever."""
        while self._renewals and (self._renewals[0][0].done() or now - self._renewals[0][1] > _GIVEN_UP):
            self._contactor.remove_pending_request(self._renewals.popleft()[0])

    def _contactor_answer(self, wanted: bool, wish: int, done: Any) -> None:
        try:
            answer = done.result()
        except Exception:  # as in `_answer`; a renewal that got no answer lapses by itself
            return
        with self._lock:
            if wanted and wish == self._wish and answer is not None and not answer.success:
                self._refusal = cut(answer.message)

    def _answer(self, request: Request, asked: float, done: Any) -> None:
        try:
            answer = done.result()
            payload = self._payload(request, asked, answer) if answer.success else {}
        except Exception as error:  # a service that fails in its node must not end docking's executor
            self._put(Reply(request.number, False, cut(str(error))))
            return
        self._put(Reply(request.number, answer.success, cut(answer.message), **payload))

    def _payload(self, request: Request, asked: float, answer: Any) -> dict[str, Any]:
        """Return what the reply of a service holds besides success and message."""
        service = request.service
        if service is Service.ESTIMATE:
            felt = estimate(answer.misalignment)
            self._felt.append((felt, answer.misalignment))
            named = tuple(answer.sequences) if len(answer.sequences) == request.frames else ()
            return {"estimate": felt, "sequences": named, "asked": asked}
        if service is Service.PROBE:
            return {"resistance": answer.resistance, "target_voltage": answer.target_voltage}
        if service is not Service.DETECT:
            return {}
        seen = answer.detection
        point = seen.pose.pose.position
        variance = float(seen.pose.covariance[35])
        stddev = math.sqrt(variance) if variance >= 0.0 else math.inf  # also where it is NaN: unknown is not exact
        age = abs(self._age(seen.header.stamp))  # an image from the future is as wrong as an old one
        return {"detection": ElectrodePose((point.x, point.y, point.z), seen.roll, stddev, age)}

    def _put(self, reply: Reply) -> None:
        if not reply.number:  # the shell's own requests; numbers of the machine begin with 1 and never come again
            return
        with self._lock:
            self._replies.append(reply)
