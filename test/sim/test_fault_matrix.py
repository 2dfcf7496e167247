# SPDX-License-Identifier: Apache-2.0
"""Every fault of the hardware on the bytes of real nodes while a charger charges: its effects, its code, its recovery.

One charger serves all cells, and no node is restarted. The servos' driver is shown the same table in virtual time
(test/driver/test_servo_faults.py), docking's machine what it sees (test/docking/test_machine_faults.py).
"""

import math
import time
from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_docking.codes import Code, State
from deltacharger_sim.charger.faults import Fault

from ..waiting import host, wait_until
from .fault_table import INPUTS, NEVER, ROWS, Row

pytestmark = pytest.mark.ros

_GOES_ON = 0.6  # s of the world for which charging continues under a tolerated fault
_PUSHES_MORE = 5.0  # N of additional push that is permitted; a stop must never press harder
_SLACK = 0.1  # s: an opening's ramp (0.05), the power stage's cycle and the world's step

WITNESSES = ("servo_missing", "servo_overload", "board_silent")
"""One cell for each way in which a fault travels: lost bytes, a latched error, a silent board."""
REST = (
    *(f"servo_{name}" for name in ("watchdog", "unplugged")),
    *(f"board_{name}" for name in ("reboot", "trip-9", "deaf", "unplugged", "delay-0.4")),
)
assert {*WITNESSES, *REST} < {row.name for row in ROWS}
CELLS = [
    pytest.param(row, id=row.name, marks=getattr(pytest.mark, mark))
    for row in ROWS
    for mark in ["witness" if row.name in WITNESSES else "rest" if row.name in REST else "night"]
]


class Diagnostics:
    """What the charger's nodes have reported, newest last."""

    def __init__(self, charger: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        self._own = f"{charger.namespace}/"
        self._statuses: list[tuple[float, Any]] = []
        charger.client.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_message, 10)

    def _on_message(self, message: Any) -> None:
        now = time.monotonic()
        self._statuses += [(now, each) for each in message.status if each.name.lstrip("/").startswith(self._own)]

    def of(self, part: str, since: float = 0.0) -> list[Any]:
        """Return the reports of a part after an instant."""
        return [each for when, each in list(self._statuses) if when > since and each.name.endswith(part)]

    def warned(self, row: Row, since: float) -> bool:
        """Whether the row's part has reported its warning, which is no OK."""
        messages = [each.message for each in self.of(row.part, since) if each.level != b"\0"]
        return any(all(word in message for word in row.warning) for message in messages)

    def count(self, row: Row) -> int:
        """Return the row's counter."""
        values = {value.key: value.value for each in self.of(row.part) for value in each.values}
        return int(values.get(row.counted, 0))


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[Any]:
    from deltacharger_bringup.scenes.scene import parse_scene

    from ..quick import QUICK
    from ..running_charger import RunningCharger

    with RunningCharger(parse_scene(QUICK, "faults"), context) as charger:
        charger.diagnostics = Diagnostics(charger)
        yield charger


@pytest.mark.parametrize("row", CELLS)
def test_fault(charger: Any, row: Row) -> None:
    world, record, faults, told = charger.world, charger.world.record, charger.emulators.faults, charger.diagnostics
    code = INPUTS[row.shows].codes[State.CHARGING] if row.shows else Code.NONE
    wait_until(lambda: charger.state.state in (State.IDLE, State.CHARGING), "the end of an earlier cell")
    charger.charge()
    count, first, began, at = told.count(row), len(world.events), time.monotonic(), world.time
    record.peak_push, push, lost = 0.0, world.push(), record.unpowered_live
    faults.begin_fault(Fault(kind=row.kind, servo=row.servo, amount=row.amount))
    try:
        for servo in row.unknown:
            wait_until(lambda servo=servo: math.isnan(charger.servos.position[servo - 1]), "NaN")  # type: ignore[misc]
        if row.opens != NEVER:
            assert charger.opened(at) <= host(row.opens) + _SLACK
        if row.warning and row.kind != "servo_reboot":  # which is over before the next diagnostics
            wait_until(lambda: told.warned(row, began), f"{row.part} to report {row.warning}")
        if row.counted:
            wait_until(lambda: told.count(row) > count, f"{row.part} to count {row.counted}")
        wait_until(lambda: world.time > at + _GOES_ON, "the world to go on")
        if row.opens != NEVER or code is not Code.NONE:
            wait_until(lambda: charger.state.error_code and charger.state.state == State.IDLE, "docking to end")
            assert not charger.is_closed
            assert code in (Code.NONE, charger.state.error_code), charger.state.error_message
        else:
            assert charger.state.charging
            assert world.circuit.current > 0.5, "charging did not go on"
        assert record.peak_push - push <= _PUSHES_MORE
        for servo in (1, 2, 3):
            # Docking may ask for torque again, for the way home, once all servos answer.
            assert not any(event.live for event in world.since(first, servo, True))
            live = [event for event in world.since(first, servo, False) if event.live]
            assert all(servo in row.at_once and event.time <= at + _SLACK for event in live), live
    finally:
        faults.clear()
    recover(charger, row)
    # A servo loses its torque at once: no driver can open before that.
    assert record.unpowered_live - lost <= bool(row.at_once)
    assert (record.energised_shorts, record.energised_unsafe, record.parted_live) == (0, 0.0, 0)


def recover(charger: Any, row: Row) -> None:
    """Do what a person does; the next cell docks again, which needs nothing else."""
    from std_srvs.srv import SetBool, Trigger

    from ..nodes import call

    if "reboot_servos" in row.recovery:
        node = charger.client.node
        torque, reboot = node.create_client(SetBool, "set_torque"), node.create_client(Trigger, "reboot_servos")
        refused = call(torque, SetBool.Request(data=True))
        assert not refused.success
        assert "reboot_servos" in refused.message
        wait_until(lambda: call(reboot, Trigger.Request()).success, "the reboot of the servos")
        assert not any(charger.world.torque), "a reboot switched torque on"
        node.destroy_client(torque)
        node.destroy_client(reboot)
    charger.wait_until_ready()
    wait_until(lambda: all(charger.servos.valid), "all servos to answer")
    assert charger.undock().success
    assert not charger.is_closed
