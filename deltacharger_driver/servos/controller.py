# SPDX-License-Identifier: Apache-2.0
"""Controls the arm's servos cycle by cycle: trajectories, stops on faults, recovery, heat of the windings. No ROS.

One thread calls `open`, `cycle` and `close`; any thread may call `submit` and `request`, which take effect in the next
cycle. Torque is switched on only by request, and every fault ends with torque off. Every switch-off first requests that
the contactor opens: electrodes that carry current must not separate.
"""

import contextlib
import math
import queue
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import asdict

from deltacharger_core import real_time, servo_types, texts
from deltacharger_driver.errors import DriverError, PortError, PortGone, TrajectoryRefused
from deltacharger_driver.servos import bus, link, motion, registers

_POLL_PERIOD = 0.005  # s between two checks of the contactor
_REBOOT_TIME = 3.0  # s until all servos must be back
_REOPEN_EVERY = 0.5  # s between two attempts to reopen the port

OPENING_TIME = 0.3  # s; after a request, longest time with torque on until the contactor is reported open
_TRIPS, _TRIPS_WITHIN = 3, 2.0  # this many watchdog trips within this many s are a fault

OK, WARN, ERROR = b"\0", b"\1", b"\2"
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_HOT = 10.0  # °C below the servo's own limit
_LITTLE_RESERVE = 60.0  # s
_SMOOTHING = 0.5  # s, time constant of the current in `reserve`; the heat uses the unsmoothed current

REST_TEMPERATURE = 25.0  # °C, where the heat is 0


def reserve(heat: float, current: float, servo: servo_types.ServoType) -> float:
    """Return the time for which `current` may flow until the limit, s; 0 at the limit, inf if never reached.

    h(t) = i²τ + (h − i²τ) e^(−t/τ) = H, solved for t. An unknown current or heat (NaN) gives NaN.

    Args:
        heat: present heat above rest, A²s.
        current: present current, A, of either sign.
        servo: its type, which has τ and H.
    """
    if math.isnan(heat) or math.isnan(current):
        return math.nan
    limit, constant = servo.heat_limit, servo.heat_constant
    if heat >= limit:
        return 0.0
    final = current * current * constant
    if final <= limit:
        return math.inf
    return constant * math.log((final - heat) / (final - limit))


class ThermalModel:
    """The heat of one servo: an I²t model with cooling, in addition to its temperature.

    The heat h (A²s) above rest follows dh/dt = i² − h/τ; its limit H is reached where the servo's own temperature limit
    is. The MX-64's two constants rest on three statements:
    - Several amperes overheat the servo in minutes: at 3 A the limit must be reached in 60–180 s; 120 s is assumed.
    - The real charger held 0.5 A for four hours: at 0.5 A the limit must never be reached, so τ · 0.5² < H.
    - About 0.8 A can be held for about 40 min.

    With τ = 4000 s, H = 3² · τ · (1 − e^(−120/τ)) = 1064 A²s. Then √(H/τ) = 0.516 A is allowed for ever, just above
    what was demonstrated; 0.8 A lasts 36 min. Change this calibration only after measurements of a real winding.

    An unknown current counts as the last known one, so that missing data never cool the model.

    Args:
        servo: its type.
    """

    def __init__(self, servo: servo_types.ServoType) -> None:
        self.heat = 0.0
        self._servo = servo
        self._square = math.nan
        self._mean_square = math.nan

    def start_at(self, temperature: float) -> None:
        """Set the heat from the servo's temperature, °C, so that a restart does not lose it."""
        if math.isnan(temperature):
            return
        share = (temperature - REST_TEMPERATURE) / (self._servo.temperature_limit - REST_TEMPERATURE)
        self.heat = min(max(share, 0.0), 1.0) * self._servo.heat_limit

    def update(self, current: float, elapsed: float) -> None:
        """Apply `current` (A, NaN = unknown) for `elapsed` s.

        Exact for a current that is constant over the step.
        """
        if not math.isnan(current):
            self._square = current * current
        if math.isnan(self._square):
            return
        constant = self._servo.heat_constant
        final = self._square * constant
        self.heat = final + (self.heat - final) * math.exp(-elapsed / constant)
        if math.isnan(self._mean_square):
            self._mean_square = self._square
        else:
            self._mean_square += (self._square - self._mean_square) * -math.expm1(-elapsed / _SMOOTHING)

    def reserve(self) -> float:
        """Return the time for which the present current may flow until the limit, s; inf if never reached.

        NaN before the first current is known.
        """
        return reserve(self.heat, math.sqrt(self._mean_square), self._servo)


