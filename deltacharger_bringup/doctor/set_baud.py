# SPDX-License-Identifier: Apache-2.0
"""Write the speed of servos on request: first torque off, then write, then read back at the new speed."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from deltacharger_bringup.doctor.findings import Finding, ok, wrong
from deltacharger_core.machine import SERVO_IDS

if TYPE_CHECKING:
    from deltacharger_driver.port_identity import FoundServo
    from deltacharger_driver.servos.link import ServoLink

_PATIENCE = 0.15  # s for replies to a ping to all
_COMES_BACK = 1.0  # s until a servo answers at its new speed
_STEP = 0.05  # s


def set_baud(path: str, baud: int, ids: Sequence[int] | None, speeds: Sequence[int] = ()) -> Iterator[Finding]:
    """Write the speed of servos that have another one. Nothing else is written, except torque off.

    Args:
        path: of the port; no other program may have it open.
        baud: new speed, a value of mx64.SPEEDS, bit/s.
        ids: of the servos; None = all that answer.
        speeds: to search, bit/s; empty = all speeds of the servos.

    Yields:
        one finding per servo, ok if it has the speed `baud` now.
    """
    from deltacharger_driver.port_identity import SERVO_SPEEDS, identify

    wanted = None if ids is None else list(dict.fromkeys(ids))
    found = identify(path, speeds or SERVO_SPEEDS, wanted or SERVO_IDS, _PATIENCE)
    if found.kind == "board":
        yield wrong("servos", f"{path}: the board is here, not the servos", "give the servos' port")
        return
    everyone = sorted({one.servo for one in found.servos})
    if not everyone and wanted is None:
        yield wrong("servos", f"{path}: {found.details}", "check the 12 V supply, the cable and the port")
    for servo in everyone if wanted is None else wanted:
        yield _set_one(path, baud, servo, [one for one in found.servos if one.servo == servo])


def _set_one(path: str, baud: int, servo: int, matching: Sequence[FoundServo]) -> Finding:
    from deltacharger_driver.errors import DriverError
    from deltacharger_driver.servos.link import ServoLink
    from deltacharger_driver.servos.mx64 import MODEL

    part = f"servo {servo}"
    if not matching:
        return wrong(part, "does not answer at any speed", "check the 12 V supply, the cable and its id")
    one = matching[0]
    if len(matching) > 1 or one.garbled:
        text = "answers unintelligibly or twice: two servos have this id, or there is noise; nothing was written"
        return wrong(part, text, "unplug one of two servos and give it another id first; otherwise check the plugs")
    if one.protocol == 1 or one.model != MODEL:
        text = f"is no MX-64 with Protocol 2.0 ({one}); nothing was written"
        return wrong(part, text, "update its firmware to 39 or later with the vendor's wizard")
    if one.speed == baud:
        return ok(part, f"has {baud} bit/s already; nothing was written")
    link = ServoLink(path, one.speed)
    link.open()
    try:
        return _write(link, servo, one.speed, baud)
    except DriverError as error:
        return wrong(
            part, str(error), "check the 12 V supply and the cable, then run the doctor again to find its speed"
        )
    finally:
        link.close()


def _write(link: ServoLink, servo: int, old: int, new: int) -> Finding:
    """Switch torque off, write the speed, follow the servo to it and read it back.

    Raises:
        DriverError: the servo refuses, or the line fails.
    """
    from deltacharger_driver.errors import CorruptReply, NoAnswer
    from deltacharger_driver.servos.mx64 import SPEEDS

    part = f"servo {servo}"
    code = next(code for code, speed in SPEEDS.items() if speed == new)
    link.write(servo, "torque_enable", 0)
    if link.read(servo, "torque_enable") != 0:
        return wrong(part, "its torque cannot be switched off; nothing was written", "switch its supply off and on")
    with contextlib.suppress(NoAnswer, CorruptReply):  # it may already confirm at the new speed
        link.write(servo, "baud", code)
    link.set_speed(new)
    end = time.monotonic() + _COMES_BACK
    while True:
        with contextlib.suppress(NoAnswer, CorruptReply):
            if link.read(servo, "baud") == code:
                return ok(part, f"set from {old} to {new} bit/s and read back at {new}")
        if time.monotonic() > end:
            advice = "switch its supply off and on, then run the doctor again to find its speed"
            return wrong(part, f"does not answer at the new speed of {new} bit/s", advice)
        time.sleep(_STEP)
