# SPDX-License-Identifier: Apache-2.0
"""The arm's servos as one device: a snapshot per cycle, goals with current bounds, torque, reboot."""

from __future__ import annotations

import contextlib
import math
import struct
from collections.abc import Sequence

from deltacharger_core.machine import TICKS_PER_TURN
from deltacharger_driver.errors import CorruptReply, DriverError, NoAnswer, RangeError, ServoFault
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.mx64 import (
    CURRENT_UNIT,
    REGISTERS,
    VELOCITY_UNIT,
    VOLTAGE_UNIT,
    WATCHDOG_TRIPPED,
    angle_to_ticks,
    current_to_counts,
    describe_hardware_error,
    ticks_to_angle,
)
from deltacharger_driver.servos.port import ServoPort
from deltacharger_driver.servos.protocol import sync_write_packet
from deltacharger_driver.servos.setup import configure, restart_watchdog, set_up
from deltacharger_driver.servos.snapshot import (
    READ_ADDRESS,
    READ_LENGTH,
    WRITE_ADDRESS,
    WRITE_LENGTH,
    BusSettings,
    BusSnapshot,
    decode_block,
    has_restarted,
)

UNKNOWN_AFTER = 3
"""Cycles without a good reply after which a servo's last values are discarded."""
MISSING_TIME = 0.2
"""s without a good reply (in addition to `UNKNOWN_AFTER` cycles) after which a servo counts as missing, so that a pause
of this computer alone is not a fault of the servo."""
_RETRY_EVERY = 25  # cycles between two requests to a missing servo: waiting for it must not slow the others
_WRITE_LAYOUT = struct.Struct("<hi")
UNKNOWN = (math.nan,) * 5
"""Angle, velocity, current, voltage and temperature of a servo without a good reply."""


