"""From servos on a wire to servos ready for the cycle: who is there, and every register that matters read back."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from deltacharger_driver.errors import CorruptReply, DriverError, HandshakeError, NoAnswer, PortGone
from deltacharger_driver.mx64 import (
    MODE_CURRENT_POSITION,
    MODEL,
    MODEL_PROTOCOL_1,
    REGISTERS,
    WATCHDOG_TRIPPED,
    indirect_address,
    indirect_data,
)
from deltacharger_driver.servo_link import ServoLink

WATCHDOG = 6
"""Bus watchdog, units of 20 ms: a servo that hears nothing for 120 ms stops by itself."""

READ_BLOCK = (
    "torque_enable",
    "hardware_error",
    "present_current",
    "present_velocity",
    "present_position",
    "input_voltage",
    "temperature",
)
"""What one cycle reads, made contiguous by indirect addresses: 64, 70, 126, 128, 132, 144, 146."""
WRITE_BLOCK = ("goal_current", "goal_position")
"""What one cycle writes, behind the read block, so that bound and goal always change together."""

READ_LENGTH = sum(REGISTERS[name].size for name in READ_BLOCK)
WRITE_LENGTH = sum(REGISTERS[name].size for name in WRITE_BLOCK)
READ_ADDRESS = indirect_data(0)
WRITE_ADDRESS = indirect_data(READ_LENGTH)

_UPDATE_ADVICE = "update its firmware to 39 or later (Protocol 2.0) with the vendor's wizard"
_SCANNED_SPEEDS = (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000, 9600)
_PREPARED = {"return_delay": 0, "operating_mode": MODE_CURRENT_POSITION}
"""EEPROM: written only where it differs, for it wears."""
_REQUIRED = {
    "drive_mode": "the sign belongs in the parameter 'direction'",
    "homing_offset": "the zero belongs in the parameter 'zero_ticks'",
}
"""EEPROM registers that must be 0 and are never written: somebody set them on purpose."""


def identify(link: ServoLink, servos: Sequence[int], scan: bool = True) -> None:
    """Check that every servo of `servos` answers and is an MX-64 with Protocol 2.0.

    Args:
        link: an open link.
        servos: ids.
        scan: look for those that do not answer at the other speeds, and for old firmware, to name where they are; about
            a second per servo.

    Raises:
        HandshakeError: with everything that is wrong, one sentence each.
        PortGone: the port vanished.
    """
    faults = []
    for servo in servos:
        fault = _identify_one(link, servo)
        if fault is None:
            fault = _locate(link, servo) if scan else f"servo {servo} does not answer"
        if fault:
            faults.append(fault)
    if faults:
        raise HandshakeError(link.port, faults)


def _identify_one(link: ServoLink, servo: int) -> str | None:
    """Return what is wrong with a servo at the link's speed: "" for nothing, None where nobody answers."""
    try:
        model = link.ping(servo, attempts=2)
    except NoAnswer:
        return None
    except CorruptReply:
        return f"servo {servo} answers unintelligibly; two servos with this id, noise, or a bad plug"
    if model == MODEL:
        return ""
    if model == MODEL_PROTOCOL_1:
        return f"servo {servo} is an MX-64 with Protocol 1.0 firmware; {_UPDATE_ADVICE}"
    return f"servo {servo} is model {model}, not an MX-64 with Protocol 2.0 ({MODEL})"


def _locate(link: ServoLink, servo: int) -> str:
    """Say where a servo that does not answer at the link's speed is."""
    try:
        if link.ping_protocol_1(servo):
            return f"servo {servo} speaks Protocol 1.0; {_UPDATE_ADVICE}"
        for speed in _SCANNED_SPEEDS:
            if speed == link.baud_rate:
                continue
            link.set_speed(speed)
            found = f"servo {servo} answers at {speed} bit/s, not at {link.baud_rate}"
            try:
                link.ping(servo)
            except (NoAnswer, CorruptReply):
                if link.ping_protocol_1(servo):
                    return f"{found}, and speaks Protocol 1.0; {_UPDATE_ADVICE}"
                continue
            return f"{found}; set its speed with 'deltacharger doctor --set-baud' or correct 'baud_rate'"
    finally:
        link.set_speed(link.baud_rate)
    return f"servo {servo} does not answer at any speed; check its supply, its cable and its id"


def configure(link: ServoLink, servo: int, watchdog: int = WATCHDOG) -> None:
    """Switch a servo's torque off and set it up for the cycle, verifying each register by reading it back.

    Written: status return level, torque enable, return delay, operating mode, indirect addresses, profile, bus
    watchdog. Never written: id, baud rate, homing offset, drive mode.

    Args:
        link: an open link.
        servo: its id.
        watchdog: silence, in units of 20 ms, after which it stops; 1–6.

    Raises:
        HandshakeError: with everything that did not come out as it should.
        PortGone: the port vanished.
    """
    faults: list[str] = []
    try:
        if link.read(servo, "status_return_level") != 2:
            link.write_unanswered(servo, "status_return_level", 2)
            _verify(link, servo, "status_return_level", 2, faults)
        link.write(servo, "bus_watchdog", 0)
        _set(link, servo, "torque_enable", 0, faults)
        for name, advice in _REQUIRED.items():
            value = link.read(servo, name)
            if value:
                faults.append(f"servo {servo}: {name.replace('_', ' ')} is {value} and must be 0; {advice}")
        for name, value in _PREPARED.items():
            if link.read(servo, name) != value:
                _set(link, servo, name, value, faults)
        _set(link, servo, "profile_acceleration", 0, faults)
        _set(link, servo, "profile_velocity", 0, faults)
        _map_blocks(link, servo, faults)
        if not faults:
            _set(link, servo, "bus_watchdog", watchdog, faults)
    except PortGone:
        raise
    except DriverError as error:
        faults.append(str(error))
    if faults:
        raise HandshakeError(link.port, faults)


def watchdog_tripped(link: ServoLink, servo: int) -> bool:
    """Return whether the servo heard nothing for too long and has locked its goals; asked in a hurry.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: it cannot be read.
    """
    return link.read(servo, "bus_watchdog", hurry=True) == WATCHDOG_TRIPPED


def restart_watchdog(link: ServoLink, servo: int, watchdog: int = WATCHDOG) -> None:
    """Clear a tripped watchdog and arm it again.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: it cannot be written.
    """
    link.write(servo, "bus_watchdog", 0)
    link.write(servo, "bus_watchdog", watchdog)


def _set(link: ServoLink, servo: int, name: str, value: int, faults: list[str]) -> None:
    link.write(servo, name, value)
    _verify(link, servo, name, value, faults)


def _verify(link: ServoLink, servo: int, name: str, value: int, faults: list[str]) -> None:
    found = link.read(servo, name)
    if found != value:
        faults.append(f"servo {servo}: {name.replace('_', ' ')} reads {found} after {value} was written")


def _map_blocks(link: ServoLink, servo: int, faults: list[str]) -> None:
    """Point the first indirect registers to the read block and the write block."""
    targets = [
        REGISTERS[name].address + offset for name in READ_BLOCK + WRITE_BLOCK for offset in range(REGISTERS[name].size)
    ]
    table = struct.pack(f"<{len(targets)}H", *targets)
    link.write_bytes(servo, indirect_address(0), table, "write the indirect addresses")
    if link.read_bytes(servo, indirect_address(0), len(table), "read the indirect addresses") != table:
        faults.append(f"servo {servo}: the indirect addresses do not read as written; update its firmware")
