# SPDX-License-Identifier: Apache-2.0
"""The board link's packets as values (docs/board-link.md): constants, payloads, samples, errors.

Pure functions, without port, clock or state of the board. Their frame is in packets.py.
"""

import enum
import math
import struct
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, FRAME_RATE, ROWS, ZERO_CURRENT, ChargeLimits, Port, port_of
from deltacharger_driver.errors import DriverError
from deltacharger_driver.packets import VERSION, Packet

MINOR = 2
"""Minor version from which a close carries limits; older boards are refused."""
SERVO_MINOR = 3
"""Minor version of a board that passes the bytes of the servos' bus; other boards report MINOR."""
TAXELS = ROWS * COLUMNS
FULL_SCALE = 10.0  # N, the code one below the top
DEFAULT_RATE = FRAME_RATE  # Hz, after every boot
POWER_RATE = 20.0  # Hz
HEARTBEAT_PERIOD = 0.020  # s
HEARTBEAT_TIMEOUT = 0.100  # s without one opens the contactor
PROBE_TIMEOUT = 0.250  # s; longest time until a probe is answered
DEAD_VOLTAGE = 5.0  # V, below it the electrodes are dead
OPEN, CLOSE, CLEAR_WELD, LIMIT = 0, 1, 2, 3  # the first byte of CONTACTOR
LONGEST_PING = 64  # bytes
LONGEST_SERVO = 128  # bytes of the servos' bus in one packet
FLAG_TARED = 1
FLAG_OVERRUN = 2
U12 = 2
"""The header's sample format of TACTILE: two samples of 12 bit in three bytes."""
_ALL_FLAGS = FLAG_TARED | FLAG_OVERRUN

_POWER = struct.Struct("<fffBBHf")
_HELLO = struct.Struct("<BBBBIfBBHf")
_CLOSE = struct.Struct("<BBHffff")
_LIMIT = struct.Struct("<Bf")
_ACK = struct.Struct("<BBH")
_PROBE = struct.Struct("<ff")
_RATE = struct.Struct("<f")
_SPEED = struct.Struct("<I")

LIMITS = {"current": (0.05, 30.0), "voltage": (1.0, 60.0), "start_time": (0.1, 70.0), "gap_time": (0.05, 130.0)}
"""Bounds of a closing's limits: A, V, s, s."""
_WORD_SHIFTS = np.array((0, 12), np.uint32)  # two codes of 12 bit in every three bytes

Taxels = npt.NDArray[np.float32]

_PORT_PROBLEMS = {
    Port.UNKNOWN: "the probe measured nothing; check its wiring",
    Port.OPEN: "no current flows into the port: the target is off or asleep, a diode is in its port, or the electrodes "
    "do not touch or are dirty",
    Port.DEAD: "the port has no voltage: the target is off or asleep",
    Port.SHORT: "short circuit between the electrodes; dock again",
    Port.REVERSED: "reversed polarity: swap the target's terminals",
}


class PacketType(enum.IntEnum):
    """Type of a packet."""

    TACTILE = 1
    POWER = 2
    HELLO = 3
    START = 4
    STOP = 5
    TARE = 6
    RATE = 7
    CONTACTOR = 8
    PING = 9
    ACK = 10
    PROBE = 11
    HEARTBEAT = 12
    SERVO = 13
    SERVO_SPEED = 14


class AckError(enum.IntEnum):
    """The board's answer to a command."""

    DONE = 0
    BAD_PAYLOAD = 1
    UNKNOWN = 2
    INTERLOCK = 3
    NOT_NOW = 4


class BoardFault(enum.IntEnum):
    """Why the board opened the contactor on its own; latched until the next opening command, a weld until cleared."""

    NONE = 0
    NO_CHARGE_CURRENT = 1
    SHORT_CIRCUIT = 2
    STALE = 3
    REVERSE_POLARITY = 4
    VOLTAGE_OUT_OF_RANGE = 5
    REVERSE_CURRENT = 6
    CONTACTOR_WELDED = 7
    HEARTBEAT_LOST = 8
    OVER_CURRENT = 9


