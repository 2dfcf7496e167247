# SPDX-License-Identifier: Apache-2.0
"""The arm's servos as one device: set-up, a snapshot per cycle, goals with current bounds, torque, reboot."""

import contextlib
import enum
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from deltacharger_core import machine, servo_types
from deltacharger_driver import errors, packets
from deltacharger_driver.servos import registers
from deltacharger_driver.servos.link import ServoLink, ServoPort
from deltacharger_driver.servos.registers import GAINS, REGISTERS, BusSettings, Drive

_UPDATE_ADVICE = "update its firmware to 39 or later (Protocol 2.0) with the vendor's wizard"
_PINGS, _FIRST_PINGS = 2, 10
"""Of a servo at the set-up; at the first one its supply may have been switched on together with the computer."""
_TRIPS_BELOW, _TRIPS_ABOVE = 11.0, 13.0
"""V: highest lower and lowest upper limit of a supply of 12 V."""
_SHUTDOWN_BITS = (2, 5)
"""Errors on which a servo must switch itself off: overheating and overload."""
UNKNOWN_AFTER = 3
"""Cycles without a good reply after which a servo's last values are discarded."""
MISSING_TIME = 0.2
"""s without a good reply (in addition to `UNKNOWN_AFTER` cycles) after which a servo counts as missing, so that a pause
of this computer alone is not a fault of the servo."""
_RETRY_EVERY = 25  # cycles between two requests to a missing servo: waiting for it must not slow the others
_WRITE_LAYOUT = struct.Struct("<hi")
UNKNOWN = (math.nan,) * 5
"""Angle, velocity, current, voltage and temperature of a servo without a good reply."""


def motion_registers(servo: servo_types.ServoType) -> dict[str, int]:
    """Return the registers of a type that act on motion, beside the gains and what is demanded.

    Other software may have left any value. They are read, and written only if different, because EEPROM wears.
    """
    table = registers.registers_of(servo)
    return {
        "return_delay": 0,
        "operating_mode": registers.MODE_CURRENT_POSITION,
        **{name: table[name].high for name in ("acceleration_limit", "velocity_limit") if name in table},
        **{name: table[name].default for name in ("velocity_i_gain", "velocity_p_gain")},
        **dict.fromkeys(("position_i_gain", "feedforward_2_gain", "feedforward_1_gain"), 0),
        "goal_pwm": table["goal_pwm"].high,
        **dict.fromkeys(("goal_velocity", "profile_acceleration", "profile_velocity"), 0),
    }


def _demanded(servo: servo_types.ServoType, current_max: float) -> dict[str, tuple[int, int, str]]:
    """Return the EEPROM registers that are checked but never written: lowest and highest value, reason.

    They were set on purpose.
    """
    least, rating = registers.current_to_counts(current_max, servo), servo.temperature_limit
    unit, lowest, highest = servo.voltage_unit, servo.voltage_min, servo.voltage_max
    supply = f"in units of {unit:g} V, for a supply of 12 V"
    return {
        "drive_mode": (0, 0, "set the sign with the parameter 'direction'"),
        "homing_offset": (0, 0, "set the zero with the parameter 'zero_ticks'"),
        "secondary_id": (255, 255, "otherwise it obeys packets for another servo too"),
        "temperature_limit": (60, rating, f"{rating} °C is the servo's rating; below 60 °C normal work would stop it"),
        "min_voltage": (lowest, round(_TRIPS_BELOW / unit), supply),
        "max_voltage": (round(_TRIPS_ABOVE / unit), highest, supply),
        "pwm_limit": (servo.pwm_limit, servo.pwm_limit, "a lower limit reduces speed and force"),
        "current_limit": (
            least,
            servo.current_limit,
            "the servo would ignore every goal whose current bound is above its limit; raise it to "
            f"{servo.current_limit} or lower the parameter 'current_max' ({current_max:g} A = {least})",
        ),
    }


