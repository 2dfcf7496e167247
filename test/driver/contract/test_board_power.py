# SPDX-License-Identifier: Apache-2.0
"""Laws of a healthy board's power stage without a close of its contactor."""

from __future__ import annotations

import math
import statistics
import time
from itertools import pairwise

import pytest

from deltacharger_driver.board.protocol import POWER_RATE, BoardFault

from .host import BoardHost
from .sites import BoardSite

LARGEST_VOLTAGE = 60.0  # V
LEAKAGE = 0.5  # A, largest reading with an open contactor


def test_power_is_sent_at_its_rate_with_possible_values(host: BoardHost) -> None:
    samples = host.next_powers(12)
    steps = [later.time - earlier.time for earlier, later in pairwise(samples)]
    assert statistics.median(steps) * POWER_RATE == pytest.approx(1.0, rel=0.05)
    assert host.link.counters.lost_power == 0
    for power in (sample.power for sample in samples):
        assert power.contactor_closed is False
        assert power.fault == BoardFault.NONE
        assert math.isnan(power.battery_voltage) or 0.0 < power.battery_voltage < LARGEST_VOLTAGE
        assert math.isnan(power.target_voltage) or abs(power.target_voltage) < LARGEST_VOLTAGE
        assert math.isnan(power.charge_current) or abs(power.charge_current) < LEAKAGE


def test_an_opening_is_never_refused(host: BoardHost) -> None:
    for _ in range(3):
        host.link.contactor(False)
    assert not any(sample.power.contactor_closed for sample in host.next_powers(3))


def test_a_probe_answers_in_time_and_another_may_follow(host: BoardHost, board_site: BoardSite) -> None:
    for _ in range(3):
        began = time.monotonic()
        result = host.link.probe()
        assert began < result.time <= time.monotonic()
        assert result.resistance >= 0.0, "the board measured nothing"
        assert math.isnan(result.target_voltage) or abs(result.target_voltage) < LARGEST_VOLTAGE
    assert not board_site.real or host.link.counters.retries == 0  # this computer may pause
    assert all(sample.power.fault == BoardFault.NONE for sample in host.next_powers(2))


def test_a_probe_in_free_air_finds_an_open_circuit(
    host: BoardHost, board_site: BoardSite, load_connected: bool
) -> None:
    if board_site.real and load_connected:
        pytest.skip("with --close-contactor a load is connected to the electrodes")
    assert math.isinf(host.link.probe().resistance), "the electrodes must touch nothing"
