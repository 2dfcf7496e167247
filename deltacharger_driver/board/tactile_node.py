# SPDX-License-Identifier: Apache-2.0
"""tactile_node: the tactile arrays and the power stage on ROS.

Publishes: tactile_frame (sensor data, at `rate`), charger_power (reliable, depth 1, 20 Hz), battery, target_battery and
/diagnostics (1 Hz).
Serves: tare, set_contactor, probe.
Parameters: port, rate, frame_prefix.

Safe at start: the contactor is open and nothing is tared. A close is a lease of at most 0.25 s. While it lives, the
node relays it as the board's heartbeat; it never sends a heartbeat without a lease. The node refuses to close without
fresh frames, contact, limits of current and voltage and a fresh probe, or on a short, reversed polarity, a port that is
not as the limits expect it, or a latched fault. When the port vanishes, the lease ends, the topics stop, and the node
reopens the port.
"""

import math
import threading
import time
from array import array
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from deltacharger.msg import ChargerPower, TactileFrame
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import BatteryState
from std_srvs.srv import Trigger

from deltacharger_core import environment, machine, real_time, runtime, texts
from deltacharger_core.frames import CHARGER_BASE, END_EFFECTOR, FrameParameters
from deltacharger_core.ros import clock, diagnostics, log, messages, node_support, parameters
from deltacharger_core.ros.executor import order_age
from deltacharger_core.ros.qos import LATEST, SERVICE
from deltacharger_driver import errors, ports
from deltacharger_driver.board import contactor, keeper, protocol
from deltacharger_driver.board.contactor import STALE_FRAME
from deltacharger_driver.parameters import TactileNodeParameters

_DIAGNOSTICS_PERIOD = 1.0  # s
BATTERY_PERIOD = 1.0
"""s between two messages of the batteries."""
_PITCH = 0.0024  # m between neighbouring taxels
_PRESENT = 6.0  # V, either polarity; without a battery the probe causes 5 V at most
_FIELDS = ("voltage", "temperature", "current", "charge", "capacity", "design_capacity", "percentage")


def limits_of(request: SetContactor.Request) -> machine.ChargeLimits:
    """Return the limits that a request to close gives; all 0 in an old client's."""
    return machine.ChargeLimits(
        request.current_max, request.voltage_max, request.dead_port, request.start_time, request.gap_time
    )


class SamplePublishers:
    """Publishes from the link's reader thread only.

    Args:
        node: the publisher.
        qos: of charger_power.
        frame_id: full name of end_effector.
    """

    def __init__(self, node: Node, qos: QoSProfile, frame_id: str) -> None:
        self._stamps = clock.Stamps(node.get_clock())
        self._frame = TactileFrame(rows=machine.ROWS, columns=machine.COLUMNS, pitch=_PITCH)
        self._power = ChargerPower()
        self._frame.header.frame_id = self._power.header.frame_id = frame_id
        self._frames = node.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self._powers = node.create_publisher(ChargerPower, "charger_power", qos)

    def frame(self, sample: protocol.TactileSample) -> None:
        """Publish a tactile frame."""
        message = self._frame
        message.header.stamp = self._stamps.at(sample.time)
        message.sequence, message.device_time_us, message.tared = sample.sequence, sample.device_time_us, sample.tared
        # rclpy would check each of the taxels of a numpy array
        message.left, message.right = (array("f", pad.tobytes()) for pad in sample.pads)
        self._frames.publish(message)

    def power(
        self, sample: protocol.PowerSample, probe_resistance: float, probe_age: float, stage: tuple[bool, float]
    ) -> None:
        """Publish the power stage with the last probe's ohm (NaN = none) and age in s (inf = none or void).

        `stage` is its `steps_up` and `stage_voltage` (V) as in `Hello`.
        """
        message, power = self._power, sample.power
        message.header.stamp = self._stamps.at(sample.time)
        message.contactor_closed, message.fault = power.contactor_closed, power.fault
        message.battery_voltage, message.target_voltage = power.battery_voltage, power.target_voltage
        message.charge_current, message.charge_current_least = power.charge_current, power.least_current
        message.probe_resistance, message.probe_age = probe_resistance, probe_age
        message.stage_steps_up, message.stage_voltage = stage
        self._powers.publish(message)