class PacketError(DriverError, ValueError):
    """A packet's payload or header is invalid for its type. Example: a TACTILE packet of 12 bytes.

    Args:
        type: number of the packet's type.
        reason: what is wrong.
    """

    def __init__(self, type: int, reason: str) -> None:
        super().__init__(f"{type_name(type)} packet: {reason}; check that both sides use version {VERSION}")


def type_name(type: int) -> str:
    """Return the name of a packet type; works for unknown numbers too."""
    return next((each.name for each in PacketType if each == type), f"type {type}")


def fault_name(fault: int) -> str:
    """Return a fault in words; works for unknown numbers too."""
    name = next((each.name for each in BoardFault if each == fault), f"fault {fault}")
    return name.lower().replace("_", " ")


def clearing(fault: int) -> str:
    """Return how a person clears a latched fault."""
    if fault == BoardFault.CONTACTOR_WELDED:
        return (
            "switch the battery off, replace the contactor, then call set_contactor with clear_weld true, or "
            "'deltacharger doctor --clear-weld'"
        )
    return "remove the cause, then open the contactor to clear it (set_contactor with close false)"


def check_header(packet: Packet) -> None:
    """Check sample format and flags of a packet; only TACTILE has them.

    Raises:
        PacketError: a value that version 1 does not define for this type.
    """
    tactile = packet.type == PacketType.TACTILE
    if packet.format != (U12 if tactile else 0):
        raise PacketError(packet.type, f"sample format {packet.format} is invalid for this type")
    if packet.flags & ~(_ALL_FLAGS if tactile else 0):
        raise PacketError(packet.type, f"flags {packet.flags:#04x} are invalid for this type")


_EXPLANATIONS: dict[int, str] = {
    AckError.BAD_PAYLOAD: "invalid value",
    AckError.UNKNOWN: "unknown command; update the board's firmware",
    AckError.INTERLOCK: (
        "interlock: a close needs a live heartbeat, no latched fault, a probe younger than 2 s that found a port as "
        "the limits expect it, and a stage whose voltage they allow; open, then probe, then close"
    ),
    AckError.NOT_NOW: "not possible now",
}


class CommandRefused(DriverError, RuntimeError):
    """The board answered a command with an error. Example: a tare while something touches the pads.

    Args:
        type: number of the command's packet type.
        error: number of the error, see `AckError`.
        advice: explanation for this command; replaces the default one.
        attempts: how often the command was sent; an earlier attempt may have been executed.
    """

    def __init__(self, type: int, error: int, advice: str = "", attempts: int = 1) -> None:
        self.error = error
        self.attempts = attempts
        reason = _EXPLANATIONS.get(error, f"error {error}")
        super().__init__(f"the board refused {type_name(type)}: {advice or reason}")


class BoardRebooted(DriverError, ConnectionResetError):
    """The board rebooted while a command was pending; the command is lost. Example: its supply dipped.

    Args:
        action: the command.
    """

    def __init__(self, action: str) -> None:
        super().__init__(
            f"the board rebooted during {action}; tare and probe are lost, the contactor is open; repeat the command"
        )


class BoardMismatch(DriverError, ConnectionError):
    """This driver cannot use the board. Example: firmware of another protocol version.

    Args:
        port: path of the port.
        reason: what differs.
        advice: what to do; '' = flash it.
    """

    def __init__(self, port: str, reason: str, advice: str = "") -> None:
        needs = f"this driver needs version {VERSION}.{MINOR} or later and 10 x 10 taxels: flash the current firmware"
        super().__init__(f"{port}: {reason}; {advice or needs}")


_LAST_FAULT = max(BoardFault)
_TOP = 0xFFF  # the highest code, which means a dead taxel; one below it is full scale
_SAMPLE_BYTES = 300
_FORCES: Taxels = np.arange(_TOP + 1, dtype=np.float32) * np.float32(FULL_SCALE / (_TOP - 1))
_FORCES[_TOP] = np.nan


class Power(NamedTuple):
    """Payload of a POWER packet: V, V, A (NaN = not measured), contactor, fault, and A.

    The currents are the mean and the least since the last packet.
    """

    battery_voltage: float
    target_voltage: float
    charge_current: float
    contactor_closed: bool
    fault: int
    least_current: float = math.nan


