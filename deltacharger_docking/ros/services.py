# SPDX-License-Identifier: Apache-2.0
"""Docking's requests to other nodes: calls without waiting, and the contactor's lease. Part of docking_node."""

import math
import secrets
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Any

from deltacharger.msg import Misalignment
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe, SetContactor
from rclpy.node import Node
from std_srvs.srv import SetBool, Trigger

from deltacharger_core import frames, machine, texts
from deltacharger_core.machine import LONGEST_LEASE
from deltacharger_core.ros import action_caller, clock, messages, qos
from deltacharger_docking import clearance, observation
from deltacharger_docking.ros.messages import refined, seen

_RENEWAL = 0.05  # s between renewals of the lease, which outlives a stall of four fifths of it
_DISCOVERY = 1.5  # s for a service to appear: discovery takes that long for nodes that start together
_HOLDER = "docking_node"
_GIVEN_UP = 2.0  # s after which the answer to a renewal is no longer expected
_SAFE = (
    observation.Service.OPEN,
    observation.Service.TORQUE_OFF,
)  # requests that are still sent after a goal has failed
_LOOKING = 0.9  # of the time for a detection: the detector's reason must arrive before docking gives up


class Services:
    """Calls services for the machine without waiting and collects the replies; renews the contactor's lease.

    Args:
        node: calls.
        transforms: how its frames are named.
    """

    def __init__(
        self,
        node: Node,
        transforms: frames.TransformParameters,
    ) -> None:
        self._charger_base, self._end_effector = (
            transforms.named(frames.CHARGER_BASE),
            transforms.named(frames.END_EFFECTOR),
        )
        self._lock = threading.Lock()
        self._replies: list[observation.Reply] = []
        self._refusal = ""
        self._renewals: deque[tuple[Any, float]] = deque()  # unanswered futures, with their start
        self._clock = node.get_clock()
        self._renewed = -math.inf
        self._undelivered: list[
            tuple[observation.Request, float]
        ] = []  # with the time until which their services may appear, s
        self._token = ""  # of the requested closing, '' = none: needed to renew the lease
        self._clients: dict[observation.Service, Any] = {
            observation.Service.TORQUE_ON: node.create_client(SetBool, "set_torque", qos_profile=qos.SERVICE),
            observation.Service.TARE: node.create_client(Trigger, "tare", qos_profile=qos.SERVICE),
            observation.Service.PROBE: node.create_client(Probe, "probe", qos_profile=qos.SERVICE),
            observation.Service.ESTIMATE: node.create_client(
                PredictMisalignment, "predict_misalignment", qos_profile=qos.SERVICE
            ),
            observation.Service.DETECT: node.create_client(
                DetectElectrodes, "detect_electrodes", qos_profile=qos.SERVICE
            ),
        }
        self._clients[observation.Service.TORQUE_OFF] = self._clients[observation.Service.TORQUE_ON]
        self._contactor: Any = node.create_client(SetContactor, "set_contactor", qos_profile=qos.SERVICE)
        self._clients[observation.Service.OPEN] = self._contactor

    def call(self, request: observation.Request) -> None:
        """Send a request; its reply appears in `take`. A service may take a moment to appear.

        Requests of one service keep their order: torque on never overtakes torque off.
        """
        patience = min(request.timeout or _DISCOVERY, _DISCOVERY)
        self._undelivered.append((request, time.monotonic() + patience))
        self._deliver()

    def is_served(self, service: observation.Service) -> bool:
        """Return whether a node serves it now."""
        return bool(self._clients[service].service_is_ready())

    def forget(self) -> None:
        """Drop unsent requests of a failed goal, except those that make the charger safe."""
        self._undelivered = [each for each in self._undelivered if each[0].service in _SAFE]

    def _deliver(self) -> None:
        """Send requests whose service is available; reply to those whose service did not appear in time."""
        waiting, self._undelivered = self._undelivered, []
        clients = {self._clients[request.service] for request, _ in waiting}
        ready = {client for client in clients if client.service_is_ready()}  # once per client, to keep the order
        for request, end in waiting:
            client = self._clients[request.service]
            if client in ready:
                self._send(request)
            elif time.monotonic() < end:
                self._undelivered.append((request, end))
            else:
                self._put(observation.Reply(request.number, False, f"no node serves {client.srv_name}"))

    def _send(self, request: observation.Request) -> None:
        client = self._clients[request.service]
        fields: dict[observation.Service, dict[str, Any]] = {
            observation.Service.TORQUE_ON: {"data": True},
            observation.Service.TORQUE_OFF: {"data": False},
            observation.Service.OPEN: {"close": False, "holder": _HOLDER},
            observation.Service.ESTIMATE: {"frames": request.frames},
            observation.Service.DETECT: {"timeout": messages.duration(_LOOKING * request.timeout)},
        }
        asked = time.monotonic()
        future = client.call_async(client.srv_type.Request(**fields.get(request.service, {})))
        future.add_done_callback(lambda done: self._answer(request, asked, done))

    def take_replies(self) -> tuple[tuple[observation.Reply, ...], str]:
        """Return the replies since the last call, and why the contactor was refused ('' = it was not)."""
        self._deliver()
        with self._lock:
            replies, self._replies = tuple(self._replies), []
            return replies, self._refusal

    def misalignment(self, value: clearance.MisalignmentEstimate | None) -> Misalignment:
        """Return the message of the machine's last estimate, with the refined values; NaN without an estimate."""
        if value is None or value.source is None:
            return messages.unknown_misalignment(self._end_effector)
        return refined(value, value.source)

    def contactor(self, wanted: bool, closed: bool, limits: machine.ChargeLimits | None = None) -> None:
        """Renew the lease while `wanted`, twenty times a second; open at once when no longer wanted.

        Each request carries the limits, because the first one may be lost; of later ones the current counts.
        """
        now = time.monotonic()
        changed = wanted != bool(self._token)
        if changed:
            with self._lock:
                self._token = secrets.token_hex(16) if wanted else ""
                self._refusal = ""
        if not (changed or ((wanted or closed) and now - self._renewed >= _RENEWAL)):
            return
        self._renewed = now
        if not self._contactor.service_is_ready():
            if wanted:
                with self._lock:
                    self._refusal = "no node serves set_contactor"
            return
        message = SetContactor.Request(
            close=wanted, holder=_HOLDER, lease=messages.duration(LONGEST_LEASE), token=self._token
        )
        if wanted and limits is not None:
            message.current_max, message.voltage_max, message.dead_port = limits[:3]
            message.start_time, message.gap_time = limits[3:]
        # Calls that a hung node never answers are removed; otherwise each would be kept for ever.
        while self._renewals and (self._renewals[0][0].done() or now - self._renewals[0][1] > _GIVEN_UP):
            self._contactor.remove_pending_request(self._renewals.popleft()[0])
        future = self._contactor.call_async(message)
        self._renewals.append((future, now))
        token = self._token
        future.add_done_callback(lambda done: self._contactor_answer(token, done))

    def _contactor_answer(self, token: str, done: Any) -> None:
        """Store why the closing with this token was refused; ignore answers to an earlier closing."""
        answer = action_caller.result_of(done)  # an unanswered renewal lapses by itself
        with self._lock:
            if token and token == self._token and answer is not None and not answer.success:
                self._refusal = texts.cut(answer.message)

    def _answer(self, request: observation.Request, asked: float, done: Any) -> None:
        try:
            answer = done.result()
            payload = self._payload(request, asked, answer) if answer.success else {}
        except Exception as error:  # a failed service call must not end docking's executor
            self._put(observation.Reply(request.number, False, texts.cut(str(error))))
            return
        self._put(observation.Reply(request.number, answer.success, texts.cut(answer.message), **payload))

    def _payload(self, request: observation.Request, asked: float, answer: Any) -> dict[str, Any]:
        """Return the fields of a reply in addition to success and message."""
        service = request.service
        if service is observation.Service.ESTIMATE:
            measured = replace(clearance.MisalignmentEstimate.of(answer.misalignment), source=answer.misalignment)
            named = tuple(answer.sequences) if len(answer.sequences) == request.frames else ()
            return {"estimate": measured, "sequences": named, "asked": asked}
        if service is observation.Service.PROBE:
            return {"resistance": answer.resistance, "target_voltage": answer.target_voltage}
        if service is not observation.Service.DETECT:
            return {}
        # An image with a stamp in the future is as wrong as an old one.
        old = abs(clock.age(self._clock, messages.seconds(answer.detection.header.stamp)))
        return {"detection": seen(answer.detection, old, self._charger_base)}

    def _put(self, reply: observation.Reply) -> None:
        with self._lock:
            self._replies.append(reply)
