# SPDX-License-Identifier: Apache-2.0
"""Every fault while moving, while pressing and while charging, against the drivers, their bytes and one world.

One charger serves all cells: after each fault it returns to its work, and no node is restarted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_sim.charger.fault_kinds import KINDS

from ..chargers import new_namespace
from .fault_bench import Bench, Phase
from .fault_cell import check_fault
from .fault_table import BOARD_ROWS, SERVO_ROWS, Row

pytestmark = pytest.mark.ros

ROWS = SERVO_ROWS + BOARD_ROWS
QUICK = {
    Phase.MOVING: {"servo_missing", "servo_drop-0.05"},
    Phase.PRESSING: {"servo_missing", "board_deaf"},
    Phase.CHARGING: {
        *("servo_missing", "servo_overload", "servo_watchdog", "servo_deaf", "servo_unplugged", "servo_corrupt-0.05"),
        *("board_reboot", "board_trip-9", "board_dead_taxel-44", "board_silent", "board_deaf", "board_unplugged"),
        *("board_delay-0.4", "board_corrupt-0.05"),
    },
}
"""One cell for each way in which a fault shows; the other cells cover more kinds and phases."""
CELLS = [
    pytest.param(phase, row, id=f"{phase.value}-{row.name}", marks=[] if row.name in names else [pytest.mark.rest])
    for phase, names in QUICK.items()
    for row in ROWS
]


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context, new_namespace())
    yield bench
    bench.close()


def test_the_table_has_every_kind_of_fault() -> None:
    assert {row.kind for row in ROWS} == set(KINDS)
    assert len({row.name for row in ROWS}) == len(ROWS)
    assert set().union(*QUICK.values()) <= {row.name for row in ROWS}


@pytest.mark.parametrize(("phase", "row"), CELLS)
def test_fault(bench: Bench, phase: Phase, row: Row) -> None:
    check_fault(bench, row, phase)