class BatteryPublishers:
    """Publishes the power stage's measurements of both batteries; unknown fields are NaN.

    Args:
        node: the publisher.
        frames: names of the charger's frames.
    """

    def __init__(self, node: Node, frames: FrameParameters) -> None:
        self._stamps = clock.Stamps(node.get_clock())
        self._publishers = [
            (node.create_publisher(BatteryState, topic, LATEST), read, frames.named(frame))
            for topic, read, frame in (
                ("battery", own_battery, CHARGER_BASE),
                ("target_battery", target_battery, END_EFFECTOR),
            )
        ]

    def publish(self, sample: protocol.PowerSample | None) -> None:
        """Publish both; None = no fresh sample."""
        stamp = self._stamps.at(time.monotonic() if sample is None else sample.time)
        for publisher, read, frame in self._publishers:
            message = read(sample)
            message.header.frame_id = frame
            message.header.stamp = stamp
            publisher.publish(message)


def own_battery(sample: protocol.PowerSample | None) -> BatteryState:
    """Return the charger's battery. Its current (A) is unknown: servos and computer draw from it too.

    It discharges while it charges a target. Otherwise its state is unknown: the robot may itself be on a charger.
    """
    message = _battery("charger", math.nan if sample is None else sample.power.battery_voltage)
    if message.present and sample is not None and sample.power.charge_current >= machine.ZERO_CURRENT:
        message.power_supply_status = BatteryState.POWER_SUPPLY_STATUS_DISCHARGING
    return message


def target_battery(sample: protocol.PowerSample | None) -> BatteryState:
    """Return the target's battery: V and A into it while docked, else NaN.

    The voltage is measured at the electrodes: while current flows, it includes the drop of the target's wires.
    """
    if sample is None:
        return _battery("target", math.nan)
    power = sample.power
    message = _battery("target", power.target_voltage)
    if message.present and math.isfinite(power.charge_current):
        message.current = power.charge_current
        message.power_supply_status = _status(power.charge_current)
    return message


def _status(current: float) -> int:
    """Return the charging status for a current, A, positive into the battery."""
    if current >= machine.ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_CHARGING)
    if current <= -machine.ZERO_CURRENT:
        return int(BatteryState.POWER_SUPPLY_STATUS_DISCHARGING)
    return int(BatteryState.POWER_SUPPLY_STATUS_NOT_CHARGING)


def _battery(location: str, voltage: float) -> BatteryState:
    """Return a battery message with only the voltage (V) known."""
    message = BatteryState(location=location, **dict.fromkeys(_FIELDS, math.nan))
    message.voltage = voltage
    message.present = abs(voltage) >= _PRESENT
    return message


