# SPDX-License-Identifier: Apache-2.0
"""Controls the arm's servos cycle by cycle: trajectories, stops on faults, recovery. No ROS.

One thread calls `open`, `cycle` and `close`; any thread may call `submit` and `request`, which take effect in the next
cycle. Torque is switched on only by request, and every fault ends with torque off. Every switch-off first requests that
the contactor opens: electrodes that carry current must not separate.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Callable

from deltacharger_driver.errors import DriverError, PortError, PortGone, TrajectoryRefused
from deltacharger_driver.orders import late
from deltacharger_driver.servos.bus import ServoBus
from deltacharger_driver.servos.goals import ServoGoals
from deltacharger_driver.servos.joint_watch import STOP_TIME, JointWatch
from deltacharger_driver.servos.port import ServoPort
from deltacharger_driver.servos.reconnection import Reconnection
from deltacharger_driver.servos.report import ServoMemory, ServoPhase, ServoReport, find_faults
from deltacharger_driver.servos.requests import Contactor, NoContactor, ServoRequest, ServoRequests, wait_until_open
from deltacharger_driver.servos.restarts import ServoRestarts
from deltacharger_driver.servos.snapshot import BusSettings, BusSnapshot
from deltacharger_driver.servos.trajectory import HOLD, Trajectory

OPENING_TIME = 0.3  # s; after a request, longest time with torque on until the contactor is reported open
_TRIPS, _TRIPS_WITHIN = 3, 2.0  # this many watchdog trips within this many s are a fault


class ServoController:
    """The arm's servos with their safety rules.

    Args:
        settings: wiring and mounting.
        current_bound: of each servo if a trajectory sets none, A.
        torque_constant: N·m/A, converts a trajectory's torque bound into a current.
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
        current_bound: float,
        torque_constant: float,
        notify: Callable[[str, str], None] = lambda severity, sentence: None,
        contactor: Contactor | None = None,
        handler: type[ServoPort] = ServoPort,
    ) -> None:
        self.watchdog_trips = 0
        self.bus = ServoBus(settings, handler)
        self._clock = self.bus.clock
        self._ids = settings.ids
        self._goals = ServoGoals(len(settings.ids), current_bound, torque_constant)
        self._watch = JointWatch(settings, torque_constant)
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
        self._memory = ServoMemory(len(settings.ids))

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
            self._phase = ServoPhase.OFF
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
