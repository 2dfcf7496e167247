# SPDX-License-Identifier: Apache-2.0
"""Payloads of the board link's packets, as values and as bytes (docs/board-link.md). Pure functions."""

from __future__ import annotations

import math
import struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.protocol import (
    DEAD_VOLTAGE,
    FULL_SCALE,
    LONGEST_PING,
    LONGEST_SERVO,
    SERVO_MINOR,
    SHORT_RESISTANCE,
    TAXELS,
    ZERO_CURRENT,
    BoardFault,
    PacketError,
    PacketType,
    SampleFormat,
)

_POWER = struct.Struct("<fffBBH")
_HELLO = struct.Struct("<BBBBIf")
_ACK = struct.Struct("<BBH")
_PROBE = struct.Struct("<ff")
_RATE = struct.Struct("<f")
_SPEED = struct.Struct("<I")
_LAST_FAULT = max(BoardFault)
_WORD_SHIFTS = np.array((0, 12), np.uint32)  # two codes of 12 bit in every three bytes
_SAMPLE_BYTES: dict[int, int] = {SampleFormat.U8: 200, SampleFormat.U12: 300, SampleFormat.U16: 400}

Taxels = npt.NDArray[np.float32]


def _forces(sample_format: SampleFormat) -> Taxels:
    """Return the force, N, of every code of a format; NaN for the highest, a dead taxel."""
    top = sample_format.top
    forces = np.arange(top + 1, dtype=np.float32) * np.float32(FULL_SCALE / (top - 1))
    forces[top] = np.nan
    return forces


_FORCES: dict[int, Taxels] = {
    sample_format: _forces(sample_format) for sample_format in (SampleFormat.U8, SampleFormat.U12, SampleFormat.U16)
}


class Power(NamedTuple):
    """Payload of a POWER packet: V, V, A (NaN = not measured), contactor and fault."""

    battery_voltage: float
    target_voltage: float
    charge_current: float
    contactor_closed: bool
    fault: int


class Hello(NamedTuple):
    """Payload of the board's HELLO packet; `rate` in Hz."""

    major: int
    minor: int
    rows: int
    columns: int
    boot_id: int
    rate: float

    @property
    def carries_servos(self) -> bool:
        """Whether the servos' bus is connected to the board, which then passes its bytes."""
        return self.minor >= SERVO_MINOR


class Ack(NamedTuple):
    """Payload of an ACK packet: type and sequence of the command, error and data."""

    type: int
    error: int
    sequence: int
    data: bytes = b""


def encode_samples(left: npt.ArrayLike, right: npt.ArrayLike, sample_format: SampleFormat) -> bytes:
    """Write both pads' forces as the payload of a TACTILE packet.

    Args:
        left: (10, 10) or (100,) N, row-major from the top row; NaN = dead. Clipped to 0…10 N.
        right: like `left`, for the other pad.
        sample_format: U8, U12 or U16.

    Returns:
        200, 300 or 400 bytes.
    """
    forces = np.concatenate((np.ravel(left), np.ravel(right)))
    if forces.size != 2 * TAXELS:
        raise ValueError(f"{forces.size} forces; both pads together have {2 * TAXELS}")
    top = sample_format.top
    with np.errstate(invalid="ignore"):
        scaled = np.rint(np.clip(forces, 0.0, FULL_SCALE) * ((top - 1) / FULL_SCALE))
    codes = np.where(np.isnan(scaled), top, scaled).astype(np.uint16)
    if sample_format is SampleFormat.U8:
        return codes.astype(np.uint8).tobytes()
    if sample_format is SampleFormat.U16:
        return codes.astype("<u2").tobytes()
    first, second = codes[0::2], codes[1::2]
    packed = np.empty((TAXELS, 3), np.uint8)
    packed[:, 0] = first & 255
    packed[:, 1] = first >> 8 | (second & 15) << 4
    packed[:, 2] = second >> 4
    return packed.tobytes()


def decode_samples(payload: bytes, sample_format: int) -> Taxels:
    """Read the payload of a TACTILE packet.

    Returns:
        (2, 10, 10) N: left and right, row-major from the top row, NaN = dead.

    Raises:
        PacketError: unknown format, or wrong length for the format.
    """
    expected = _SAMPLE_BYTES.get(sample_format, 0)
    if not expected:
        raise PacketError(PacketType.TACTILE, f"sample format {sample_format} is unknown")
    if len(payload) != expected:
        raise PacketError(PacketType.TACTILE, f"{len(payload)} bytes of samples instead of {expected}")
    codes: npt.NDArray[Any]
    if sample_format == SampleFormat.U12:
        words: npt.NDArray[np.uint32] = np.ndarray((TAXELS, 1), "<u4", payload + b"\0", strides=(3, 1))
        codes = words >> _WORD_SHIFTS & 0xFFF
    else:
        codes = np.frombuffer(payload, np.uint8 if sample_format == SampleFormat.U8 else "<u2")
    return _FORCES[sample_format].take(codes).reshape(2, ROWS, COLUMNS)


def encode_power(power: Power) -> bytes:
    """Return the payload of a POWER packet."""
    return _POWER.pack(*power, 0)


def decode_power(payload: bytes) -> Power:
    """Read the payload of a POWER packet.

    Raises:
        PacketError: wrong length, an infinite reading (a missing one is NaN), a contactor that is neither 0 nor 1, a
            fault that is not in the table, reserved bytes that are not 0.
    """
    battery, target, current, closed, fault, reserved = _unpack(_POWER, payload, PacketType.POWER)
    for name, value in (("battery_V", battery), ("target_V", target), ("charge_A", current)):
        _refuse_infinite(PacketType.POWER, name, value)
    if closed > 1:
        raise PacketError(PacketType.POWER, f"contactor is {closed} instead of 0 or 1")
    if fault > _LAST_FAULT:
        raise PacketError(PacketType.POWER, f"fault {fault} is unknown; the last is {_LAST_FAULT}")
    if reserved:
        raise PacketError(PacketType.POWER, f"its last two bytes are {reserved} instead of 0")
    return Power(battery, target, current, closed == 1, fault)


def encode_hello(hello: Hello) -> bytes:
    """Return the payload of the board's HELLO packet."""
    return _HELLO.pack(*hello)


def decode_hello(payload: bytes) -> Hello:
    """Read the payload of the board's HELLO packet. The caller checks version and array sizes.

    Raises:
        PacketError: wrong length, or a rate that is negative or not finite.
    """
    hello = Hello(*_unpack(_HELLO, payload, PacketType.HELLO))
    _check_rate(PacketType.HELLO, hello.rate)
    return hello


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


def probe_problem(resistance: float, target_voltage: float) -> str:
    """Return why a probe's result forbids closing the contactor; '' if it allows it.

    Args:
        resistance: ohm between the electrodes, inf = open circuit.
        target_voltage: V, negative = reversed.
    """
    if math.isinf(resistance):
        return "open circuit: the electrodes do not touch the target; dock again"
    if math.isnan(resistance) or math.isnan(target_voltage):
        return "the probe measured nothing; check its wiring"
    if target_voltage < 0.0:
        return f"reversed polarity: the target has {target_voltage:.2f} V; swap its terminals"
    if resistance < SHORT_RESISTANCE:
        return f"short circuit: {resistance:.3g} ohm between the electrodes; dock again"
    return ""