class Hello(NamedTuple):
    """Payload of the board's HELLO packet; `rate` in Hz.

    The stage charges above its battery's voltage if it `steps_up`; `stage_voltage` (V) is its constant voltage, NaN =
    the board sets it.
    """

    major: int
    minor: int
    rows: int
    columns: int
    boot_id: int
    rate: float
    steps_up: bool = True
    stage_voltage: float = math.nan

    @property
    def carries_servos(self) -> bool:
        """Whether the servos' bus is connected to the board, which then passes its bytes."""
        return self.minor % 2 == SERVO_MINOR % 2


class Ack(NamedTuple):
    """Payload of an ACK packet: type and sequence of the command, error and data."""

    type: int
    error: int
    sequence: int
    data: bytes = b""


def encode_samples(left: npt.ArrayLike, right: npt.ArrayLike) -> bytes:
    """Write both pads' forces as the payload of a TACTILE packet.

    Args:
        left: (10, 10) or (100,) N, row-major from the top row; NaN = dead. Clipped to 0…10 N.
        right: like `left`, for the other pad.

    Returns:
        300 bytes.
    """
    forces = np.concatenate((np.ravel(left), np.ravel(right)))
    if forces.size != 2 * TAXELS:
        raise ValueError(f"{forces.size} forces; both pads together have {2 * TAXELS}")
    with np.errstate(invalid="ignore"):
        scaled = np.rint(np.clip(forces, 0.0, FULL_SCALE) * ((_TOP - 1) / FULL_SCALE))
    codes = np.where(np.isnan(scaled), _TOP, scaled).astype(np.uint16)
    first, second = codes[0::2], codes[1::2]
    packed = np.empty((TAXELS, 3), np.uint8)
    packed[:, 0] = first & 255
    packed[:, 1] = first >> 8 | (second & 15) << 4
    packed[:, 2] = second >> 4
    return packed.tobytes()


def decode_samples(payload: bytes) -> Taxels:
    """Read the payload of a TACTILE packet.

    Returns:
        (2, 10, 10) N: left and right, row-major from the top row, NaN = dead.

    Raises:
        PacketError: wrong length.
    """
    if len(payload) != _SAMPLE_BYTES:
        raise PacketError(PacketType.TACTILE, f"{len(payload)} bytes of samples instead of {_SAMPLE_BYTES}")
    words: npt.NDArray[np.uint32] = np.ndarray((TAXELS, 1), "<u4", payload + b"\0", strides=(3, 1))
    return _FORCES.take(words >> _WORD_SHIFTS & 0xFFF).reshape(2, ROWS, COLUMNS)


def encode_power(power: Power) -> bytes:
    """Return the payload of a POWER packet."""
    return _POWER.pack(*power[:5], 0, power.least_current)


def decode_power(payload: bytes) -> Power:
    """Read the payload of a POWER packet.

    Raises:
        PacketError: wrong length, an infinite reading (a missing one is NaN), a contactor that is neither 0 nor 1, a
            fault that is not in the table, reserved bytes that are not 0.
    """
    battery, target, current, closed, fault, reserved, least = _unpack(_POWER, payload, PacketType.POWER)
    for name, value in (("battery_V", battery), ("target_V", target), ("charge_A", current), ("least_A", least)):
        _refuse_infinite(PacketType.POWER, name, value)
    if closed > 1:
        raise PacketError(PacketType.POWER, f"contactor is {closed} instead of 0 or 1")
    if fault > _LAST_FAULT:
        raise PacketError(PacketType.POWER, f"fault {fault} is unknown; the last is {_LAST_FAULT}")
    if reserved:
        raise PacketError(PacketType.POWER, f"its reserved bytes are {reserved} instead of 0")
    return Power(battery, target, current, closed == 1, fault, least)


def encode_hello(hello: Hello) -> bytes:
    """Return the payload of the board's HELLO packet."""
    return _HELLO.pack(*hello[:7], 0, 0, hello.stage_voltage)


def decode_hello(payload: bytes) -> Hello:
    """Read the payload of the board's HELLO packet. The caller checks version and array sizes.

    Raises:
        PacketError: wrong length, a rate that is negative or not finite, a stage that is not declared.
    """
    *known, up, zero, reserved, voltage = _unpack(_HELLO, payload, PacketType.HELLO)
    hello = Hello._make((*known, up == 1, voltage))
    if up > 1 or zero or reserved or voltage <= 0.0 or math.isinf(voltage):
        raise PacketError(PacketType.HELLO, "its power stage is not declared as docs/board-link.md says")
    _check_rate(PacketType.HELLO, hello.rate)
    return hello


