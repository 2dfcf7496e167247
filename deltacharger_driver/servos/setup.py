# SPDX-License-Identifier: Apache-2.0
"""Prepares servos for the cycle: identifies them, and writes and verifies every register that matters."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence

from deltacharger_driver.errors import (
    CorruptReply,
    DriverError,
    HandshakeError,
    NoAnswer,
    PortGone,
    RangeError,
    ServoFault,
)
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.mx64 import (
    HARDWARE_ERRORS,
    MODE_CURRENT_POSITION,
    MODEL,
    MODEL_PROTOCOL_1,
    REGISTERS,
    current_to_counts,
    indirect_address,
)
from deltacharger_driver.servos.snapshot import (
    GAINS,
    READ_ADDRESS,
    READ_BLOCK,
    READ_LENGTH,
    WATCHDOG,
    WRITE_BLOCK,
    BusSettings,
    decode_block,
)

_UPDATE_ADVICE = "update its firmware to 39 or later (Protocol 2.0) with the vendor's wizard"
_SCANNED_SPEEDS = (57600, 1_000_000, 115200, 2_000_000, 3_000_000, 4_000_000, 9600)
MOTION = {
    "return_delay": 0,
    "operating_mode": MODE_CURRENT_POSITION,
    "acceleration_limit": REGISTERS["acceleration_limit"].high,
    "velocity_limit": REGISTERS["velocity_limit"].high,
    **{name: REGISTERS[name].default for name in ("velocity_i_gain", "velocity_p_gain")},
    **dict.fromkeys(("feedforward_2_gain", "feedforward_1_gain"), 0),
    "goal_pwm": REGISTERS["goal_pwm"].high,
    **dict.fromkeys(("goal_velocity", "profile_acceleration", "profile_velocity"), 0),
}
"""Registers that act on motion, beside the gains and what is demanded: other software may have left any value. They are
read, and written only if different, because EEPROM wears."""
_DEMANDED = {
    "drive_mode": (0, 0, "set the sign with the parameter 'direction'"),
    "homing_offset": (0, 0, "set the zero with the parameter 'zero_ticks'"),
    "secondary_id": (255, 255, "otherwise it obeys packets for another servo too"),
    "temperature_limit": (60, 80, "80 °C is the servo's rating; below 60 °C normal work would stop it"),
    "min_voltage": (95, 110, "in units of 0.1 V; at 12 V it must neither trip nor miss a failing supply"),
    "max_voltage": (130, 160, "in units of 0.1 V; at 12 V it must not trip, and beyond 16 V the servo is at risk"),
    "pwm_limit": (885, 885, "a lower limit reduces speed and force"),
}
"""EEPROM registers that are checked but never written, because they were set on purpose: lowest, highest, reason."""
_SHUTDOWN_BITS = (2, 5)
"""Errors on which a servo must switch itself off: overheating and overload."""


def set_up(link: ServoLink, settings: BusSettings, scan: bool = True) -> None:
    """Identify every servo and configure the expected ones; their torque is off afterwards.

    Args:
        link: an open link.
        settings: ids and configuration of the servos.
        scan: look for servos that do not answer at other speeds and with old firmware, to name their speed; about a
            second per servo.

    Raises:
        HandshakeError: every fault of every servo, one sentence each.
        PortGone: the port vanished.
    """
    found = identify(link, settings.ids, scan)
    faults = []
    for servo, fault in found.items():
        faults += [fault] if fault else _configure(link, servo, settings)
    if faults:
        raise HandshakeError(link.port, faults)


def identify(link: ServoLink, servos: Sequence[int], scan: bool = True) -> dict[int, str]:
    """Return why each servo is not an MX-64 with Protocol 2.0 that answers at the link's speed; "" if it is.

    Args:
        link: an open link.
        servos: ids.
        scan: look for servos that do not answer, see `set_up`.

    Raises:
        PortGone: the port vanished.
    """
    faults = {}
    for servo in servos:
        fault = _identify_one(link, servo)
        if fault is None:
            fault = _locate(link, servo) if scan else f"servo {servo} does not answer"
        faults[servo] = fault
    return faults


def _identify_one(link: ServoLink, servo: int) -> str | None:
    """Return the fault of a servo at the link's speed: "" for none, None without an answer."""
    try:
        model = link.ping(servo, attempts=2)
    except NoAnswer:
        return None
    except CorruptReply:
        return f"servo {servo} sends garbled replies; look for two servos with this id, noise or a bad plug"
    if model == MODEL:
        return ""
    if model == MODEL_PROTOCOL_1:
        return f"servo {servo} is an MX-64 with Protocol 1.0 firmware; {_UPDATE_ADVICE}"
    return f"servo {servo} is model {model}, not an MX-64 with Protocol 2.0 ({MODEL})"


def _locate(link: ServoLink, servo: int) -> str:
    """Return at which speed a servo answers that did not answer at the link's speed; "" for one that answers now.

    The supply may be switched on together with the computer: a servo that was still starting is asked once more.
    """
    try:
        if link.ping_protocol_1(servo):
            return f"servo {servo} uses Protocol 1.0; {_UPDATE_ADVICE}"
        for speed in _SCANNED_SPEEDS:
            if speed == link.baud_rate:
                continue
            link.set_speed(speed)
            found = f"servo {servo} answers at {speed} bit/s, not at {link.baud_rate}"
            try:
                link.ping(servo)
            except (NoAnswer, CorruptReply):
                if link.ping_protocol_1(servo):
                    return f"{found}, and uses Protocol 1.0; {_UPDATE_ADVICE}"
                continue
            return f"{found}; set its speed with 'deltacharger doctor --set-baud' or correct 'baud_rate'"
    finally:
        link.set_speed(link.baud_rate)
    silent = f"servo {servo} does not answer at any speed; check its supply, its cable and its id"
    return silent if (fault := _identify_one(link, servo)) is None else fault