def set_up(link: ServoLink, settings: BusSettings, before: servo_types.ServoType | None = None) -> Drive:
    """Identify every servo and configure the expected ones; their torque is off afterwards.

    Args:
        link: an open link.
        settings: ids and configuration of the servos.
        before: their type, if it is known; other servos are refused.

    Returns:
        The settings for the type that all of them have.

    Raises:
        HandshakeError: every fault of every servo, one sentence each.
        RangeError: a setting is out of range for their type.
        PortGone: the port vanished.
    """
    found = {servo: _identify(link, servo, _PINGS if before else _FIRST_PINGS) for servo in settings.ids}
    if not any(found.values()):
        raise errors.HandshakeError(
            link.port,
            [f"no servo answers at {link.baud_rate} bit/s: check supply and cable, and {errors.MAYBE_SWAPPED}"],
        )
    first, wanted = next(
        ((servo, kind) for servo, kind in found.items() if isinstance(kind, servo_types.ServoType)), (0, before)
    )
    like = "as before: restart servo_node to use others" if before else f"as servo {first}: use servos of one type"
    drive = settings.drive(before or wanted or servo_types.MX_64)
    faults = []
    for servo, kind in found.items():
        if kind is None:
            faults.append(
                f"servo {servo} does not answer at {link.baud_rate} bit/s; check its supply and its cable, then let "
                "'deltacharger doctor' look for it"
            )
        elif isinstance(kind, str):
            faults.append(kind)
        elif kind is not drive.servo:
            faults.append(f"servo {servo} is {kind}, not {drive.servo} {like}")
        else:
            faults += configure(link, servo, drive)
    if faults:
        raise errors.HandshakeError(link.port, faults)
    return drive


def _identify(link: ServoLink, servo: int, pings: int) -> servo_types.ServoType | str | None:
    """Return the type of a servo, or its fault; None if it does not answer."""
    try:
        model = link.ping(servo, pings)
    except errors.NoAnswer:
        return None
    except errors.CorruptReply:
        return f"servo {servo} sends garbled replies; look for two servos with this id, noise or a bad plug"
    if model in servo_types.TYPES:
        return servo_types.TYPES[model]
    if any(model == each.model_protocol_1 for each in servo_types.TYPES.values()):
        return f"servo {servo} has firmware for Protocol 1.0; {_UPDATE_ADVICE}"
    return f"servo {servo} is model {model}, not {servo_types.NAMES} with Protocol 2.0"


def check_registers(link: ServoLink, servo: int, kind: servo_types.ServoType, current_max: float) -> list[str]:
    """Return the faults of the registers that the driver checks but never writes.

    Args:
        link: an open link.
        servo: its id.
        kind: its type.
        current_max: A, the largest current bound of any goal.

    Returns:
        "servo 1: fault; advice" for each fault.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: they cannot be read.
    """
    faults = []
    for name, (low, high, why) in _demanded(kind, current_max).items():
        value = link.read(servo, name)
        if not low <= value <= high:
            allowed = f"{low}" if low == high else f"{low} to {high}"
            faults.append(f"servo {servo}: {name.replace('_', ' ')} is {value} and must be {allowed}; {why}")
    shutdown = link.read(servo, "shutdown")
    lacking = [registers.HARDWARE_ERRORS[bit] for bit in _SHUTDOWN_BITS if not shutdown >> bit & 1]
    if lacking:
        faults.append(
            f"servo {servo}: shutdown is {shutdown} and does not name {' and '.join(lacking)}; the servo must switch "
            f"itself off then: set it to {shutdown | sum(1 << bit for bit in _SHUTDOWN_BITS)} with the vendor's wizard"
        )
    return faults


def configure(link: ServoLink, servo: int, drive: Drive) -> list[str]:
    """Switch a servo's torque off and configure it for the cycle; return every setting that failed.

    Each register is verified by reading it back. Written: status return level, torque enable, `motion_registers`, gains
    of the position loop, indirect addresses, bus watchdog. Checked but never written: see `check_registers`. Neither:
    id, baud rate.

    Args:
        link: an open link.
        servo: its id.
        drive: for the type, the gains and the largest current.

    Raises:
        PortGone: the port vanished.
    """
    faults: list[str] = []
    try:
        _enable_replies(link, servo, faults)
        _attempt(lambda: link.write(servo, "bus_watchdog", 0), faults)
        _set(link, servo, "torque_enable", 0, faults)
        faults += check_registers(link, servo, drive.servo, drive.current_max)
        if not faults:
            _prepare(link, servo, drive, faults)
    except errors.PortGone:
        raise
    except errors.DriverError as error:
        faults.append(str(error))
    return faults


def _enable_replies(link: ServoLink, servo: int, faults: list[str]) -> None:
    """Make the servo confirm every write; at another status return level it may answer only pings."""
    try:
        level = link.read(servo, "status_return_level")
    except errors.NoAnswer:
        level = 0
    if level != 2:
        link.write_unanswered(servo, "status_return_level", 2)
        _verify(link, servo, "status_return_level", 2, faults)


