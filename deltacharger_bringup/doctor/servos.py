# SPDX-License-Identifier: Apache-2.0
"""Checks of the servos (present, right speed, healthy, set as the driver requires)."""

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence

from deltacharger_bringup.doctor.findings import Finding, failed, hint, ok, wrong
from deltacharger_core.servo_types import NAMES, TYPES, ServoType
from deltacharger_driver.errors import CorruptReply, NoAnswer, ServoFault
from deltacharger_driver.port_identity import SERVO_SPEEDS, FoundServo, PortIdentity, identify
from deltacharger_driver.servos import bus, registers
from deltacharger_driver.servos.link import ServoLink

SUPPLY = (11.0, 13.0)  # V, what a 12 V regulator gives
_WARM = 15.0  # °C below the servo's own limit
_PATIENCE = 0.15  # s to wait for replies to a broadcast ping; enough for ids up to about 50
_READS = 50  # of each servo, for the quality of the line
_SUPPLY_ADVICE = "check the 12 V supply, the cable and its plugs"
_FIRMWARE_ADVICE = "update its firmware to 39 or later (Protocol 2.0) with the vendor's wizard"


def examine_servos(
    path: str,
    baud_rate: int,
    ids: Sequence[int],
    current_max: float | None,
    speeds: Sequence[int] = SERVO_SPEEDS,
) -> Iterator[Finding]:
    """Find all servos of a port and check those that the charger uses.

    Args:
        path: of the port; no other program may have it open.
        baud_rate: expected speed, bit/s.
        ids: of limbs 0, 1, 2.
        current_max: A, the largest current bound that will be used; None = the stall current of their type.
        speeds: to search, bit/s.
    """
    found = identify(path, speeds, ids, _PATIENCE)
    if found.kind != "servos":
        yield _none(found)
        return
    ready: dict[int, ServoType] = {}
    for servo in ids:
        matching = [one for one in found.servos if one.servo == servo]
        problem = _problem(servo, matching, baud_rate)
        if problem is not None:
            yield problem
            continue
        kind = TYPES[matching[0].model]
        like, usual = next(iter(ready.items()), (servo, kind))
        if kind is usual:
            ready[servo] = kind
            yield ok(f"servo {servo}", f"answers at {baud_rate} bit/s, {kind.name}, firmware {matching[0].firmware}")
        else:
            yield wrong(f"servo {servo}", f"is {kind}, not {usual} as servo {like}", "use servos of one type")
    yield from _strangers(found.servos, ids)
    if ready:
        yield from _check_registers(path, baud_rate, ready, current_max)


def _none(found: PortIdentity) -> Finding:
    if found.kind == "board":
        advice = "exchange the two cables, or the two ports in the scene or on the command line"
        return wrong("servos", f"{found.port}: the board is here, not the servos", advice)
    if found.kind == "silent":
        text = f"{found.port}: no servo answers, at any speed, with Protocol 2.0 or 1.0"
        return wrong("servos", text, f"{_SUPPLY_ADVICE}; or give the right port")
    return wrong("servos", f"{found.port}: {found.details}", "give the right port, or check noise and duplicate ids")


def _problem(servo: int, matching: Sequence[FoundServo], baud_rate: int) -> Finding | None:
    """Return why one servo cannot be used, or None."""
    part = f"servo {servo}"
    if not matching:
        return wrong(part, "does not answer at any speed", f"{_SUPPLY_ADVICE}; set its id to {servo} if it has another")
    one = matching[0]
    if len(matching) > 1 or one.garbled:
        where = " and ".join(str(one.speed) for one in matching)
        text = f"answers unintelligibly or twice (at {where} bit/s): two servos have this id, or there is noise"
        return wrong(part, text, "unplug one of two servos and give it another id; otherwise check the plugs")
    if one.protocol == 1:
        return wrong(part, f"uses Protocol 1.0 at {one.speed} bit/s", _FIRMWARE_ADVICE)
    if one.model not in TYPES:
        return wrong(part, f"is model {one.model}, not {NAMES} with Protocol 2.0", "replace it")
    if one.speed != baud_rate:
        return wrong(
            part, f"answers at {one.speed} bit/s, not at {baud_rate}", "set its speed with the vendor's wizard"
        )
    return None