def encode_close(limits: ChargeLimits) -> bytes:
    """Return the payload of a CONTACTOR packet that closes within these limits."""
    return _CLOSE.pack(CLOSE, limits.dead, 0, limits.current, limits.voltage, limits.start_time, limits.gap_time)


def decode_close(payload: bytes) -> ChargeLimits:
    """Read the payload of a CONTACTOR packet that closes.

    Raises:
        PacketError: wrong length, or a limit outside `LIMITS`.
    """
    kind, dead, reserved, *numbers = _unpack(_CLOSE, payload, PacketType.CONTACTOR)
    if kind != CLOSE or dead > 1 or reserved:
        raise PacketError(PacketType.CONTACTOR, f"its first bytes are {payload[:4].hex()}")
    current, voltage, start, gap = numbers
    limits = ChargeLimits(current, voltage, dead == 1, start, gap)
    if problem := limits_problem(limits):
        raise PacketError(PacketType.CONTACTOR, problem)
    return limits


def limits_problem(limits: ChargeLimits) -> str:
    """Return which limit is outside `LIMITS`; '' = none."""
    for name, (low, high) in LIMITS.items():
        value = getattr(limits, name)
        if not low <= value <= high:  # also NaN
            return f"{name} is {value:g}: give {low:g} to {high:g}"
    return ""


def encode_limit(current: float) -> bytes:
    """Return the payload of a CONTACTOR packet that changes the largest current (A) of a closed contactor."""
    return _LIMIT.pack(LIMIT, current)


def decode_limit(payload: bytes) -> float:
    """Read the payload of a CONTACTOR packet that changes the largest current, A.

    Raises:
        PacketError: wrong length, or a current outside `LIMITS`.
    """
    _, current = _unpack(_LIMIT, payload, PacketType.CONTACTOR)
    low, high = LIMITS["current"]
    if not low <= current <= high:
        raise PacketError(PacketType.CONTACTOR, f"{current:g} A is outside {low:g} to {high:g} A")
    return float(current)


def encode_ack(ack: Ack) -> bytes:
    """Return the payload of an ACK packet."""
    return _ACK.pack(ack.type, ack.error, ack.sequence) + ack.data


def decode_ack(payload: bytes) -> Ack:
    """Read the payload of an ACK packet. Unknown error numbers are kept.

    Raises:
        PacketError: too short.
    """
    kind, error, sequence = _unpack(_ACK, payload[: _ACK.size], PacketType.ACK)
    return Ack(kind, error, sequence, payload[_ACK.size :])


def encode_probe(resistance: float, target_voltage: float) -> bytes:
    """Return the data of the ACK of a PROBE: ohm (inf = open circuit) and V."""
    return _PROBE.pack(resistance, target_voltage)


def decode_probe(data: bytes) -> tuple[float, float]:
    """Read the data of the ACK of a PROBE: ohm (inf = open circuit) and V; NaN = not measured.

    Raises:
        PacketError: wrong length, a resistance of -inf, an infinite voltage.
    """
    resistance, voltage = _unpack(_PROBE, data, PacketType.PROBE)
    if resistance != math.inf:
        _refuse_infinite(PacketType.PROBE, "ohm", resistance)
    _refuse_infinite(PacketType.PROBE, "target_V", voltage)
    return resistance, voltage


def decode_ping(payload: bytes) -> bytes:
    """Read the payload of a PING packet, which may be any bytes.

    Raises:
        PacketError: more than 64 bytes.
    """
    if len(payload) > LONGEST_PING:
        raise PacketError(PacketType.PING, f"{len(payload)} bytes; it carries at most {LONGEST_PING}")
    return payload


def decode_servo(payload: bytes) -> bytes:
    """Read the payload of a SERVO packet: bytes of the servos' bus.

    Raises:
        PacketError: no bytes, or more than 128.
    """
    if not 1 <= len(payload) <= LONGEST_SERVO:
        raise PacketError(PacketType.SERVO, f"{len(payload)} bytes; it carries 1 to {LONGEST_SERVO}")
    return payload