def _prepare(link: ServoLink, servo: int, drive: Drive, faults: list[str]) -> None:
    """Write the registers that the cycle needs, the watchdog last, after reading the cycle's block once."""
    for name, value in (motion_registers(drive.servo) | dict(zip(GAINS, drive.gains, strict=True))).items():
        if link.read(servo, name) != value:
            _set(link, servo, name, value, faults)
    _attempt(lambda: _map_blocks(link, servo, faults), faults)
    if faults:
        return
    try:
        registers.decode_block(
            link.read_bytes(servo, registers.READ_ADDRESS, registers.READ_LENGTH, "read the block of the cycle"),
            drive.servo,
        )
    except errors.RangeError as error:
        faults.append(f"servo {servo}: {error}; restart it, and look for another program on its bus")
    else:
        _set(link, servo, "bus_watchdog", registers.WATCHDOG, faults)


def restart_watchdog(link: ServoLink, servo: int) -> None:
    """Clear a tripped watchdog and arm it again.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: it cannot be written.
    """
    link.write(servo, "bus_watchdog", 0)
    link.write(servo, "bus_watchdog", registers.WATCHDOG)


def _set(link: ServoLink, servo: int, name: str, value: int, faults: list[str]) -> None:
    if _attempt(lambda: link.write(servo, name, value), faults):
        _verify(link, servo, name, value, faults)


def _attempt(action: Callable[[], None], faults: list[str]) -> bool:
    """Return whether the servo executed `action`; after a rejection the other registers are still tried."""
    try:
        action()
    except errors.ServoFault as fault:
        faults.append(str(fault))
        return False
    return True


def _verify(link: ServoLink, servo: int, name: str, value: int, faults: list[str]) -> None:
    found = link.read(servo, name)
    if found != value:
        faults.append(f"servo {servo}: {name.replace('_', ' ')} reads {found} after {value} was written")


def _map_blocks(link: ServoLink, servo: int, faults: list[str]) -> None:
    """Map the first indirect registers to the read block and the write block."""
    targets = [
        REGISTERS[name].address + offset
        for name in registers.READ_BLOCK + registers.WRITE_BLOCK
        for offset in range(REGISTERS[name].size)
    ]
    table = struct.pack(f"<{len(targets)}H", *targets)
    link.write_bytes(servo, registers.indirect_address(0), table, "write the indirect addresses")
    if link.read_bytes(servo, registers.indirect_address(0), len(table), "read the indirect addresses") != table:
        faults.append(f"servo {servo}: the indirect addresses do not read as written; update its firmware")


class ServoPhase(enum.Enum):
    """Phase of the servos."""

    DISCONNECTED = "disconnected"
    OFF = "torque off"
    ON = "torque on"
    STOPPING = "stopping"


class ServoReport(NamedTuple):
    """The servos after one cycle, in the order of the ids. Missing values are NaN, never 0.

    Attributes:
        time: arrival of the replies, s, monotonic.
        valid: whether this cycle got a good reply.
        angle: rad; like the next four kept through two missed cycles, then NaN.
        velocity: rad/s.
        current: A, positive is torque toward +angle.
        voltage: V.
        temperature: °C.
        hardware_error: latched error bits; the last known.
        torque_enabled: the last known.
        watchdog_tripped: it received nothing for too long, has stopped and ignores goals.
        rebooted: it answers but has lost its configuration; call `ServoBus.configure`.
        missing: without a good reply for so long that it counts as a fault.
        phase: of the servos; this and the rest by the controller.
        thermal_reserve: s until the winding's limit at the present current; inf = never, NaN = unknown.
        stray: why each joint stopped the arm, as in ServoState; 0 = it did not.
        faults: that forbid moving, one sentence each.
    """

    time: float
    valid: tuple[bool, ...]
    angle: tuple[float, ...]
    velocity: tuple[float, ...]
    current: tuple[float, ...]
    voltage: tuple[float, ...]
    temperature: tuple[float, ...]
    hardware_error: tuple[int, ...]
    torque_enabled: tuple[bool, ...]
    watchdog_tripped: tuple[bool, ...] = ()
    rebooted: tuple[bool, ...] = ()
    missing: tuple[bool, ...] = ()
    phase: ServoPhase = ServoPhase.DISCONNECTED
    thermal_reserve: tuple[float, ...] = ()
    stray: tuple[int, ...] = ()
    faults: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """Whether every servo sent a good reply."""
        return all(self.valid)

    def with_torque(self, ids: Sequence[int], on: bool) -> list[int]:
        """Return the servos of `ids` that reported their torque on, or off."""
        known = zip(ids, self.valid, self.torque_enabled, strict=True)
        return [servo for servo, valid, torque in known if valid and torque == on]


