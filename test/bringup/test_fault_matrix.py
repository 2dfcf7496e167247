"""Every fault while moving, while pressing and while charging, against the drivers, their bytes and one world.

One charger serves them all: after each fault it is brought back to what it did, and no node is ever restarted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_bringup.fault_kinds import KINDS

from .conftest import new_namespace
from .fault_bench import Bench, Phase
from .fault_cell import suffer
from .fault_table import BOARD_ROWS, SERVO_ROWS, Row

ROWS = SERVO_ROWS + BOARD_ROWS
_KEEPS_TORQUE = "a servo that could not be told to let go keeps its torque when it can be told again"
KNOWN: dict[tuple[str, str], tuple[str, bool]] = {
    **{
        (name, phase.value): (_KEEPS_TORQUE, True)
        for name in ("servo_wrong_baud-57600", "servo_deaf")
        for phase in Phase
    },
    **{
        ("servo_reboot", phase.value): ("why torque went is not told any more once the servo is set up again", True)
        for phase in Phase
    },
    ("servo_watchdog", "moving"): ("servos are asked one a second whether their watchdog has stopped them", False),
}
"""Cells that fail: why, and whether they must."""


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context, new_namespace())
    yield bench
    bench.close()


def test_the_table_knows_every_kind_of_fault() -> None:
    assert {row.kind for row in ROWS} == set(KINDS)
    assert len({row.name for row in ROWS}) == len(ROWS)


def cell(phase: Phase, row: Row) -> Any:
    reason, strict = KNOWN.get((row.name, phase.value), ("", False))
    marks = [pytest.mark.xfail(reason=reason, strict=strict)] if reason else []
    return pytest.param(phase, row, marks=marks, id=f"{phase.value}-{row.name}")


@pytest.mark.parametrize(("phase", "row"), [cell(phase, row) for phase in Phase for row in ROWS])
def test_fault(bench: Bench, phase: Phase, row: Row) -> None:
    suffer(bench, row, phase)
