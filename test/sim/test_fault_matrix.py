# SPDX-License-Identifier: Apache-2.0
"""Every fault while moving, while pressing and while charging, against the drivers, their bytes and one world.

One charger serves them all: after each fault it is brought back to what it did, and no node is ever restarted.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_sim.charger.fault_kinds import KINDS

from ..chargers import new_namespace
from .fault_bench import Bench, Phase
from .fault_cell import suffer
from .fault_table import BOARD_ROWS, SERVO_ROWS, Row

pytestmark = [pytest.mark.ros, pytest.mark.realtime]

ROWS = SERVO_ROWS + BOARD_ROWS


@pytest.fixture(scope="module")
def bench(context: Any) -> Iterator[Bench]:
    bench = Bench(context, new_namespace())
    yield bench
    bench.close()


def test_the_table_knows_every_kind_of_fault() -> None:
    assert {row.kind for row in ROWS} == set(KINDS)
    assert len({row.name for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
@pytest.mark.parametrize("phase", Phase, ids=lambda phase: phase.value)
def test_fault(bench: Bench, phase: Phase, row: Row) -> None:
    suffer(bench, row, phase)