@dataclass
class _Servo:
    """What is known of one servo since it was configured: as in `ServoReport`, and

    Attributes:
        id: of the servo.
        seen: time of its last good reply, s.
        row: its last measurements.
        missed: cycles since the last good reply.
        turns: whole turns beyond the arm's angle that the encoder counts since the servo started.
        is_placed: whether they are known.
    """

    id: int
    seen: float
    row: tuple[float, ...] = UNKNOWN
    missed: int = 0
    hardware_error: int = 0
    has_torque: bool = False
    has_tripped: bool = False
    has_restarted: bool = False
    turns: int = 0
    is_placed: bool = False


class ServoBus:
    """The servos on one port. The thread that opens it owns it until it is closed.

    Args:
        settings: wiring and mounting.
        handler: class of the port.

    Attributes:
        counters: communication errors so far.
        clock: keeps the time.
        drive: the numbers for the servos' type; an MX-64's until `open` has found them.
    """

    def __init__(self, settings: BusSettings, handler: type[ServoPort] = ServoPort) -> None:
        self.settings = settings
        self._link = ServoLink(settings.port, settings.baud_rate, settings.reply_margin, handler)
        self.clock = self._link.clock
        self.counters = self._link.counters
        self.drive = settings.drive(servo_types.MX_64)
        self._type: servo_types.ServoType | None = None  # of the servos found at the first opening
        self._cycle = 0
        self._forget()

    def _forget(self) -> None:
        self._servos = [_Servo(servo, self.clock.now()) for servo in self.settings.ids]

    @property
    def is_open(self) -> bool:
        """Whether the port is open."""
        return self._link.is_open

    def open(self) -> None:
        """Open the port, identify every servo and configure it; torque is off afterwards.

        Raises:
            PortMissing, PortBusy, PortDenied, PortError: the port cannot be opened.
            HandshakeError: servos are missing, wrong, of several types or of another type than before, or reject their
                configuration; lists every fault.
            RangeError: a setting is out of range for their type.
        """
        self._link.open()
        try:
            self.drive = set_up(self._link, self.settings, self._type)
            self._type = self.drive.servo
        except BaseException:
            self._link.close()
            raise
        self._forget()

    def close(self) -> None:
        """Release the port. Sends nothing to the servos: switch torque off first. Never raises; safe to call twice."""
        self._link.close()

    def configure(self, index: int) -> None:
        """Configure servo `index` again, torque off, after a restart.

        Raises:
            HandshakeError: it rejects its configuration.
            PortGone: the port vanished.
        """
        servo = self._servos[index]
        if faults := configure(self._link, servo.id, self.drive):
            raise errors.HandshakeError(self._link.port, faults)
        servo.has_restarted = servo.has_torque = servo.is_placed = False
        servo.missed = min(servo.missed, 1)  # ask it again in the next cycle

    def read(self) -> ServoReport:
        """Return the state of all servos; not valid for a servo without a good reply.

        One sync read while all servos answer. After a failure each servo is read individually, because in a sync read
        the servos behind a missing one stay silent. A servo missing for longer is read only every 25th cycle.

        Raises:
            PortGone: the port vanished.
        """
        return self._read(b"")

    def exchange(self, angles: Sequence[float], currents: Sequence[float]) -> ServoReport:
        """Send goals like `write_goals` and return the state like `read`, in one transmission.

        Raises:
            RangeError, PortGone: as for both.
        """
        return self._read(self._goal_packet(angles, currents))

    def unknown(self) -> ServoReport:
        """Return the state while the port is closed: errors and torque as last known, no measurement."""
        for servo in self._servos:
            servo.row = UNKNOWN
        none = (False,) * len(self._servos)
        return self._report(self.clock.now())._replace(valid=none, rebooted=none, missing=none)

    def _read(self, ahead: bytes) -> ServoReport:
        """Read all servos; the packets `ahead`, which get no reply, are sent with the first request."""
        if not any(servo.missed for servo in self._servos):
            replies = self._link.sync_read(self.settings.ids, registers.READ_ADDRESS, registers.READ_LENGTH, ahead)
        else:
            replies = {}
            if ahead:
                self._link.send(ahead)
            for index, servo in enumerate(self._servos):
                if not self._is_missing(servo) or (self._cycle + index) % _RETRY_EVERY == 0:
                    replies.update(self._link.sync_read((servo.id,), registers.READ_ADDRESS, registers.READ_LENGTH))
        now = self.clock.now()
        self._cycle += 1
        for index, servo in enumerate(self._servos):
            self._learn(index, now, replies.get(servo.id, (0, b""))[1])
            if servo.missed >= UNKNOWN_AFTER or servo.has_restarted:
                servo.row = UNKNOWN
        return self._report(now)

    def write_goals(self, angles: Sequence[float], currents: Sequence[float]) -> None:
        """Send goal angle (rad) and current bound (A, 0 to `current_max`) of each servo; they change together.

        Servos do not confirm it. While torque is off, nothing moves.

        Raises:
            RangeError: a bound above `current_max`, or a value outside a register's range; nothing is sent.
            PortGone: the port vanished.
        """
        self._link.send(self._goal_packet(angles, currents))

    def _goal_packet(self, angles: Sequence[float], currents: Sequence[float]) -> bytes:
        """Return the packet that writes goal and bound of every servo."""
        rows = []
        for index, (servo, angle, current) in enumerate(zip(self.settings.ids, angles, currents, strict=True)):
            rows.append((servo, _WRITE_LAYOUT.pack(self._bound(current), self._ticks(index, angle))))
        return packets.sync_write_packet(registers.WRITE_ADDRESS, registers.WRITE_LENGTH, rows)

    def enable_torque(self, currents: Sequence[float]) -> ServoReport:
        """Switch the torque of all servos on at their present position: goal := present position first.

        Args:
            currents: current bound of each servo, A.

        Returns:
            the report whose angles became the goals.

        Raises:
            NoAnswer: a servo is missing or has just restarted; none is switched on.
            ServoFault: a servo has a latched hardware error, stands outside its joint's range, or rejects it; all are
                switched off again.
            PortGone: the port vanished.
        """
        report = self.read()
        for servo in self._servos:
            if servo.missed:
                raise errors.NoAnswer(
                    f"servo {servo.id}", "read before switching torque on", self.settings.reply_margin
                )
            if bits := servo.hardware_error:
                text = f"{registers.describe_hardware_error(bits)} latched; remove the cause, then reboot it"
                raise errors.ServoFault(servo.id, "switch torque on", text)
            if not servo.is_placed:
                raise errors.ServoFault(servo.id, "switch torque on", self._misplaced(servo.row[0]))
        try:
            for index, servo in enumerate(self._servos):
                restart_watchdog(self._link, servo.id)
                self._verify_goal(index, report.angle[index], currents[index])
            for servo in self._servos:
                self._link.write(servo.id, "torque_enable", 1)
            for servo in self._servos:
                servo.has_torque = True
        except errors.DriverError:
            with contextlib.suppress(errors.DriverError):
                self.disable_torque()
            raise
        return report

    def disable_torque(self) -> None:
        """Switch all servos off: one packet to all, then one to each until it confirms; a servo that missed its last
        reply is tried once.

        Raises:
            PortGone: the port vanished; the servos stop by their watchdog.
        """
        register = REGISTERS["torque_enable"]
        off = [(servo, b"\0") for servo in self.settings.ids]
        self._link.send(packets.sync_write_packet(register.address, register.size, off))
        for servo in self._servos:
            with contextlib.suppress(errors.NoAnswer, errors.CorruptReply, errors.ServoFault):
                self._link.write(servo.id, "torque_enable", 0, hurry=servo.missed > 0)
                servo.has_torque = False

    def reboot(self, index: int) -> None:
        """Restart servo `index`: torque off, latched errors cleared. Afterwards it must be configured again.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: it did not accept the instruction.
        """
        self._link.reboot(self.settings.ids[index])
        self._servos[index].has_torque = False

    def restart_watchdogs(self) -> None:
        """Clear and arm the watchdog of every servo that answers, so that it accepts goals again.

        Raises:
            NoAnswer, CorruptReply, ServoFault, PortGone: a servo does not accept it.
        """
        for servo in self._servos:
            if not servo.missed:
                restart_watchdog(self._link, servo.id)

    def _is_missing(self, servo: _Servo) -> bool:
        return servo.missed >= UNKNOWN_AFTER and self.clock.now() - servo.seen >= MISSING_TIME

    def _bound(self, current: float) -> int:
        """Return a current bound in counts; the check is in counts, so that rounding never refuses the largest."""
        servo, most = self.drive.servo, self.drive.current_max
        counts = registers.current_to_counts(current, servo) if current >= 0.0 else -1
        if not 0 <= counts <= registers.current_to_counts(most, servo):
            raise errors.RangeError("current bound", current, 0.0, most, " A")
        return counts

    def _verify_goal(self, index: int, angle: float, current: float) -> None:
        """Write and verify the goal of one servo, so that it does not jump when switched on."""
        ticks, servo = self._ticks(index, angle), self.settings.ids[index]
        self._link.write(servo, "goal_current", self._bound(current))
        self._link.write(servo, "goal_position", ticks)
        found = self._link.read(servo, "goal_position")
        if found != ticks:
            raise errors.ServoFault(servo, "switch torque on", f"goal position reads {found} after {ticks} was written")

    def _ticks(self, index: int, angle: float) -> int:
        settings = self.settings
        ticks = registers.angle_to_ticks(angle, settings.zero_ticks[index], settings.direction[index])
        return ticks + self._servos[index].turns * machine.TICKS_PER_TURN

    def _place(self, index: int, ticks: int) -> float:
        """Return the arm's angle, rad. A servo that starts forgets whole turns: those are taken out that bring the arm
        into its range, if there is just one such number.
        """
        settings, (low, high), servo = self.settings, self.settings.reach, self._servos[index]

        def angle(turns: int) -> float:
            count = ticks - turns * machine.TICKS_PER_TURN
            return registers.ticks_to_angle(count, settings.zero_ticks[index], settings.direction[index])

        if not servo.is_placed:
            nearest = math.floor((ticks - settings.zero_ticks[index]) / machine.TICKS_PER_TURN)
            within = [turns for turns in (nearest, nearest + 1) if low <= angle(turns) <= high]
            servo.is_placed = len(within) == 1
            servo.turns = min((nearest, nearest + 1), key=lambda turns: abs(angle(turns) - 0.5 * (low + high)))
        return angle(servo.turns)

    def _misplaced(self, angle: float) -> str:
        low, high = (math.degrees(value) for value in (self.settings.joint_min, self.settings.joint_max))
        return (
            f"its arm stands at {math.degrees(angle):.0f}° by zero_ticks and direction, and no whole turn, or several, "
            f"bring it into {low:.0f}…{high:.0f}°: correct them, or the horn on its shaft"
        )

    def _report(self, now: float) -> ServoReport:
        servos = self._servos
        angle, velocity, current, voltage, temperature = zip(*(servo.row for servo in servos), strict=True)
        return ServoReport(
            time=now,
            valid=tuple(not servo.missed for servo in servos),
            angle=angle,
            velocity=velocity,
            current=current,
            voltage=voltage,
            temperature=temperature,
            hardware_error=tuple(servo.hardware_error for servo in servos),
            torque_enabled=tuple(servo.has_torque for servo in servos),
            watchdog_tripped=tuple(servo.has_tripped for servo in servos),
            rebooted=tuple(servo.has_restarted for servo in servos),
            missing=tuple(map(self._is_missing, servos)),
        )

    def _learn(self, index: int, now: float, data: bytes) -> None:
        """Store one servo's reply."""
        known = self._servos[index]
        known.missed += 1
        known.has_tripped = False
        if len(data) != registers.READ_LENGTH:
            return
        if registers.has_restarted(data):
            known.has_restarted, known.has_torque = True, False
            return
        try:
            reading = registers.decode_block(data, self.drive.servo)
        except errors.RangeError:
            self.counters.implausible += 1
            return
        known.missed, known.seen, known.has_restarted = 0, now, False
        known.hardware_error, known.has_torque = reading.hardware_error, reading.torque_enabled
        known.has_tripped = reading.watchdog == registers.WATCHDOG_TRIPPED
        sign, servo = self.settings.direction[index], self.drive.servo
        known.row = (
            self._place(index, reading.ticks),
            sign * reading.velocity * servo.velocity_unit,
            sign * reading.current * servo.current_unit,
            reading.voltage * servo.voltage_unit,
            float(reading.temperature),
        )