class ServoBus:
    """The servos on one port. The thread that opens it owns it until it is closed.

    Args:
        settings: wiring and mounting.
        handler: class of the port.

    Attributes:
        counters: communication errors so far.
        clock: keeps the time.
    """

    def __init__(self, settings: BusSettings, handler: type[ServoPort] = ServoPort) -> None:
        self.settings = settings
        self._link = ServoLink(settings.port, settings.baud_rate, settings.reply_margin, handler)
        self.clock = self._link.clock
        self.counters = self._link.counters
        self._count = len(settings.ids)
        self._largest_counts = current_to_counts(settings.current_max)
        self._cycle = 0
        self._goals: tuple[tuple[float, ...], tuple[float, ...]] | None = None
        self._goal_bytes = b""
        self._forget()

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._link.is_open

    def open(self, scan: bool = True) -> None:
        """Open the port, identify every servo and configure it; torque is off afterwards.

        Args:
            scan: look for missing servos at other speeds, so that the error names the speed.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: the port cannot be opened.
            HandshakeError: servos are missing, wrong or reject their configuration; lists every fault.
        """
        self._forget()
        self._link.open()
        try:
            set_up(self._link, self.settings, scan)
        except BaseException:
            self._link.close()
            raise

    def close(self) -> None:
        """Release the port. Sends nothing to the servos: switch torque off first. Never raises; safe to call twice."""
        self._link.close()

    def configure(self, index: int) -> None:
        """Configure servo `index` again, torque off, after a restart.

        Raises:
            HandshakeError: it rejects its configuration.
            PortGone: the port vanished.
        """
        configure(self._link, self.settings.ids[index], self.settings)
        self._rebooted[index] = False
        self._placed[index] = False
        self._torque[index] = False
        self._missed[index] = min(self._missed[index], 1)  # ask it again in the next cycle

    def read(self) -> BusSnapshot:
        """Return the state of all servos; NaN and not valid for a servo without a good reply.

        One sync read while all servos answer. After a failure each servo is read individually, because in a sync read
        the servos behind a missing one stay silent. A servo missing for longer is read only every 25th cycle.

        Raises:
            PortGone: the port vanished.
        """
        return self._read(b"")

    def exchange(self, angles: Sequence[float], currents: Sequence[float]) -> BusSnapshot:
        """Send goals like `write_goals` and return the state like `read`, in one transmission.

        Raises:
            RangeError, PortGone: as for both.
        """
        return self._read(self._goal_packet(angles, currents))

    def _read(self, ahead: bytes) -> BusSnapshot:
        """Read all servos; the packets `ahead`, which get no reply, are sent with the first request."""
        ids = self.settings.ids
        if not any(self._missed):
            replies = self._link.sync_read(ids, READ_ADDRESS, READ_LENGTH, ahead)
        else:
            replies = {}
            if ahead:
                self._link.send(ahead)
            for index, servo in enumerate(ids):
                if not self._missing(index) or (self._cycle + index) % _RETRY_EVERY == 0:
                    replies.update(self._link.sync_read((servo,), READ_ADDRESS, READ_LENGTH))
        now = self.clock.now()
        self._cycle += 1
        return self._snapshot(now, replies)

    def write_goals(self, angles: Sequence[float], currents: Sequence[float]) -> None:
        """Send goal angle (rad) and current bound (A, 0 to `current_max`) of each servo; they change together.

        Servos do not confirm it. While torque is off, nothing moves.

        Raises:
            RangeError: a bound above `current_max`, or a value outside a register's range; nothing is sent.
            PortGone: the port vanished.
        """
        self._link.send(self._goal_packet(angles, currents))

    def _goal_packet(self, angles: Sequence[float], currents: Sequence[float]) -> bytes:
        """Return the packet that writes goal and bound of every servo; cached while they do not change."""
        goals = tuple(angles), tuple(currents)
        if goals == self._goals:
            return self._goal_bytes
        settings = self.settings
        rows = []
        for index, (angle, current) in enumerate(zip(angles, currents, strict=True)):
            rows.append((settings.ids[index], _WRITE_LAYOUT.pack(self._bound(current), self._ticks(index, angle))))
        self._goals, self._goal_bytes = goals, sync_write_packet(WRITE_ADDRESS, WRITE_LENGTH, rows)
        return self._goal_bytes

    def enable_torque(self, currents: Sequence[float]) -> BusSnapshot:
        """Switch the torque of all servos on at their present position: goal := present position first.

        Args:
            currents: current bound of each servo, A.

        Returns:
            the snapshot whose angles became the goals.

        Raises:
            NoAnswer: a servo is missing or has just restarted; none is switched on.
            ServoFault: a servo has a latched hardware error, stands outside its joint's range, or rejects it; all are
                switched off again.
            PortGone: the port vanished.
        """
        snapshot = self.read()
        for index, servo in enumerate(self.settings.ids):
            if not snapshot.valid[index]:
                raise NoAnswer(f"servo {servo}", "read before switching torque on", self.settings.reply_margin)
            if snapshot.hardware_error[index]:
                bits = snapshot.hardware_error[index]
                text = f"{describe_hardware_error(bits)} latched; remove the cause, then reboot it"
                raise ServoFault(servo, "switch torque on", text, bits)
            if not self._placed[index]:
                raise ServoFault(servo, "switch torque on", self._misplaced(snapshot.angle[index]))
        try:
            for index, servo in enumerate(self.settings.ids):
                restart_watchdog(self._link, servo, self.settings.watchdog)
                self._verify_goal(index, snapshot.angle, currents)
            for servo in self.settings.ids:
                self._link.write(servo, "torque_enable", 1)
            self._torque = [True] * self._count
        except DriverError:
            with contextlib.suppress(DriverError):
                self.disable_torque()
            raise
        return snapshot

    def disable_torque(self) -> None:
        """Switch all servos off: one packet to all, then one to each until it confirms; a servo that missed its last
        reply is tried once.

        Raises:
            PortGone: the port vanished; the servos stop by their watchdog.
        """
        register = REGISTERS["torque_enable"]
        off = [(servo, b"\0") for servo in self.settings.ids]
        self._link.send(sync_write_packet(register.address, register.size, off))
        for index, servo in enumerate(self.settings.ids):
            with contextlib.suppress(NoAnswer, CorruptReply, ServoFault):
                self._link.write(servo, "torque_enable", 0, hurry=self._missed[index] > 0)
                self._torque[index] = False

    def reboot(self, index: int) -> None:
        """Restart servo `index`: torque off, latched errors cleared. Afterwards it must be configured again.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: it did not accept the instruction.
        """
        self._link.reboot(self.settings.ids[index])
        self._torque[index] = False

    def restart_watchdogs(self) -> None:
        """Clear and arm the watchdog of every servo that answers, so that it accepts goals again.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: a servo does not accept it.
        """
        for servo in (servo for servo, missed in zip(self.settings.ids, self._missed, strict=True) if not missed):
            restart_watchdog(self._link, servo, self.settings.watchdog)

    def _forget(self) -> None:
        """Reset the known state of all servos."""
        self._missed = [0] * self._count
        self._seen = [self.clock.now()] * self._count
        self._rebooted = [False] * self._count
        self._errors = [0] * self._count
        self._torque = [False] * self._count
        self._tripped = [False] * self._count
        self._turns = [0] * self._count  # whole turns beyond the arm's angle that the encoder counts since it started
        self._placed: list[bool] = [False] * self._count  # whether they are known

    def _missing(self, index: int) -> bool:
        silent = self.clock.now() - self._seen[index]
        return self._missed[index] >= UNKNOWN_AFTER and silent >= MISSING_TIME

    def _bound(self, current: float) -> int:
        """Return a current bound in counts; the check is in counts, so that rounding never refuses the largest."""
        counts = current_to_counts(current) if current >= 0.0 else -1
        if not 0 <= counts <= self._largest_counts:
            raise RangeError("current bound", current, 0.0, self.settings.current_max, " A")
        return counts

    def _verify_goal(self, index: int, angles: Sequence[float], currents: Sequence[float]) -> None:
        """Write and verify the goal of one servo, so that it does not jump when switched on."""
        ticks, servo = self._ticks(index, angles[index]), self.settings.ids[index]
        self._link.write(servo, "goal_current", self._bound(currents[index]))
        self._link.write(servo, "goal_position", ticks)
        found = self._link.read(servo, "goal_position")
        if found != ticks:
            raise ServoFault(servo, "switch torque on", f"goal position reads {found} after {ticks} was written")

    def _ticks(self, index: int, angle: float) -> int:
        settings = self.settings
        ticks = angle_to_ticks(angle, settings.zero_ticks[index], settings.direction[index])
        return ticks + self._turns[index] * TICKS_PER_TURN

    def _place(self, index: int, ticks: int) -> float:
        """Return the arm's angle, rad. A servo that starts forgets whole turns: those are taken out that bring the arm
        into its range, if there is just one such number.
        """
        settings, (low, high) = self.settings, self.settings.reach

        def angle(turns: int) -> float:
            count = ticks - turns * TICKS_PER_TURN
            return ticks_to_angle(count, settings.zero_ticks[index], settings.direction[index])

        if not self._placed[index]:
            nearest = math.floor((ticks - settings.zero_ticks[index]) / TICKS_PER_TURN)
            within = [turns for turns in (nearest, nearest + 1) if low <= angle(turns) <= high]
            self._placed[index] = len(within) == 1
            self._turns[index] = min((nearest, nearest + 1), key=lambda turns: abs(angle(turns) - 0.5 * (low + high)))
        return angle(self._turns[index])

    def _misplaced(self, angle: float) -> str:
        low, high = (math.degrees(value) for value in (self.settings.joint_min, self.settings.joint_max))
        return (
            f"its arm stands at {math.degrees(angle):.0f}° by zero_ticks and direction, and no whole turn, or several, "
            f"bring it into {low:.0f}…{high:.0f}°: correct them, or the horn on its shaft"
        )

    def _snapshot(self, now: float, replies: dict[int, tuple[int, bytes]]) -> BusSnapshot:
        rows = [self._learn(index, now, replies.get(servo)) for index, servo in enumerate(self.settings.ids)]
        angle, velocity, current, voltage, temperature = zip(*rows, strict=True)
        return BusSnapshot(
            time=now,
            valid=tuple(missed == 0 for missed in self._missed),
            angle=angle,
            velocity=velocity,
            current=current,
            voltage=voltage,
            temperature=temperature,
            hardware_error=tuple(self._errors),
            torque_enabled=tuple(self._torque),
            watchdog_tripped=tuple(self._tripped),
            rebooted=tuple(self._rebooted),
            missed=tuple(self._missed),
            missing=tuple(map(self._missing, range(self._count))),
        )

    def _learn(self, index: int, now: float, reply: tuple[int, bytes] | None) -> tuple[float, ...]:
        """Store one servo's reply; return angle, velocity, current, voltage, temperature, NaN unless it is good."""
        data = b"" if reply is None else reply[1]
        self._missed[index] += 1
        self._tripped[index] = False
        if len(data) != READ_LENGTH:
            return UNKNOWN
        if has_restarted(data):
            self._rebooted[index] = True
            self._torque[index] = False
            return UNKNOWN
        try:
            reading = decode_block(data)
        except RangeError:
            self.counters.implausible += 1
            return UNKNOWN
        self._missed[index] = 0
        self._seen[index] = now
        self._rebooted[index] = False
        self._errors[index] = reading.hardware_error
        self._torque[index] = reading.torque_enabled
        self._tripped[index] = reading.watchdog == WATCHDOG_TRIPPED
        sign = self.settings.direction[index]
        return (
            self._place(index, reading.ticks),
            sign * reading.velocity * VELOCITY_UNIT,
            sign * reading.current * CURRENT_UNIT,
            reading.voltage * VOLTAGE_UNIT,
            float(reading.temperature),
        )
