# SPDX-License-Identifier: Apache-2.0
"""What `BoardLink` tells about its heartbeat."""

from __future__ import annotations

import math
import time

import pytest

from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.emulators.pseudo_terminal import PseudoTerminal

from ..waiting import wait_until

pytestmark = pytest.mark.realtime


def test_how_late_heartbeats_were_is_told_while_there_is_a_connection(board: BoardEmulator) -> None:
    with PseudoTerminal(board) as cable:
        link = BoardLink(cable.path)
        assert link.heartbeat_lateness is None
        link.open()
        lateness = link.heartbeat_lateness
        assert lateness is not None
        assert math.isnan(lateness.largest)
        link.keep_alive(time.monotonic() + 1.0)
        wait_until(lambda: link.counters.heartbeats >= 3)
        assert 0.0 <= lateness.percentile(0.5) <= lateness.largest
        link.close()
        assert link.heartbeat_lateness is None