class ServoRequest:
    """A request to the servos' thread, with its result.

    Args:
        action: "torque_on", "torque_off" or "reboot".
        sent: s, the servos' clock.
    """

    def __init__(self, action: str, sent: float) -> None:
        self.action = action
        self.sent = sent
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


class Contactor:
    """The contactor for the servos' thread: it must be open before torque goes off. This one does not exist.

    No method may wait or raise: they are called between two bus cycles.
    """

    def request_open(self) -> None:
        """Request an opening."""

    def is_open(self) -> bool:
        """Return whether it was reported open after the last `request_open`, or does not exist."""
        return True


class ServoController:
    """The arm's servos with their safety rules.

    Args:
        settings: wiring and mounting.
        notify: called with (severity "info" | "warning" | "error", message) for every event to log.
        contactor: opened before torque is switched off.
        handler: class of the port, which also keeps the time.

    Attributes:
        phase: of the servos; it and the next may be read from any thread.
        stop_reason: reason of the last stop.
        unrequested_stop: reason why torque went off without a request; '' once it is on again.
        watchdog_trips: number of stops by the servos' bus watchdog.
        reconnections: number of times that a vanished port was reopened.
    """

    def __init__(
        self,
        settings: registers.BusSettings,
        notify: Callable[[str, str], None] = lambda severity, sentence: None,
        contactor: Contactor | None = None,
        handler: type[link.ServoPort] = link.ServoPort,
    ) -> None:
        self.phase = bus.ServoPhase.DISCONNECTED
        self.stop_reason = self.unrequested_stop = ""
        self.watchdog_trips = self.reconnections = 0
        self.bus = bus.ServoBus(settings, handler)
        self._clock = self.bus.clock
        self._ids = settings.ids
        self._notify = notify
        self._contactor = contactor or Contactor()
        self._lock = threading.Lock()
        self._requests: queue.SimpleQueue[ServoRequest] = queue.SimpleQueue()
        self._switching_off: list[ServoRequest] = []  # that wait for torque to go off
        self._rebooting: ServoRequest | None = None
        self._away: set[int] = set()  # indices of servos being rebooted that are not back
        self._reboot_until = self._reopen_at = 0.0
        self._lost = "not connected"  # why there is no port
        self._setup_error = ""
        self._submitted: tuple[motion.Trajectory, float] | None = None
        self._stop_at = math.inf
        self._trips: deque[float] = deque([-math.inf] * _TRIPS, maxlen=_TRIPS)
        self._heated_at = math.nan
        self._report = self.bus.unknown()
        self._use_type()

    def _use_type(self) -> None:
        """Begin anew, for servos of the bus's type."""
        self._drive, count = self.bus.drive, len(self._ids)
        self._goals = motion.ServoGoals(count, self._drive.current_bound, self._drive.torque_constant)
        self._watch = motion.JointWatch(self.bus.settings, self._drive)
        self._thermal = [ThermalModel(self._drive.servo) for _ in range(count)]

    @property
    def is_releasing(self) -> bool:
        """Whether torque is about to be switched off by request."""
        return bool(self._switching_off)

    def now(self) -> float:
        """Return the time of the controller's clock, s."""
        return self._clock.now()

    def open(self) -> None:
        """Open the port and configure the servos, torque off.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: the port cannot be opened.
            HandshakeError: lists every fault of the servos.
        """
        self.bus.open()
        if self.bus.drive != self._drive:  # at the first opening their type becomes known
            self._use_type()
        self.phase = bus.ServoPhase.OFF

    def close(self) -> None:
        """Switch torque off if it is on, and release the port. Never raises; safe to call twice.

        Waits at most `OPENING_TIME` for the contactor. If possible, first request "torque_off" and cycle until it is.
        """
        if self.bus.is_open and self.phase in (bus.ServoPhase.ON, bus.ServoPhase.STOPPING):
            self._contactor.request_open()
            end = self._clock.now() + OPENING_TIME
            while not self._contactor.is_open() and self._clock.now() < end:
                self._clock.sleep(_POLL_PERIOD)
            with contextlib.suppress(DriverError):
                self.bus.disable_torque()
        self.bus.close()
        self.phase = bus.ServoPhase.DISCONNECTED
        self._refuse_all("the driver is closing")

    def submit(self, trajectory: motion.Trajectory, start: float = math.inf) -> None:
        """Replace the running trajectory in the next cycle.

        Args:
            trajectory: its first segment begins at the goal of that moment. Points in the past are skipped; if all
                are, the last point holds.
            start: time zero of the trajectory, s, monotonic; at the latest the cycle in which it takes effect.

        Raises:
            TrajectoryRefused: torque is off, the servos are being stopped, or its goals are faster than the joints.
        """
        with self._lock:
            if self.phase is not bus.ServoPhase.ON:
                more = {bus.ServoPhase.OFF: "; call set_torque first", bus.ServoPhase.STOPPING: f": {self.stop_reason}"}
                raise TrajectoryRefused(self.phase.value + more.get(self.phase, ""))
            now = self._clock.now()
            self._goals.advance(now)
            self._watch.follow(now, self._goals.angles)
            self._watch.check(trajectory, max(now - start, 0.0), self._goals.default)
            self._submitted = trajectory, start

    def freeze(self) -> None:
        """Stay at the present goal; call it only from the servos' thread."""
        if self._submitted is not None or self._goals.are_moving:
            self._submitted = motion.HOLD, math.inf

    def request(self, action: str, age: float = 0.0) -> ServoRequest:
        """Request "torque_on", "torque_off" or "reboot"; the servos' thread executes it, or refuses it as too late.

        Args:
            action: what to do.
            age: s since the client sent it.
        """
        request = ServoRequest(action, self._clock.now() - age)
        self._requests.put(request)
        return request

    def stop(self, reason: str) -> None:
        """Goal := present position, open contactor, torque off after `STOP_TIME`; call it from the servos' thread."""
        if self.phase is bus.ServoPhase.ON:
            self._begin_stop(reason, motion.STOP_TIME)
            self.unrequested_stop = reason
            self._notify("error", f"stopping all servos: {reason}")

    def _begin_stop(self, reason: str, seconds: float) -> None:
        """Hold the present position, request an open contactor, and switch torque off after `seconds`."""
        with self._lock:
            self.phase = bus.ServoPhase.STOPPING
            self._submitted = None
        self.stop_reason = reason
        self._stop_at = self._clock.now() + seconds
        self._goals.hold(self._report.angle)
        self._contactor.request_open()

    def cycle(self) -> bus.ServoReport:
        """Run one bus cycle and return the state after it. Never raises `DriverError`."""
        try:
            if self.phase is bus.ServoPhase.DISCONNECTED:
                self._reopen()
            self._serve_requests()
            if self.phase is not bus.ServoPhase.DISCONNECTED:
                self._exchange()
        except PortGone as error:
            self._disconnect(error)
        if self.phase is bus.ServoPhase.DISCONNECTED:
            self._report = self.bus.unknown()
        return self._report._replace(
            phase=self.phase,
            thermal_reserve=tuple(model.reserve() for model in self._thermal),
            stray=tuple(self._watch.strays),
            faults=tuple(self._faults()),
        )

    def _exchange(self) -> None:
        """Send goals, read the state and react to it."""
        if self.phase is bus.ServoPhase.OFF:
            self._take_report(self.bus.read())
        else:
            self._advance()
            self._take_report(self.bus.exchange(self._goals.angles, self._goals.bounds))
        self._check_watchdogs()
        if self.phase is bus.ServoPhase.ON:
            self._stop_on_faults()
        elif self.phase is bus.ServoPhase.STOPPING and self._may_switch_off():
            self._switch_off()
        elif self.phase is bus.ServoPhase.OFF:
            self._keep_off()
        if self.phase is bus.ServoPhase.OFF:
            self._configure_restarted()

    def _take_report(self, report: bus.ServoReport) -> None:
        """Store a cycle's report, and let its currents heat the windings."""
        elapsed = 0.0 if math.isnan(self._heated_at) else report.time - self._heated_at
        for model, current, temperature in zip(self._thermal, report.current, report.temperature, strict=True):
            if math.isnan(self._heated_at):
                model.start_at(temperature)
            model.update(current, elapsed)
        self._report, self._heated_at = report, report.time

    def _stop_on_faults(self) -> None:
        """Stop on any fault; the servos get the stop goal within this cycle."""
        report, faults = self._report, self._faults()
        measured = zip(report.valid, report.angle, report.velocity, report.current, strict=True)
        fresh = (row if valid else (math.nan,) * 3 for valid, *row in measured)  # a kept angle would seem to stand
        if astray := self._watch.fault(report.time, self._goals.angles, *zip(*fresh, strict=True)):
            faults.append(astray)
        if lost := report.with_torque(self._ids, False):
            faults.append(f"servo {lost[0]} switched its torque off on its own")
        if faults:
            self.stop("; ".join(faults))
            self.bus.write_goals(self._goals.angles, self._goals.bounds)

    def _keep_off(self) -> None:
        """Switch off a servo that missed the switch-off, as soon as it answers again."""
        on = self._report.with_torque(self._ids, True)
        if on:
            self._notify("warning", f"servos {on} have torque without a request; switching it off")
            self.bus.disable_torque()

    def _configure_restarted(self) -> None:
        """Configure restarted servos again; finish a reboot if all are back or its time is over."""
        for index, servo in enumerate(self._ids):
            if self._report.rebooted[index] and self._is_configured(index):
                self._notify("warning", f"servo {servo} had restarted; configured again, torque off")
                self._away.discard(index)
                if not self._rebooting and self.unrequested_stop:  # it may be why torque went off
                    self.unrequested_stop += f"; servo {servo} has restarted on its own"
        if not self._rebooting:
            return
        faults = "; ".join(self._faults())
        if not self._away and self._report.complete:
            self._finish_reboot(not faults, faults or "rebooted and configured; torque is off")
        elif self._clock.now() >= self._reboot_until:
            self._finish_reboot(False, faults or "the servos did not come back in time")

    def _is_configured(self, index: int) -> bool:
        """Configure a servo again; tell each new reason why it cannot be."""
        try:
            self.bus.configure(index)
        except PortGone:
            raise
        except DriverError as error:
            if str(error) != self._setup_error:
                self._setup_error = str(error)
                self._notify("warning", f"servo {self._ids[index]} had restarted: {error}")
            return False
        return True

    def _finish_reboot(self, success: bool, message: str) -> None:
        if self._rebooting:
            self._rebooting.finish(success, message)
            self._rebooting = None

    def _may_switch_off(self) -> bool:
        """Return whether torque may go off: the stop time has passed, or it was requested and the contactor is open."""
        return self._clock.now() >= self._stop_at or (self.is_releasing and self._contactor.is_open())

    def _advance(self) -> None:
        """Take a submitted trajectory; update goal and bounds for now."""
        now = self._clock.now()
        with self._lock:
            submitted, self._submitted = self._submitted, None
        if submitted is not None and self.phase is bus.ServoPhase.ON:
            self._goals.follow(*submitted, now)
        self._goals.advance(now)

    def _check_watchdogs(self) -> None:
        tripped = [servo for servo, has in zip(self._ids, self._report.watchdog_tripped, strict=True) if has]
        if not tripped:
            return
        if self.phase is bus.ServoPhase.ON:
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
            self._goals.resume_at(self._report.angle, now)
            self._notify("warning", f"{event}; resuming from where they stopped")

    def _faults(self) -> list[str]:
        """Return the faults that forbid moving, one sentence each."""
        if self.phase is bus.ServoPhase.DISCONNECTED:
            return [self._lost]
        found = []
        for index, servo in enumerate(self._ids):
            if self._report.rebooted[index]:
                found.append(f"servo {servo} has restarted on its own")
            elif self._report.missing[index]:
                found.append(f"servo {servo} does not answer; check its supply and its cable")
            if bits := self._report.hardware_error[index]:
                errors = registers.describe_hardware_error(bits)
                found.append(f"servo {servo} has latched: {errors}; remove the cause, then call reboot_servos")
        return found

    def _serve_requests(self) -> None:
        while not self._requests.empty():
            request = self._requests.get_nowait()
            try:
                if refusal := real_time.late(self._clock.now() - request.sent):
                    request.finish(False, refusal)
                elif self.phase is bus.ServoPhase.DISCONNECTED:
                    request.finish(False, self._lost)
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
        if self.phase is bus.ServoPhase.ON:
            request.finish(True, "torque is already on")
            return
        if self.phase is bus.ServoPhase.STOPPING:
            request.finish(False, f"stopping: {self.stop_reason}")
            return
        faults = self._faults()
        if faults or self._rebooting:
            request.finish(False, "; ".join(faults) or "the servos are being rebooted")
            return
        self._take_report(self.bus.enable_torque(self._goals.default))
        self._goals.begin_at(self._report.angle)
        self._watch.begin_at(self._report.angle)
        self.unrequested_stop = ""
        with self._lock:
            self._submitted = None
            self.phase = bus.ServoPhase.ON
        request.finish(True, "torque is on, holding the present position")
        self._notify("info", "torque on")

    def _switch_off_when_open(self, request: ServoRequest) -> None:
        """Switch torque off once the contactor is open, or after `OPENING_TIME`."""
        self._switching_off.append(request)
        if self.phase is bus.ServoPhase.ON:
            self._begin_stop("torque is being switched off on request", OPENING_TIME)
        elif self.phase is bus.ServoPhase.STOPPING:
            self._stop_at = min(self._stop_at, self._clock.now() + OPENING_TIME)
            self._contactor.request_open()
        else:
            self._switch_off()

    def _switch_off(self) -> None:
        with self._lock:
            was, self.phase = self.phase, bus.ServoPhase.OFF
            self._submitted = None
        self._stop_at = math.inf
        unseen = was is bus.ServoPhase.STOPPING and not self._contactor.is_open()
        try:
            self.bus.disable_torque()
        finally:
            if unseen:
                self._notify("warning", "torque off; the contactor was not seen open before, check tactile_node")
            elif was is not bus.ServoPhase.OFF:
                self._notify("info", "torque off")
        doubt = "; the contactor was not seen open before" if unseen else ""
        self._finish_switching_off(True, f"torque is off{doubt}")

    def _finish_switching_off(self, success: bool, message: str) -> None:
        for request in self._switching_off:
            request.finish(success, message)
        self._switching_off.clear()

    def _reboot(self, request: ServoRequest) -> None:
        """Restart the servos with a latched error, or all if none has one; `request` is finished when they are back."""
        if self.phase is not bus.ServoPhase.OFF:
            request.finish(False, f"{self.phase.value}; call set_torque with false first")
        elif self._rebooting:
            request.finish(False, "the servos are already being rebooted")
        else:
            faulty = {index for index, bits in enumerate(self._report.hardware_error) if bits}
            self._away = faulty or set(range(len(self._ids)))
            for index in sorted(self._away):
                self.bus.reboot(index)
            self._rebooting, self._reboot_until = request, self._clock.now() + _REBOOT_TIME

    def _reopen(self) -> None:
        """Open the port again, if the next attempt is due."""
        if self._clock.now() < self._reopen_at:
            return
        try:
            self.open()
        except DriverError as error:
            self._reopen_at = self._clock.now() + _REOPEN_EVERY
            if str(error) != self._lost:
                self._lost = str(error)
                self._notify("error", self._lost)
        else:
            self.reconnections += 1
            self._notify("info", "connected again; torque is off")

    def _disconnect(self, error: PortError) -> None:
        self.bus.close()
        if self.phase in (bus.ServoPhase.ON, bus.ServoPhase.STOPPING):
            self.unrequested_stop = str(error)
            self._contactor.request_open()
        with self._lock:
            self.phase = bus.ServoPhase.DISCONNECTED
            self._submitted = None
        self._lost, self._reopen_at = str(error), self._clock.now() + _REOPEN_EVERY
        self._refuse_all(str(error))
        self._notify("error", str(error))

    def _refuse_all(self, reason: str) -> None:
        self._finish_reboot(False, reason)
        self._finish_switching_off(False, reason)
        while not self._requests.empty():
            self._requests.get_nowait().finish(False, reason)


