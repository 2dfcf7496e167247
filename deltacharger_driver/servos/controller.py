# SPDX-License-Identifier: Apache-2.0
"""Controls the arm's servos cycle by cycle: trajectories, stops on faults, recovery, diagnostics. No ROS.

One thread calls `open`, `cycle` and `close`; any thread may call `submit` and `request`, which take effect in the next
cycle. Torque is switched on only by request, and every fault ends with torque off. Every switch-off first requests that
the contactor opens: electrodes that carry current must not separate.
"""

from __future__ import annotations

import contextlib
import math
import queue
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict
from typing import NamedTuple, Protocol

from deltacharger_core.real_time import late
from deltacharger_core.texts import quantity
from deltacharger_driver.errors import DriverError, PortError, PortGone, TrajectoryRefused
from deltacharger_driver.servos.bus import BusSnapshot, ServoBus
from deltacharger_driver.servos.link import ServoPort
from deltacharger_driver.servos.motion import HOLD, STOP_TIME, JointWatch, ServoGoals, Trajectory
from deltacharger_driver.servos.registers import BusSettings, Drive, describe_hardware_error
from deltacharger_driver.servos.report import ServoMemory, ServoPhase, ServoReport, find_faults

_POLL_PERIOD = 0.005  # s between two checks of the contactor
_REBOOT_TIME = 3.0  # s until all servos must be back

_FIRST_PAUSE, _LONGEST_PAUSE = 0.25, 0.5  # s between two attempts to reopen the port

OPENING_TIME = 0.3  # s; after a request, longest time with torque on until the contactor is reported open
_TRIPS, _TRIPS_WITHIN = 3, 2.0  # this many watchdog trips within this many s are a fault

OK, WARN, ERROR = b"\0", b"\1", b"\2"
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_HOT = 10.0  # °C below the servo's own limit
_LITTLE_RESERVE = 60.0  # s