class TactileNode(Node):
    """See the module's docstring.

    Frames and power are published from the board link's reader thread. The services may wait for the board (a probe up
    to 0.25 s). A close waits for a running probe; an opening does not.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tactile_node", **kwargs)
        given, frames = (
            parameters.declare_all(self, TactileNodeParameters),
            parameters.declare_all(self, FrameParameters),
        )
        parameters.reject_unknown(self)
        try:  # failing at start is a wrong set-up; a port that vanishes later is reopened
            ports.RawPort(given.port, machine.BAUD_RATE).close()
        except errors.DriverError as error:
            raise node_support.StartupError(f"tactile_node: {error}") from error
        self._lines = log.Log(self)
        self._frame: protocol.TactileSample | None = None
        self._power: protocol.PowerSample | None = None
        self._frame_rate, self._power_rate = real_time.RateMeter(time.monotonic), real_time.RateMeter(time.monotonic)
        self._period = 1.0 / given.rate
        self._samples = SamplePublishers(self, LATEST, frames.named(END_EFFECTOR))
        self._batteries = BatteryPublishers(self, frames)
        self._diagnostics = diagnostics.Diagnostics(self)
        self._taring = threading.Lock()  # one at a time
        # One callback group each: a client that calls one service without end does not block the others.
        for kind, name, serve in (
            (Trigger, "tare", self._on_tare),
            (Probe, "probe", self._on_probe),
            (SetContactor, "set_contactor", self._on_contactor),
        ):
            self.create_service(kind, name, serve, callback_group=ReentrantCallbackGroup(), qos_profile=SERVICE)
        clock.steady_timer(self, _DIAGNOSTICS_PERIOD, self._diagnose)
        clock.steady_timer(self, BATTERY_PERIOD, self._publish_batteries)
        self._keeper = keeper.BoardKeeper(
            given.port,
            given.rate,
            self._publish_frame,
            self._publish_power,
            self._report,
            runtime.servos(environment.domain(), self.get_namespace()),
        )
        self._keeper.start()

    def close(self) -> None:
        """Open the contactor and confirm it, stop the stream, release the port. Idempotent."""
        self._keeper.close()

    def _publish_frame(self, sample: protocol.TactileSample) -> None:
        self._frame = sample
        self._frame_rate.count(late=time.monotonic() - sample.time > self._period)
        if self.context.ok():
            self._samples.frame(sample)

    def _publish_power(self, sample: protocol.PowerSample) -> None:
        self._power = sample
        self._power_rate.count()
        hello = self._keeper.link.greeting  # None: a report that overtook the greeting, of a stage not yet known
        if self.context.ok() and hello is not None:
            record = self._keeper.guard.probe_record()
            self._samples.power(sample, *record, (hello.steps_up, hello.stage_voltage))

    def _fresh_power(self) -> protocol.PowerSample | None:
        """Return the newest sample of the power stage; None if it is stale."""
        sample = self._power
        return None if sample is None or time.monotonic() - sample.time > contactor.STALE_POWER else sample

    def _publish_batteries(self) -> None:
        if self.context.ok():
            self._batteries.publish(self._fresh_power())

    def _report(self, problem: str) -> None:
        if problem:
            self._lines.error(problem)
        else:
            link = self._keeper.link
            servos = f"; servos connected through it: {self._keeper.servos.path}" if self._keeper.carries_servos else ""
            self._lines.info(f"board connected at {link.port}{servos}")

    def _served(self, response: Any, action: Callable[[], str], opens: bool = False) -> Any:
        """Fill `success` and `message` from an action that returns the message or raises an error.

        It is refused if it comes too late, unless it `opens`.
        """
        problem, refusal = self._keeper.problem, "" if opens else real_time.late(order_age())
        try:
            if problem or refusal:
                response.success = False
                response.message = refusal or f"the board is not connected: {problem}"
            else:
                response.message = action()
                response.success = True
        except errors.DriverError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def tare() -> str:
            with self._taring:
                self._keeper.link.tare()
            return "tared"

        return self._served(response, tare)

    def _on_probe(self, request: Probe.Request, response: Probe.Response) -> Probe.Response:
        messages.unknown(response)

        def probe() -> str:
            result = self._keeper.guard.probe()
            response.resistance, response.target_voltage = result.resistance, result.target_voltage
            port = machine.port_of(result.resistance, result.target_voltage)
            response.port = int(port)
            return f"{port.name.lower()}: {result.resistance:.3g} ohm, {result.target_voltage:.2f} V"

        return self._served(response, probe)

    def _on_contactor(self, request: SetContactor.Request, response: SetContactor.Response) -> SetContactor.Response:
        guard = self._keeper.guard

        def switch() -> str:
            if not request.close:
                guard.open()
                if request.clear_weld:
                    guard.clear_weld()
                return "opened; no weld is latched" if request.clear_weld else "opened"
            lasts = guard.close(request.holder, messages.seconds(request.lease), request.token, limits_of(request))
            return f"closed for {lasts:.3f} s; renew it in time"

        return self._served(response, switch, opens=not request.close)

    def _diagnose(self) -> None:
        self._diagnostics.publish(self._link_status(), self._tactile_status(), self._power_status())

    def _status(self, part: str, problem: str, warning: str, values: dict[str, object]) -> DiagnosticStatus:
        level = diagnostics.ERROR if problem else diagnostics.WARN if warning else diagnostics.OK
        return self._diagnostics.status(level, problem or warning or "OK", values, part, self._keeper.link.port)

    def _link_status(self) -> DiagnosticStatus:
        link = self._keeper.link
        values = {**vars(link.decoder_counters), **vars(link.counters), "priority": real_time.priority()}
        damaged = link.decoder_counters.damaged
        warning = f"{damaged} damaged packets since start" if damaged else ""
        return self._status("board link", self._keeper.problem, warning, values)

    def _tactile_status(self) -> DiagnosticStatus:
        frame = self._frame
        rate = texts.quantity(self._frame_rate.rate(), ".1f", "Hz")
        values: dict[str, object] = {"rate": rate, "late_frames": self._frame_rate.late}
        if frame is None or time.monotonic() - frame.time > STALE_FRAME:
            return self._status("tactile arrays", "no fresh frames; check the board's cable", "", values)
        dead = int(np.isnan(frame.pads).sum())
        warning = ("" if frame.tared else "not tared; call tare in free air") or (f"{dead} dead taxels" if dead else "")
        return self._status("tactile arrays", "", warning, {**values, "tared": frame.tared, "dead_taxels": dead})

    def _power_status(self) -> DiagnosticStatus:
        sample = self._fresh_power()
        values = {"rate": texts.quantity(self._power_rate.rate(), ".1f", "Hz"), **self._keeper.guard.lease_record()}
        if sample is None:
            return self._status("power stage", "silent; check the board's cable", "", values)
        power = sample.power
        return self._status("power stage", self._keeper.guard.latched_fault(), "", {**values, **power._asdict()})


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(TactileNode, args, has_deadlines=True)


if __name__ == "__main__":
    raise SystemExit(main())