def configure(link: ServoLink, servo: int, settings: BusSettings) -> None:
    """Switch a servo's torque off and configure it for the cycle, verifying each register by reading it back.

    Written: status return level, torque enable, `MOTION`, gains of the position loop, indirect addresses, bus watchdog.
    Checked but never written: drive mode, homing offset, secondary id, shutdown, and
    the limits of temperature, voltage, PWM and current. Neither: id, baud rate.

    Args:
        link: an open link.
        servo: its id.
        settings: for the watchdog, the gains and the largest current.

    Raises:
        HandshakeError: every setting that failed.
        PortGone: the port vanished.
    """
    faults = _configure(link, servo, settings)
    if faults:
        raise HandshakeError(link.port, faults)


def check_registers(link: ServoLink, servo: int, current_max: float) -> list[str]:
    """Return the faults of the registers that the driver checks but never writes.

    Args:
        link: an open link.
        servo: its id.
        current_max: A, the largest current bound of any goal.

    Returns:
        "servo 1: fault; advice" for each fault.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: they cannot be read.
    """
    faults = []
    least = current_to_counts(current_max)
    advice = (
        "the servo would ignore every goal whose current bound is above its limit; raise it to 1941 or lower the "
        f"parameter 'current_max' ({current_max:g} A = {least})"
    )
    demands = {**_DEMANDED, "current_limit": (least, REGISTERS["current_limit"].high, advice)}
    for name, (low, high, why) in demands.items():
        value = link.read(servo, name)
        if not low <= value <= high:
            allowed = f"{low}" if low == high else f"{low} to {high}"
            faults.append(f"servo {servo}: {name.replace('_', ' ')} is {value} and must be {allowed}; {why}")
    shutdown = link.read(servo, "shutdown")
    lacking = [HARDWARE_ERRORS[bit] for bit in _SHUTDOWN_BITS if not shutdown >> bit & 1]
    if lacking:
        faults.append(
            f"servo {servo}: shutdown is {shutdown} and does not name {' and '.join(lacking)}; the servo must switch "
            f"itself off then: set it to {shutdown | sum(1 << bit for bit in _SHUTDOWN_BITS)} with the vendor's wizard"
        )
    return faults


def _configure(link: ServoLink, servo: int, settings: BusSettings) -> list[str]:
    """Configure a servo and return every fault."""
    faults: list[str] = []
    try:
        _enable_replies(link, servo, faults)
        _attempt(lambda: link.write(servo, "bus_watchdog", 0), faults)
        _set(link, servo, "torque_enable", 0, faults)
        faults += check_registers(link, servo, settings.current_max)
        if not faults:
            _prepare(link, servo, settings, faults)
    except PortGone:
        raise
    except DriverError as error:
        faults.append(str(error))
    return faults


def _enable_replies(link: ServoLink, servo: int, faults: list[str]) -> None:
    """Make the servo confirm every write; at another status return level it may answer only pings."""
    try:
        level = link.read(servo, "status_return_level")
    except NoAnswer:
        level = 0
    if level != 2:
        link.write_unanswered(servo, "status_return_level", 2)
        _verify(link, servo, "status_return_level", 2, faults)


def _prepare(link: ServoLink, servo: int, settings: BusSettings, faults: list[str]) -> None:
    """Write the registers that the cycle needs, the watchdog last, after reading the cycle's block once."""
    for name, value in (MOTION | dict(zip(GAINS, settings.gains, strict=True))).items():
        if link.read(servo, name) != value:
            _set(link, servo, name, value, faults)
    _attempt(lambda: _map_blocks(link, servo, faults), faults)
    if faults:
        return
    try:
        decode_block(link.read_bytes(servo, READ_ADDRESS, READ_LENGTH, "read the block of the cycle"))
    except RangeError as error:
        faults.append(f"servo {servo}: {error}; restart it, and look for another program on its bus")
    else:
        _set(link, servo, "bus_watchdog", settings.watchdog, faults)


def restart_watchdog(link: ServoLink, servo: int, watchdog: int = WATCHDOG) -> None:
    """Clear a tripped watchdog and arm it again.

    Raises:
        NoAnswer, CorruptReply, ServoFault, PortGone: it cannot be written.
    """
    link.write(servo, "bus_watchdog", 0)
    link.write(servo, "bus_watchdog", watchdog)


def _set(link: ServoLink, servo: int, name: str, value: int, faults: list[str]) -> None:
    if _attempt(lambda: link.write(servo, name, value), faults):
        _verify(link, servo, name, value, faults)


def _attempt(action: Callable[[], None], faults: list[str]) -> bool:
    """Return whether the servo executed `action`; after a rejection the other registers are still tried."""
    try:
        action()
    except ServoFault as fault:
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
        REGISTERS[name].address + offset for name in READ_BLOCK + WRITE_BLOCK for offset in range(REGISTERS[name].size)
    ]
    table = struct.pack(f"<{len(targets)}H", *targets)
    link.write_bytes(servo, indirect_address(0), table, "write the indirect addresses")
    if link.read_bytes(servo, indirect_address(0), len(table), "read the indirect addresses") != table:
        faults.append(f"servo {servo}: the indirect addresses do not read as written; update its firmware")