class ServoRequest:
    """A request to the servos' thread, with its result."""

    def __init__(self, action: str, sent: float = math.inf) -> None:
        self.action = action
        self.sent = sent  # s, the servos' clock
        self.success = False
        self.message = ""
        self._done = threading.Event()

    def finish(self, success: bool, message: str) -> None:
        """Set the result."""
        self.success, self.message = success, message
        self._done.set()

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` s for the result; return whether it is there."""
        return self._done.wait(timeout)


class ServoRequests:
    """Requests waiting for the servos' thread, and those held until torque is off.

    `put` may be called from any thread, the others from the servos' thread.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[ServoRequest] = queue.SimpleQueue()
        self._held: list[ServoRequest] = []

    def put(self, action: str, sent: float = math.inf) -> ServoRequest:
        """Queue a request that was sent at `sent` (s)."""
        request = ServoRequest(action, sent)
        self._queue.put(request)
        return request

    def next(self) -> ServoRequest | None:
        """Return the next queued request, or None."""
        return None if self._queue.empty() else self._queue.get_nowait()

    def hold(self, request: ServoRequest) -> None:
        """Hold a request until `finish_held`."""
        self._held.append(request)

    @property
    def has_queued(self) -> bool:
        """Whether a request is queued."""
        return not self._queue.empty()

    @property
    def has_held(self) -> bool:
        """Whether a request is held."""
        return bool(self._held)

    def finish_held(self, success: bool, message: str) -> None:
        """Finish all held requests."""
        for request in self._held:
            request.finish(success, message)
        self._held.clear()

    def refuse_all(self, reason: str) -> None:
        """Finish every request without success."""
        self.finish_held(False, reason)
        while request := self.next():
            request.finish(False, reason)


class Contactor(Protocol):
    """The contactor for the servos' thread: it must be open before torque goes off.

    Neither method may wait or raise: they are called between two bus cycles.
    """

    def request_open(self) -> None:
        """Request an opening."""

    def is_open(self) -> bool:
        """Return whether it was reported open after the last `request_open`, or does not exist."""


class NoContactor:
    """For an arm without a power stage."""

    def request_open(self) -> None:
        """Do nothing."""

    def is_open(self) -> bool:
        """Return True: nothing is closed."""
        return True


def wait_until_open(contactor: Contactor, seconds: float, clock: ServoPort) -> None:
    """Request an opening and wait for it, at most `seconds`; for use outside the cycle."""
    contactor.request_open()
    end = clock.now() + seconds
    while not contactor.is_open() and clock.now() < end:
        clock.sleep(_POLL_PERIOD)


class ServoRestarts:
    """Requested reboots, and the configuration of restarted servos. Used by the servos' thread.

    Args:
        bus: of the servos.
        notify: called with severity and message.
    """

    def __init__(self, bus: ServoBus, notify: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._notify = notify
        self._request: ServoRequest | None = None
        self._deadline = 0.0
        self._away: set[int] = set()  # servos being rebooted that are not back
        self._last_error = ""

    @property
    def is_rebooting(self) -> bool:
        """Whether some of the servos being rebooted are not back yet."""
        return self._request is not None

    def reboot(self, request: ServoRequest, snapshot: BusSnapshot | None) -> None:
        """Restart the servos with a latched error, or all if none has one; finish `request` when they are back.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: a servo did not accept the instruction.
        """
        if self._request is not None:
            request.finish(False, "the servos are already being rebooted")
            return
        faulty = [i for i, bits in enumerate(snapshot.hardware_error) if bits] if snapshot is not None else []
        self._away = set(faulty or range(len(self._bus.settings.ids)))
        for index in sorted(self._away):
            self._bus.reboot(index)
        self._request, self._deadline = request, self._bus.clock.now() + _REBOOT_TIME

    def restore(self, snapshot: BusSnapshot) -> list[int]:
        """Configure every restarted servo; return the ids of those that restarted without a request.

        Raises:
            PortGone: the port vanished.
        """
        unrequested = []
        for index, servo in enumerate(self._bus.settings.ids):
            if not snapshot.rebooted[index]:
                continue
            try:
                self._bus.configure(index)
            except PortGone:
                raise
            except DriverError as error:
                if str(error) != self._last_error:
                    self._last_error = str(error)
                    self._notify("warning", f"servo {servo} had restarted: {error}")
                continue
            self._notify("warning", f"servo {servo} had restarted; configured again, torque off")
            self._away.discard(index)
            if self._request is None:
                unrequested.append(servo)
        return unrequested

    def look(self, snapshot: BusSnapshot, faults: list[str]) -> None:
        """Finish the request if all servos are back or the time is over.

        Args:
            snapshot: of this cycle.
            faults: that forbid moving.
        """
        if self._request is None:
            return
        if not self._away and snapshot.complete:
            self._request.finish(not faults, "; ".join(faults) or "rebooted and configured; torque is off")
        elif self._bus.clock.now() >= self._deadline:
            self._request.finish(False, "; ".join(faults) or "the servos did not come back in time")
        else:
            return
        self._request = None

    def refuse(self, reason: str) -> None:
        """Finish a pending request without success."""
        if self._request is not None:
            self._request.finish(False, reason)
            self._request = None


class Reconnection:
    """Reopens a bus.

    Args:
        bus: to open.
        notify: called with (severity, message) when the reason changes.

    Attributes:
        fault: why it is not connected.
        count: number of successful reopenings.
    """

    def __init__(self, bus: ServoBus, notify: Callable[[str, str], None]) -> None:
        self._bus = bus
        self._notify = notify
        self._pause = _FIRST_PAUSE
        self._next = 0.0
        self.fault = "not connected"
        self.count = 0

    def lost(self, error: Exception) -> None:
        """Restart the attempts: the port has just vanished."""
        self.fault = str(error)
        self._pause = _FIRST_PAUSE
        self._next = self._bus.clock.now() + self._pause

    def attempt(self) -> bool:
        """Open the bus if the next attempt is due; return whether it is open now."""
        if self._bus.clock.now() < self._next:
            return False
        try:
            self._bus.open(scan=False)
        except DriverError as error:
            self._pause = min(2.0 * self._pause, _LONGEST_PAUSE)
            self._next = self._bus.clock.now() + self._pause
            if str(error) != self.fault:
                self.fault = str(error)
                self._notify("error", self.fault)
            return False
        self._pause = _FIRST_PAUSE
        self.count += 1
        return True


class ServoController:
    """The arm's servos with their safety rules.

    Args:
        settings: wiring and mounting.
        notify: called with (severity "info" | "warning" | "error", message) for every event to log.
        contactor: opened before torque is switched off.
        handler: class of the port, which also keeps the time.

    Attributes:
        stop_reason: reason of the last stop; it and the next may be read from any thread.
        unrequested_stop: reason why torque went off without a request; '' once it is on again.
        watchdog_trips: number of stops by the servos' bus watchdog.
    """

    def __init__(
        self,
        settings: BusSettings,
        notify: Callable[[str, str], None] = lambda severity, sentence: None,
        contactor: Contactor | None = None,
        handler: type[ServoPort] = ServoPort,
    ) -> None:
        self.watchdog_trips = 0
        self.bus = ServoBus(settings, handler)
        self._clock = self.bus.clock
        self._ids = settings.ids
        self._notify = notify
        self._contactor = contactor or NoContactor()
        self._phase = ServoPhase.DISCONNECTED
        self._lock = threading.Lock()
        self._requests = ServoRequests()
        self._submitted: tuple[Trajectory, float] | None = None
        self._stop_at = math.inf
        self.stop_reason = self.unrequested_stop = ""
        self._reconnection = Reconnection(self.bus, notify)
        self._restarts = ServoRestarts(self.bus, notify)
        self._trips: deque[float] = deque([-math.inf] * _TRIPS, maxlen=_TRIPS)
        self._snapshot: BusSnapshot | None = None
        self._use(self.bus.drive)

    def _use(self, drive: Drive) -> None:
        """Begin anew, for servos of this type."""
        self._drive, count = drive, len(self._ids)
        self._goals = ServoGoals(count, drive.current_bound, drive.torque_constant)
        self._watch = JointWatch(self.bus.settings, drive)
        self._memory = ServoMemory(count, drive.servo)

    @property
    def phase(self) -> ServoPhase:
        """Phase of the servos; may be read from any thread."""
        return self._phase

    @property
    def reconnections(self) -> int:
        """Number of times that a vanished port was reopened."""
        return self._reconnection.count

    @property
    def has_request(self) -> bool:
        """Whether a request waits for the next cycle."""
        return self._requests.has_queued

    @property
    def is_releasing(self) -> bool:
        """Whether torque is about to be switched off by request."""
        return self._requests.has_held

    def now(self) -> float:
        """Return the time of the controller's clock, s."""
        return self._clock.now()

    def open(self) -> None:
        """Open the port and configure the servos, torque off.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: the port cannot be opened.
            HandshakeError: lists every fault of the servos.
        """
        self.bus.open(scan=True)
        self._take_open_bus()

    def _take_open_bus(self) -> None:
        """Be ready for torque with the servos found: at the first opening their type becomes known."""
        if self.bus.drive != self._drive:
            self._use(self.bus.drive)
        self._phase = ServoPhase.OFF

    def close(self) -> None:
        """Switch torque off if it is on, and release the port. Never raises; safe to call twice.

        Waits at most `OPENING_TIME` for the contactor. If possible, first request "torque_off" and cycle until it is.
        """
        if self.bus.is_open and self._phase in (ServoPhase.ON, ServoPhase.STOPPING):
            wait_until_open(self._contactor, OPENING_TIME, self._clock)
            with contextlib.suppress(DriverError):
                self.bus.disable_torque()
        self.bus.close()
        self._phase = ServoPhase.DISCONNECTED
        self._refuse_all("the driver is closing")

    def submit(self, trajectory: Trajectory, start: float = math.inf) -> None:
        """Replace the running trajectory in the next cycle.

        Args:
            trajectory: its first segment begins at the goal of that moment. Points in the past are skipped; if all
                are, the last point holds.
            start: time zero of the trajectory, s, monotonic; at the latest the cycle in which it takes effect.

        Raises:
            TrajectoryRefused: torque is off, the servos are being stopped, or its goals are faster than the joints.
        """
        with self._lock:
            if self._phase is not ServoPhase.ON:
                more = {ServoPhase.OFF: "; call set_torque first", ServoPhase.STOPPING: f": {self.stop_reason}"}
                raise TrajectoryRefused(self._phase.value + more.get(self._phase, ""))
            now = self._clock.now()
            self._goals.advance(now)
            self._watch.follow(now, self._goals.angles)
            self._watch.check(trajectory, max(now - start, 0.0), self._goals.default)
            self._submitted = trajectory, start

    def freeze(self) -> None:
        """Stay at the present goal; call it only from the servos' thread."""
        if self._submitted is not None or self._goals.are_moving:
            self._submitted = HOLD, math.inf

    def request(self, action: str, age: float = 0.0) -> ServoRequest:
        """Request "torque_on", "torque_off" or "reboot"; the servos' thread executes it, or refuses it as too late.

        Args:
            action: what to do.
            age: s since the client sent it.
        """
        return self._requests.put(action, self._clock.now() - age)

    def stop(self, reason: str) -> None:
        """Goal := present position, open contactor, torque off after `STOP_TIME`; call it from the servos' thread."""
        if self._phase is ServoPhase.ON:
            self._begin_stop(reason, STOP_TIME)
            self.unrequested_stop = reason
            self._notify("error", f"stopping all servos: {reason}")

    def _begin_stop(self, reason: str, seconds: float) -> None:
        """Hold the present position, request an open contactor, and switch torque off after `seconds`."""
        with self._lock:
            self._phase = ServoPhase.STOPPING
            self._submitted = None
        self.stop_reason = reason
        self._stop_at = self._clock.now() + seconds
        self._goals.hold(self._memory.angles)
        self._contactor.request_open()

    def cycle(self) -> ServoReport:
        """Run one bus cycle and return the state after it. Never raises `DriverError`."""
        try:
            if self._phase is ServoPhase.DISCONNECTED:
                self._reopen()
            self._serve_requests()
            if self._phase is not ServoPhase.DISCONNECTED:
                self._exchange()
        except PortGone as error:
            self._disconnect(error)
        return self._memory.report(self._clock.now(), self._phase, self._faults(), self._watch.strays)

    def _exchange(self) -> None:
        """Send goals, read the state and react to it."""
        if self._phase is ServoPhase.OFF:
            snapshot = self.bus.read()
        else:
            self._advance()
            snapshot = self.bus.exchange(self._goals.angles, self._goals.bounds)
        self._snapshot = snapshot
        self._memory.learn(snapshot)
        self._check_watchdogs(snapshot)
        if self._phase is ServoPhase.ON:
            self._stop_on_faults(snapshot)
        elif self._phase is ServoPhase.STOPPING and self._may_switch_off():
            self._switch_off()
        elif self._phase is ServoPhase.OFF:
            self._keep_off(snapshot)
        if self._phase is ServoPhase.OFF:
            self._restore(snapshot)

    def _stop_on_faults(self, snapshot: BusSnapshot) -> None:
        """Stop on any fault; the servos get the stop goal within this cycle."""
        faults = self._faults()
        readings = snapshot.angle, snapshot.velocity, snapshot.current
        if astray := self._watch.fault(snapshot.time, self._goals.angles, *readings):
            faults.append(astray)
        lost = snapshot.with_torque(self._ids, False)
        if lost:
            faults.append(f"servo {lost[0]} switched its torque off on its own")
        if faults:
            self.stop("; ".join(faults))
            self.bus.write_goals(self._goals.angles, self._goals.bounds)

    def _restore(self, snapshot: BusSnapshot) -> None:
        """Configure restarted servos again; a restart may be why torque went off."""
        for servo in self._restarts.restore(snapshot):
            if self.unrequested_stop:
                self.unrequested_stop += f"; servo {servo} has restarted on its own"
        if self._restarts.is_rebooting:
            self._restarts.look(snapshot, self._faults())

    def _keep_off(self, snapshot: BusSnapshot) -> None:
        """Switch off a servo that missed the switch-off, as soon as it answers again."""
        on = snapshot.with_torque(self._ids, True)
        if on:
            self._notify("warning", f"servos {on} have torque without a request; switching it off")
            self.bus.disable_torque()

    def _may_switch_off(self) -> bool:
        """Return whether torque may go off: the stop time has passed, or it was requested and the contactor is open."""
        return self._clock.now() >= self._stop_at or (self.is_releasing and self._contactor.is_open())

    def _advance(self) -> None:
        """Take a submitted trajectory; update goal and bounds for now."""
        now = self._clock.now()
        with self._lock:
            submitted, self._submitted = self._submitted, None
        if submitted is not None and self._phase is ServoPhase.ON:
            self._goals.follow(*submitted, now)
        self._goals.advance(now)

    def _check_watchdogs(self, snapshot: BusSnapshot) -> None:
        tripped = [servo for servo, stopped in zip(self._ids, snapshot.watchdog_tripped, strict=True) if stopped]
        if not tripped:
            return
        if self._phase is ServoPhase.ON:
            self._resume_after_silence(f"the bus fell silent and servos {tripped} stopped by their watchdog")
        try:
            self.bus.restart_watchdogs()
        except PortGone:
            raise
        except DriverError as error:
            self.stop(f"a tripped watchdog cannot be cleared: {error}")

    def _resume_after_silence(self, event: str) -> None:
        self.watchdog_trips += 1
        self._trips.append(now := self._clock.now())
        if now - self._trips[0] < _TRIPS_WITHIN:
            self.stop(f"{event} repeatedly; this computer is overloaded")
        else:
            self._goals.resume_at(self._memory.angles, now)
            self._notify("warning", f"{event}; resuming from where they stopped")

    def _faults(self) -> list[str]:
        """Return the faults that forbid moving, from the last snapshot."""
        if self._phase is ServoPhase.DISCONNECTED:
            return [self._reconnection.fault]
        return find_faults(self._ids, self._snapshot) if self._snapshot is not None else []

    def _serve_requests(self) -> None:
        while request := self._requests.next():
            try:
                if refusal := late(self._clock.now() - request.sent):
                    request.finish(False, refusal)
                elif self._phase is ServoPhase.DISCONNECTED:
                    request.finish(False, self._reconnection.fault)
                elif request.action == "torque_on":
                    self._switch_on(request)
                elif request.action == "torque_off":
                    self._switch_off_when_open(request)
                else:
                    self._reboot(request)
            except DriverError as error:
                request.finish(False, str(error))
                if isinstance(error, PortGone):
                    raise

    def _switch_on(self, request: ServoRequest) -> None:
        if self._phase is ServoPhase.ON:
            request.finish(True, "torque is already on")
            return
        if self._phase is ServoPhase.STOPPING:
            request.finish(False, f"stopping: {self.stop_reason}")
            return
        faults = self._faults()
        if faults or self._restarts.is_rebooting:
            request.finish(False, "; ".join(faults) or "the servos are being rebooted")
            return
        snapshot = self.bus.enable_torque(self._goals.default)
        self._memory.learn(snapshot)
        self._goals.begin_at(snapshot.angle)
        self._watch.begin_at(snapshot.angle)
        self.unrequested_stop = ""
        with self._lock:
            self._submitted = None
            self._phase = ServoPhase.ON
        request.finish(True, "torque is on, holding the present position")
        self._notify("info", "torque on")

    def _switch_off_when_open(self, request: ServoRequest) -> None:
        """Switch torque off once the contactor is open, or after `OPENING_TIME`."""
        self._requests.hold(request)
        if self._phase is ServoPhase.ON:
            self._begin_stop("torque is being switched off on request", OPENING_TIME)
        elif self._phase is ServoPhase.STOPPING:
            self._stop_at = min(self._stop_at, self._clock.now() + OPENING_TIME)
            self._contactor.request_open()
        else:
            self._switch_off()

    def _switch_off(self) -> None:
        with self._lock:
            was, self._phase = self._phase, ServoPhase.OFF
            self._submitted = None
        self._stop_at = math.inf
        unseen = was is ServoPhase.STOPPING and not self._contactor.is_open()
        try:
            self.bus.disable_torque()
        finally:
            if unseen:
                self._notify("warning", "torque off; the contactor was not seen open before, check tactile_node")
            elif was is not ServoPhase.OFF:
                self._notify("info", "torque off")
        doubt = "; the contactor was not seen open before" if unseen else ""
        self._requests.finish_held(True, f"torque is off{doubt}")

    def _reboot(self, request: ServoRequest) -> None:
        if self._phase is ServoPhase.OFF:
            self._restarts.reboot(request, self._snapshot)
        else:
            request.finish(False, f"{self._phase.value}; call set_torque with false first")

    def _reopen(self) -> None:
        if self._reconnection.attempt():
            self._take_open_bus()
            self._notify("info", "connected again; torque is off")

    def _disconnect(self, error: PortError) -> None:
        self.bus.close()
        if self._phase in (ServoPhase.ON, ServoPhase.STOPPING):
            self.unrequested_stop = str(error)
            self._contactor.request_open()
        with self._lock:
            self._phase = ServoPhase.DISCONNECTED
            self._submitted = None
        self._snapshot = None
        self._reconnection.lost(error)
        self._memory.forget()
        self._refuse_all(str(error))
        self._notify("error", str(error))

    def _refuse_all(self, reason: str) -> None:
        self._restarts.refuse(reason)
        self._requests.refuse_all(reason)


class DiagnosticEntry(NamedTuple):
    """One status.

    Attributes:
        level: OK, WARN or ERROR.
        message: one sentence.
        values: further values.
        part: name of the device or bus.
    """

    level: bytes
    message: str
    values: dict[str, object]
    part: str


class RefusedTrajectories(NamedTuple):
    """Trajectories that were refused.

    Attributes:
        now: since the last diagnostic.
        total: since the start.
        forbidden: of the total, those forbidden by the state of the contactor.
        last: reason of the last refusal.
        by: senders of those forbidden since the last diagnostic.
    """

    now: int
    total: int
    forbidden: int
    last: str
    by: str


def bus_entry(
    report: ServoReport,
    controller: ServoController,
    contactor: str,
    refusals: RefusedTrajectories,
    rate: float,
    late: int,
) -> DiagnosticEntry:
    """Return the state of the bus.

    Args:
        report: of the last cycle.
        controller: for its counters.
        contactor: its known state.
        refusals: of trajectories.
        rate: cycles per second since the last diagnostic, Hz.
        late: number of late cycles since the start.
    """
    settings = controller.bus.settings
    values: dict[str, object] = {
        "state": report.phase.value,
        "baud_rate": settings.baud_rate,
        "ids": list(settings.ids),
        "type": controller.bus.drive.servo.name,
        "rate": quantity(rate, ".1f", "Hz"),
        "late_cycles": late,
        **asdict(controller.bus.counters),
        "watchdog_trips": controller.watchdog_trips,
        "reconnections": controller.reconnections,
        "contactor": contactor,
        "refused_trajectories": refusals.total,
        "forbidden_trajectories": refusals.forbidden,
        "last_refusal": refusals.last,
    }
    if report.faults:
        level, message = ERROR, "; ".join(report.faults)
    elif report.phase is ServoPhase.STOPPING:
        level, message = WARN if controller.is_releasing else ERROR, controller.stop_reason
    elif refusals.now:
        level, message = WARN, f"{refusals.last}{f'; sent by {refusals.by}' if refusals.by else ''}"
    elif report.phase is ServoPhase.OFF and controller.unrequested_stop:
        level, message = WARN, f"torque off: {controller.unrequested_stop}"
    else:
        level, message = OK, report.phase.value
    return DiagnosticEntry(level, message, values, "servo bus")


def servo_entry(report: ServoReport, index: int, controller: ServoController, joint: str) -> DiagnosticEntry:
    """Return the state of one servo."""
    servo, hot = controller.bus.settings.ids[index], controller.bus.drive.servo.temperature_limit - _HOT
    values: dict[str, object] = {
        "joint": joint,
        "id": servo,
        "angle": quantity(report.angle[index], ".4f", "rad"),
        "current": quantity(report.current[index], ".3f", "A"),
        "voltage": quantity(report.voltage[index], ".1f", "V"),
        "temperature": quantity(report.temperature[index], ".0f", "°C"),
        "thermal_reserve": quantity(report.thermal_reserve[index], ".0f", "s"),
        "torque_enabled": report.torque_enabled[index],
    }
    errors = describe_hardware_error(report.hardware_error[index])
    level, message = OK, "OK"
    if errors:
        level, message = ERROR, f"latched: {errors}"
    elif not report.valid[index]:
        level, message = ERROR, "no good reply; check its supply and cable"
    elif report.temperature[index] >= hot:
        level, message = WARN, f"hot: {report.temperature[index]:.0f} °C"
    elif report.thermal_reserve[index] <= 0.0:
        level, message = ERROR, "the winding has reached its thermal limit; let it rest"
    elif report.thermal_reserve[index] < _LITTLE_RESERVE:
        level, message = WARN, f"thermal limit in {report.thermal_reserve[index]:.0f} s at this current"
    return DiagnosticEntry(level, message, values, f"servo {servo}")