def encode_servo_speed(speed: int) -> bytes:
    """Return the payload of a SERVO_SPEED packet: bit/s."""
    return _SPEED.pack(speed)


def decode_servo_speed(payload: bytes) -> int:
    """Read the payload of a SERVO_SPEED packet: bit/s; the board checks whether it supports this speed.

    Raises:
        PacketError: wrong length.
    """
    (speed,) = _unpack(_SPEED, payload, PacketType.SERVO_SPEED)
    return int(speed)


def encode_rate(rate: float) -> bytes:
    """Return the payload of a RATE packet: Hz."""
    return _RATE.pack(rate)


def decode_rate(payload: bytes) -> float:
    """Read the payload of a RATE packet: Hz; the board checks whether it supports this rate.

    Raises:
        PacketError: wrong length, or a rate that is negative or not finite.
    """
    (rate,) = _unpack(_RATE, payload, PacketType.RATE)
    _check_rate(PacketType.RATE, rate)
    return float(rate)


def _refuse_infinite(type: PacketType, name: str, value: float) -> None:
    if math.isinf(value):
        raise PacketError(type, f"{name} is {value}; a missing value must be NaN")


def _check_rate(type: PacketType, rate: float) -> None:
    if not 0.0 <= rate < math.inf:  # also refuses NaN
        raise PacketError(type, f"rate {rate} Hz is negative or not finite")


def _unpack(layout: struct.Struct, data: bytes, type: PacketType) -> tuple[Any, ...]:
    if len(data) != layout.size:
        raise PacketError(type, f"{len(data)} bytes instead of {layout.size}")
    return layout.unpack(data)


def weld_problem(power: Power) -> str:
    """Return what is still live, so that a latched weld must not be cleared; '' if nothing is."""
    live = []
    if power.contactor_closed:
        live.append("the contactor reports closed")
    if not abs(power.charge_current) < ZERO_CURRENT:
        live.append(f"the current is {power.charge_current:.2f} A")
    if abs(power.target_voltage) >= DEAD_VOLTAGE:
        live.append(f"the electrodes carry {power.target_voltage:.1f} V")
    return ", ".join(live)


def probe_problem(resistance: float, target_voltage: float, dead: bool = False) -> str:
    """Return why a probe's result forbids closing the contactor; '' if it allows it.

    Args:
        resistance: ohm at the end of the driven look, NaN = a live port.
        target_voltage: V, negative = reversed.
        dead: whether the port may have no voltage of its own.
    """
    port = port_of(resistance, target_voltage)
    if port is Port.LIVE or (dead and port in (Port.OPEN, Port.DEAD)):
        return ""
    return f"{_PORT_PROBLEMS[port]} ({resistance:.3g} ohm, {target_voltage:.2f} V)"


class TactileSample(NamedTuple):
    """One sampling of both pads.

    Attributes:
        time: sampling instant, s on the host's monotonic clock.
        sequence: unwrapped, rising across a reboot; gaps are lost frames.
        device_time_us: us on the board's clock at the sampling instant.
        pads: (2, 10, 10) N, float32: left (the pad at +x) and right; row 0 at +y, column 0 at +x of end_effector;
            NaN = dead.
        tared: the board subtracts a tare.
        overrun: the board lost samplings before this one.
    """

    time: float
    sequence: int
    device_time_us: int
    pads: Taxels
    tared: bool
    overrun: bool


@dataclass(frozen=True)
class PowerSample:
    """The power stage at `time`, s on the host's monotonic clock."""

    time: float
    power: Power


@dataclass(frozen=True)
class ProbeResult:
    """A probe: ohm and V as `port_of` takes them, and its time (s, monotonic)."""

    resistance: float
    target_voltage: float
    time: float


@dataclass
class BoardLinkCounters:
    """Counts of the link; they only rise."""

    tactile: int = 0
    power: int = 0
    lost_tactile: int = 0
    lost_power: int = 0
    duplicates: int = 0
    unknown_types: int = 0
    bad_payloads: int = 0
    reboots: int = 0
    retries: int = 0
    unanswered: int = 0
    heartbeats: int = 0
    callback_errors: int = 0
