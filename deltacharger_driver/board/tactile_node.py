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

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from deltacharger.srv import Probe, SetContactor
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from std_srvs.srv import Trigger

from deltacharger_core import runtime
from deltacharger_core.environment import domain
from deltacharger_core.frames import END_EFFECTOR, FrameParameters
from deltacharger_core.machine import BAUD_RATE, port_of
from deltacharger_core.real_time import RateMeter, late, priority
from deltacharger_core.texts import quantity
from deltacharger_driver.board.contactor import STALE_FRAME, STALE_POWER
from deltacharger_driver.board.keeper import BoardKeeper
from deltacharger_driver.board.protocol import PowerSample, TactileSample
from deltacharger_driver.board.tactile_node_io import BATTERY_PERIOD, BatteryPublishers, SamplePublishers, limits_of
from deltacharger_driver.errors import DriverError
from deltacharger_driver.parameters import TactileNodeParameters
from deltacharger_driver.ports import RawPort
from deltacharger_ros import node_support
from deltacharger_ros.clock import steady_timer
from deltacharger_ros.diagnostics import ERROR, OK, WARN, Diagnostics
from deltacharger_ros.executor import order_age
from deltacharger_ros.log import Log
from deltacharger_ros.messages import seconds, unknown
from deltacharger_ros.parameters import declare_all, reject_unknown
from deltacharger_ros.qos import LATEST, SERVICE

_DIAGNOSTICS_PERIOD = 1.0  # s


class TactileNode(Node):
    """See the module's docstring.

    Frames and power are published from the board link's reader thread. The services may wait for the board (a probe up
    to 0.25 s). A close waits for a running probe; an opening does not.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("tactile_node", **kwargs)
        given, frames = declare_all(self, TactileNodeParameters), declare_all(self, FrameParameters)
        reject_unknown(self)
        try:  # failing at start is a wrong set-up; a port that vanishes later is reopened
            RawPort(given.port, BAUD_RATE).close()
        except DriverError as error:
            raise node_support.StartupError(f"tactile_node: {error}") from error
        self._lines = Log(self)
        self._frame: TactileSample | None = None
        self._power: PowerSample | None = None
        self._frame_rate, self._power_rate = RateMeter(time.monotonic), RateMeter(time.monotonic)
        self._period = 1.0 / given.rate
        self._samples = SamplePublishers(self, LATEST, frames.named(END_EFFECTOR))
        self._batteries = BatteryPublishers(self, frames)
        self._diagnostics = Diagnostics(self)
        self._taring = threading.Lock()  # one at a time
        # One callback group each: a client that calls one service without end does not block the others.
        for kind, name, serve in (
            (Trigger, "tare", self._on_tare),
            (Probe, "probe", self._on_probe),
            (SetContactor, "set_contactor", self._on_contactor),
        ):
            self.create_service(kind, name, serve, callback_group=ReentrantCallbackGroup(), qos_profile=SERVICE)
        steady_timer(self, _DIAGNOSTICS_PERIOD, self._diagnose)
        steady_timer(self, BATTERY_PERIOD, self._publish_batteries)
        self._keeper = BoardKeeper(
            given.port,
            given.rate,
            self._publish_frame,
            self._publish_power,
            self._report,
            runtime.servos(domain(), self.get_namespace()),
        )
        self._keeper.start()

    def close(self) -> None:
        """Open the contactor and confirm it, stop the stream, release the port. Idempotent."""
        self._keeper.close()

    def _publish_frame(self, sample: TactileSample) -> None:
        self._frame = sample
        self._frame_rate.count(late=time.monotonic() - sample.time > self._period)
        if self.context.ok():
            self._samples.frame(sample)

    def _publish_power(self, sample: PowerSample) -> None:
        self._power = sample
        self._power_rate.count()
        hello = self._keeper.link.greeting  # None: a report that overtook the greeting, of a stage not yet known
        if self.context.ok() and hello is not None:
            record = self._keeper.guard.probe_record()
            self._samples.power(sample, *record, (hello.steps_up, hello.stage_voltage))

    def _fresh_power(self) -> PowerSample | None:
        """Return the newest sample of the power stage; None if it is stale."""
        sample = self._power
        return None if sample is None or time.monotonic() - sample.time > STALE_POWER else sample

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
        problem, refusal = self._keeper.problem, "" if opens else late(order_age())
        try:
            if problem or refusal:
                response.success = False
                response.message = refusal or f"the board is not connected: {problem}"
            else:
                response.message = action()
                response.success = True
        except DriverError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        def tare() -> str:
            with self._taring:
                self._keeper.link.tare()
            return "tared"

        return self._served(response, tare)

    def _on_probe(self, request: Probe.Request, response: Probe.Response) -> Probe.Response:
        unknown(response)

        def probe() -> str:
            result = self._keeper.guard.probe()
            response.resistance, response.target_voltage = result.resistance, result.target_voltage
            port = port_of(result.resistance, result.target_voltage)
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
            lasts = guard.close(request.holder, seconds(request.lease), request.token, limits_of(request))
            return f"closed for {lasts:.3f} s; renew it in time"

        return self._served(response, switch, opens=not request.close)

    def _diagnose(self) -> None:
        self._diagnostics.publish(self._link_status(), self._tactile_status(), self._power_status())

    def _status(self, part: str, problem: str, warning: str, values: dict[str, object]) -> DiagnosticStatus:
        level = ERROR if problem else WARN if warning else OK
        return self._diagnostics.status(level, problem or warning or "OK", values, part, self._keeper.link.port)

    def _link_status(self) -> DiagnosticStatus:
        link = self._keeper.link
        values = {**vars(link.decoder_counters), **vars(link.counters), "priority": priority()}
        lateness = link.heartbeat_lateness
        if lateness is not None:
            values["heartbeat_late_max"] = quantity(1e3 * lateness.largest, ".1f", "ms")
            values["heartbeat_late_p99"] = quantity(1e3 * lateness.percentile(0.99), ".1f", "ms")
        damaged = link.decoder_counters.damaged
        warning = f"{damaged} damaged packets since start" if damaged else ""
        return self._status("board link", self._keeper.problem, warning, values)

    def _tactile_status(self) -> DiagnosticStatus:
        frame = self._frame
        rate = quantity(self._frame_rate.rate(), ".1f", "Hz")
        values: dict[str, object] = {"rate": rate, "late_frames": self._frame_rate.late}
        if frame is None or time.monotonic() - frame.time > STALE_FRAME:
            return self._status("tactile arrays", "no fresh frames; check the board's cable", "", values)
        dead = int(np.isnan(frame.pads).sum())
        warning = ("" if frame.tared else "not tared; call tare in free air") or (f"{dead} dead taxels" if dead else "")
        return self._status("tactile arrays", "", warning, {**values, "tared": frame.tared, "dead_taxels": dead})

    def _power_status(self) -> DiagnosticStatus:
        sample = self._fresh_power()
        values = {"rate": quantity(self._power_rate.rate(), ".1f", "Hz"), **self._keeper.guard.lease_record()}
        if sample is None:
            return self._status("power stage", "silent; check the board's cable", "", values)
        power = sample.power
        return self._status("power stage", self._keeper.guard.latched_fault(), "", {**values, **power._asdict()})


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; see node_support.run for the exit codes."""
    return node_support.run(TactileNode, args, has_deadlines=True)


if __name__ == "__main__":
    raise SystemExit(main())
