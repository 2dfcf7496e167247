# SPDX-License-Identifier: Apache-2.0
"""mock_tactile_node: tactile_node without a board, for tests of the layers above it.

Subscribes: servo_state (for the end effector's position and force). Publishes: tactile_frame, charger_power.
Serves: tare, set_contactor, probe, with the real node's lease rules (by its code).
Frames come from deltacharger_sim's pads, so that misalignment_node works with them.
Parameters: pose of the target in the plane z = DOCK_DISTANCE, and `fault`, which may be changed at runtime:

silence             tactile_frame stops
short               the probe finds a short
contactor_refusal   a close is refused
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ServoState
from deltacharger.srv import Probe, SetContactor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_core import machine
from deltacharger_core.frames import END_EFFECTOR, FrameParameters
from deltacharger_core.ros import messages, node_support, on_demand, parameters, qos
from deltacharger_driver.board import contactor, protocol, tactile_node
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_sim.mocks.parameters import TACTILE_FAULTS, MockTactileNodeParameters, fault_switch
from deltacharger_sim.pads import ContactSource, contact_force
from deltacharger_tactile.parameters import TactileParameters

BATTERY = 26.0  # V, within machine.BATTERY_MIN and BATTERY_MAX
TARGET = 23.5  # V, of a live port
CHARGE_CURRENT = 5.0  # A once ramped up, or less if the limits allow less
_RISE = 0.1  # s, time constant of the ramp


class MockPower:
    """The board's power stage as tactile_node's clients see it.

    Attributes:
        lease: on the contactor, by the driver's own code.
        closed: whether the contactor is closed.
        current: A into the target.
    """

    def __init__(self) -> None:
        self.lease = contactor.ContactorLease()
        self.closed = False
        self.current = 0.0
        self._current_max = 0.0
        self._last = math.inf

    def advance(self, now: float, contact: bool) -> None:
        """Advance to `now` (s), with or without contact between the electrodes."""
        step, self._last = max(now - self._last, 0.0), now
        if self.lease.has_lapsed(now):
            self.open()
        aim = min(CHARGE_CURRENT, self._current_max)
        self.current = aim + (self.current - aim) * math.exp(-step / _RISE) if self.closed and contact else 0.0

    def probe(self, now: float, contact: bool, short: bool = False) -> tuple[float, float]:
        """Look at the port, as `port_of` takes it; the result allows a close for 2 s.

        Raises:
            LeaseRefused: the contactor is closed.
        """
        if self.closed:
            raise contactor.LeaseRefused("the contactor is closed: open it before probing")
        found = (math.inf, 0.0) if not contact else (0.05, 0.0) if short else (math.nan, TARGET)
        self.lease.probed(*found, now)
        return found

    def close(
        self, holder: str, duration: float, now: float, token: str = "", limits: machine.ChargeLimits | None = None
    ) -> None:
        """Close, or renew with another current or the same (0).

        Raises:
            LeaseRefused: by the lease.
        """
        self.lease.grant(holder, duration, now, token, limits)
        self._current_max = (0.0 if limits is None else limits.current) or self._current_max
        self.closed = True

    def open(self) -> None:
        """Open the contactor."""
        self.lease.opened()
        self.closed, self.current = False, 0.0


_TARE_FRAMES = 20
_POWER_RATE = 20.0  # Hz
_PROBE_TIME = 0.05  # s


class MockTactileNode(Node):
    """See the module's docstring."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tactile_node", **kwargs)
        given, frames = (
            parameters.declare_all(self, MockTactileNodeParameters),
            parameters.declare_all(self, FrameParameters),
        )
        parameters.reject_unknown(self)
        self._given = given
        self._fault = fault_switch(self, TACTILE_FAULTS)
        self._lock = threading.Lock()
        self._model = TactileParameters()
        self._source = ContactSource(self._model, 0, 0)
        self._power = MockPower()
        self._delta = ScalarDelta()
        self._position = (math.nan,) * 3
        self._push = 0.0
        self._jitter: tuple[float, float, float] | None = None
        self._tare: np.ndarray[Any, np.dtype[np.float64]] | None = None
        self._newest: np.ndarray[Any, np.dtype[np.float64]] = np.zeros((machine.PADS, machine.ROWS, machine.COLUMNS))
        self._recent: list[np.ndarray[Any, np.dtype[np.float64]]] = []
        self._sequence = 0
        self._began = time.monotonic()
        self._samples = tactile_node.SamplePublishers(self, qos.LATEST, frames.named(END_EFFECTOR))
        group = ReentrantCallbackGroup()
        self._servos = on_demand.LatestMessage(self, ServoState, "servo_state", qos.LATEST)
        self.create_service(Trigger, "tare", self._on_tare, callback_group=group, qos_profile=qos.SERVICE)
        self.create_service(Probe, "probe", self._on_probe, callback_group=group, qos_profile=qos.SERVICE)
        self.create_service(
            SetContactor,
            "set_contactor",
            self._on_contactor,
            callback_group=ReentrantCallbackGroup(),
            qos_profile=qos.SERVICE,
        )
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="mock board", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Open the contactor and join the thread."""
        self._stop.set()
        self._thread.join(2.0)
        with self._lock:
            self._power.open()
            power = self._power_sample(time.monotonic())
        if self.context.ok():
            self._samples.power(*power)  # clients that wait for it to open receive this even if all nodes end at once

    @property
    def contactor_closed(self) -> bool:
        """Whether the contactor is closed; for tests, which may bypass the interface."""
        with self._lock:
            return self._power.closed

    def _run(self) -> None:
        period = 1.0 / machine.FRAME_RATE
        due = next_power = time.monotonic()
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            now = time.monotonic()
            # Polled: a frame stamped now shows the arm where it is now, even if the node's executor is delayed.
            if (servos := self._servos.take()) is not None:
                self._feel(servos)
            with self._lock:
                self._power.advance(now, self._touching())
                frame = self._sample(now)
                power = self._power_sample(now) if now >= next_power else None
            if power is not None:
                next_power = max(next_power + 1.0 / _POWER_RATE, now)
            if self.context.ok():
                if self._fault() != "silence":
                    self._samples.frame(frame)
                if power is not None:
                    self._samples.power(*power)
            due = max(due + period, now - period)

    def _touching(self) -> bool:
        return self._position[2] > machine.DOCK_DISTANCE

    def _sample(self, now: float) -> protocol.TactileSample:
        """Read the pads as the board would: raw, minus tare, clipped at 0."""
        pose = None
        force = 0.0
        if self._touching():
            if self._jitter is None:
                self._jitter = self._source.begin_docking()
            x, y = self._given.target_x - self._position[0], self._given.target_y - self._position[1]
            pose = (x + self._jitter[0], y + self._jitter[1], self._given.target_angle + self._jitter[2])
            pull = contact_force(self._model.docking, np.array([pose[:2]]), np.zeros(1), self._source.rig.magnets)
            force = float(pull[0]) + max(self._push, 0.0)
        else:
            self._jitter = None
        raw = np.stack(self._source.sample(now, pose, force))
        self._recent = [*self._recent[1 - _TARE_FRAMES :], raw]
        taxels = raw if self._tare is None else np.maximum(raw - self._tare, 0.0)
        self._newest = taxels
        self._sequence += 1
        pads = taxels.astype(np.float32)
        device_time = int((now - self._began) * 1e6)
        return protocol.TactileSample(now, self._sequence, device_time, pads, self._tare is not None, False)

    def _power_sample(self, now: float) -> tuple[protocol.PowerSample, float, float, tuple[bool, float]]:
        """Return the power stage's state, ohm and age (s) of the last probe, and the stage as in `Hello`."""
        stage = self._power
        voltage = TARGET if self._touching() else math.nan
        power = protocol.Power(BATTERY, voltage, stage.current, stage.closed, 0, stage.current)
        return protocol.PowerSample(now, power), stage.lease.resistance, stage.lease.probe_age(now), (True, math.nan)

    def _feel(self, message: ServoState) -> None:
        """Follow the arm to its place and push."""
        position = self._delta.forward(*message.position)
        if not math.isfinite(position[0]):
            return
        torque = [machine.TORQUE_CONSTANT * current for current in message.current]
        held = self._delta.holding_torque(*position, machine.GRAVITY)
        spare = [have - hold for have, hold in zip(torque, held, strict=True)]
        push = self._delta.force(*position, (spare[0], spare[1], spare[2]))[2]
        with self._lock:
            self._position = position
            self._push = push if math.isfinite(push) else self._push

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            pressed = self._tare is not None and bool(np.nanmax(self._newest) >= machine.CONTACT_FORCE)
            if pressed or self._touching():
                response.message = "the pads are in contact: lift the end effector before taring"
                return response
            if not self._recent:
                response.message = "no frame yet: try again"
                return response
            self._tare = np.stack(self._recent).mean(axis=0)
        response.success, response.message = True, "tared"
        return response

    def _on_probe(self, request: Probe.Request, response: Probe.Response) -> Probe.Response:
        self._stop.wait(_PROBE_TIME)
        messages.unknown(response)
        with self._lock:
            try:
                resistance, voltage = self._power.probe(time.monotonic(), self._touching(), self._fault() == "short")
            except contactor.LeaseRefused as refusal:
                response.message = str(refusal)
                return response
        response.success, response.message = True, "measured"
        response.resistance, response.target_voltage = resistance, voltage
        response.port = int(machine.port_of(resistance, voltage))
        return response

    def _on_contactor(self, request: SetContactor.Request, response: SetContactor.Response) -> SetContactor.Response:
        with self._lock:
            if request.close:
                response.message = self._close_problem()
                if response.message:
                    return response
            try:
                if not request.close:
                    self._power.open()
                    response.success, response.message = True, "open"
                    return response
                lease, now = messages.seconds(request.lease), time.monotonic()
                self._power.close(request.holder, lease, now, request.token, tactile_node.limits_of(request))
            except contactor.LeaseRefused as refusal:
                response.message = str(refusal)
                return response
        response.success, response.message = True, "closed"
        return response

    def _close_problem(self) -> str:
        """Return why touch or the fault forbids a close; '' if nothing does."""
        if self._fault() == "silence":
            return "tactile frames are stale; the contactor stays open"
        if self._fault() == "contactor_refusal":
            return "the board's interlock keeps the contactor open"
        if not np.nanmax(self._newest) >= machine.CONTACT_FORCE:
            return "no tactile contact; the contactor stays open"
        return ""


def main(args: Sequence[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM."""
    return node_support.run(MockTactileNode, args)


if __name__ == "__main__":
    raise SystemExit(main())