def _strangers(servos: Sequence[FoundServo], ids: Sequence[int]) -> Iterator[Finding]:
    for one in servos:
        if one.servo not in ids:
            yield hint("servos", f"unused servo on the bus: {one}", "check whether its id is wrong")


def _check_registers(
    path: str, baud_rate: int, servos: Mapping[int, ServoType], current_max: float | None
) -> Iterator[Finding]:
    """Yield the findings from the registers of servos at the right speed."""
    link = ServoLink(path, baud_rate)
    link.open()
    try:
        for servo, kind in servos.items():
            try:
                yield from _health(link, servo, kind)
                yield from _settings(link, servo, kind, kind.stall_current if current_max is None else current_max)
            except NoAnswer:
                text = "answers pings but no reads: its status return level is 0, or the line is bad"
                yield hint(f"servo {servo}", text, "start servo_node, which sets the level; then check the plugs")
            except (CorruptReply, ServoFault) as error:
                yield failed(f"servo {servo}", error, "check for noise, a bad plug or two servos with this id")
        yield from _line(link, list(servos))
    finally:
        link.close()


def _health(link: ServoLink, servo: int, kind: ServoType) -> Iterator[Finding]:
    part = f"servo {servo}"
    errors = link.read(servo, "hardware_error")
    if errors:
        advice = "remove the cause, then call the service reboot_servos or switch the supply off and on"
        yield wrong(part, f"hardware error latched: {registers.describe_hardware_error(errors)}", advice)
    if link.read(servo, "torque_enable"):
        yield hint(part, "its torque is on although no driver runs", "servo_node switches it off when it starts")
    if link.read(servo, "bus_watchdog") == registers.WATCHDOG_TRIPPED:
        text = "its bus watchdog has tripped: it received nothing for too long and accepts no goals"
        yield hint(part, text, "servo_node clears it when it starts")
    voltage = kind.voltage_unit * link.read(servo, "input_voltage")
    temperature, limit = link.read(servo, "temperature"), link.read(servo, "temperature_limit")
    least, most = (kind.voltage_unit * link.read(servo, name) for name in ("min_voltage", "max_voltage"))
    if not least <= voltage <= most:
        yield wrong(part, f"supply {voltage:.1f} V, outside its limits of {least:.1f} to {most:.1f} V", _SUPPLY_ADVICE)
    elif not SUPPLY[0] <= voltage <= SUPPLY[1]:
        yield hint(
            part, f"supply {voltage:.1f} V; the regulator should give 12 V", "check the regulator and the battery"
        )
    if temperature >= limit:
        yield wrong(part, f"{temperature} °C, at its limit of {limit} °C: it will switch off", "let it cool")
    elif temperature > limit - _WARM:
        yield hint(part, f"{temperature} °C, near its limit of {limit} °C", "let it cool, or reduce its load")
    yield ok(part, f"supply {voltage:.1f} V, {temperature} °C")


def _settings(link: ServoLink, servo: int, kind: ServoType, current_max: float) -> Iterator[Finding]:
    """Yield the registers that servo_node would refuse."""
    for fault in bus.check_registers(link, servo, kind, current_max):
        what, _, advice = fault.partition("; ")
        advice = f"{advice}; set it with the vendor's wizard" if "wizard" not in advice else advice
        yield wrong(f"servo {servo}", what.removeprefix(f"servo {servo}: "), advice)


def _line(link: ServoLink, servos: Sequence[int]) -> Iterator[Finding]:
    """Yield the reliability and the response time of the servos."""
    times: list[float] = []
    lost = 0
    for _ in range(_READS):
        for servo in servos:
            began = time.monotonic()
            try:
                link.read(servo, "present_position", hurry=True)
                times.append(time.monotonic() - began)
            except (NoAnswer, CorruptReply, ServoFault):
                lost += 1
    asked = _READS * len(servos)
    counters = link.counters
    text = f"{asked} reads, {lost} lost"
    if lost:
        text += f" ({counters.timeouts} silent, {counters.corrupt} damaged, {counters.late} late)"
    if times:
        text += f", median {statistics.median(times) * 1e3:.1f} ms each"
    if lost > asked // 100:
        yield wrong(
            "servo line", text, "check plugs and cables, keep them away from the power stage's, check the ground"
        )
    elif lost:
        yield hint("servo line", text, "check plugs and cables")
    else:
        yield ok("servo line", text)
