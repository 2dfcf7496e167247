# SPDX-License-Identifier: Apache-2.0
"""The contract of any healthy board, run over a port on the firmware compiled for the board's processor."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from deltacharger_driver.pseudo_terminal import PseudoTerminal

from ..borrowed import anew, borrowed_tests
from ..driver.contract.sites import DEAD_TAXEL, LOAD, BoardSite
from .board_host import FirmwareBoard, FirmwarePlant

pytestmark = pytest.mark.night

for _name in ("conftest", "test_board_power", "test_board_stream", "test_board_wire", "test_contactor"):
    globals().update(borrowed_tests(anew(f"contract.{_name}", "contract_on_firmware"), set()))


@pytest.fixture
def board_site(arm_programs: Path) -> Iterator[BoardSite]:
    """The emulated processor behind a pseudo-terminal; the electrodes touch nothing."""
    FirmwareBoard.program = arm_programs / "board_host"
    plant = FirmwarePlant()
    plant.resistance = math.inf
    board = FirmwareBoard(plant)
    board.set_dead(*DEAD_TAXEL)
    with PseudoTerminal(board) as terminal:
        yield BoardSite(terminal.path, False, frozenset({DEAD_TAXEL}), lambda: setattr(plant, "resistance", LOAD))
    assert terminal.error is None
    board.host.close()