def bus_entry(
    report: bus.ServoReport, controller: ServoController, refused: str = ""
) -> tuple[bytes, str, dict[str, object]]:
    """Return level, message and values of the bus for the diagnostics.

    Args:
        report: of the last cycle.
        controller: for its counters.
        refused: reason why a trajectory was refused since the last diagnostic; '' = none was.
    """
    settings = controller.bus.settings
    values: dict[str, object] = {
        "state": report.phase.value,
        "baud_rate": settings.baud_rate,
        "ids": list(settings.ids),
        "type": controller.bus.drive.servo.name,
        **asdict(controller.bus.counters),
        "watchdog_trips": controller.watchdog_trips,
        "reconnections": controller.reconnections,
    }
    if report.faults:
        return ERROR, "; ".join(report.faults), values
    if report.phase is bus.ServoPhase.STOPPING:
        return WARN if controller.is_releasing else ERROR, controller.stop_reason, values
    if refused:
        return WARN, refused, values
    if report.phase is bus.ServoPhase.OFF and controller.unrequested_stop:
        return WARN, f"torque off: {controller.unrequested_stop}", values
    return OK, report.phase.value, values


def servo_entry(report: bus.ServoReport, index: int, hot: float) -> tuple[bytes, str, dict[str, object]]:
    """Return level, message and values of one servo for the diagnostics; it switches itself off at `hot` °C."""
    temperature, reserve_left = report.temperature[index], report.thermal_reserve[index]
    values: dict[str, object] = {
        "angle": texts.quantity(report.angle[index], ".4f", "rad"),
        "current": texts.quantity(report.current[index], ".3f", "A"),
        "voltage": texts.quantity(report.voltage[index], ".1f", "V"),
        "temperature": texts.quantity(temperature, ".0f", "°C"),
        "thermal_reserve": texts.quantity(reserve_left, ".0f", "s"),
        "torque_enabled": report.torque_enabled[index],
    }
    if errors := registers.describe_hardware_error(report.hardware_error[index]):
        return ERROR, f"latched: {errors}", values
    if not report.valid[index]:
        return ERROR, "no good reply; check its supply and cable", values
    if temperature >= hot - _HOT:
        return WARN, f"hot: {temperature:.0f} °C", values
    if reserve_left <= 0.0:
        return ERROR, "the winding has reached its thermal limit; let it rest", values
    if reserve_left < _LITTLE_RESERVE:
        return WARN, f"thermal limit in {reserve_left:.0f} s at this current", values
    return OK, "OK", values
