# SPDX-License-Identifier: Apache-2.0
"""Targets that are off, asleep or behind a diode: a port without a voltage, and how the board starts it."""

from __future__ import annotations

import pytest

from deltacharger_driver.board.protocol import BoardFault

from .bench import DEAD, MS, Bench, S

ASLEEP = "target 0", "resistance 50"
AWAKE = "target 24", "resistance 0.1"


@pytest.fixture
def asleep(bench: Bench) -> Bench:
    """A board that has just closed on a dead port which takes some current."""
    bench.set(*ASLEEP)
    return bench.closed(DEAD)


def test_a_dead_port_gets_half_an_ampere_until_it_has_charged_for_200_ms(asleep: Bench) -> None:
    asleep.run(1 * S)
    asleep.check(limit=0.5, current=0.5)
    asleep.set(*AWAKE)
    asleep.run(198 * MS)
    asleep.check(limit=0.5)
    asleep.run(100 * MS)
    assert asleep.state("limit") == pytest.approx(0.5 + 0.1 * 40.0, abs=0.2)
    asleep.run(1 * S)
    asleep.check(limit=18.0, fault=0)


@pytest.mark.parametrize("trouble", ["force current 0", "force target 9", "force target nan"])
def test_every_break_begins_the_200_ms_again(asleep: Bench, trouble: str) -> None:
    asleep.set(*AWAKE)
    for _ in range(5):
        asleep.run(150 * MS)
        asleep.set(trouble)
        asleep.run(2 * MS)
        asleep.set(f"force {trouble.split()[1]} none")
    asleep.check(limit=0.5, fault=0)


@pytest.mark.parametrize(
    ("port", "fault"),
    [
        (("force current 0",), BoardFault.NO_CHARGE_CURRENT),
        (("resistance inf",), BoardFault.NO_CHARGE_CURRENT),
        (("target 1.9",), BoardFault.SHORT_CIRCUIT),
        (("target 9.9",), BoardFault.VOLTAGE_OUT_OF_RANGE),
    ],
)
def test_a_port_that_does_not_start_in_time_ends_with_its_fault(
    bench: Bench, port: tuple[str, ...], fault: BoardFault
) -> None:
    bench.set(*ASLEEP)
    bench.closed(DEAD._replace(start_time=5.0)).set(*port)
    assert bench.run_until("contactor", 0, 6 * S, step=10 * MS) == pytest.approx(5 * S, abs=12 * MS)
    bench.check(fault=fault)


@pytest.mark.parametrize(
    ("trouble", "after", "fault"),
    [
        ("force target nan", 100 * MS, BoardFault.STALE),
        ("force target 29.8", 100 * MS, BoardFault.VOLTAGE_OUT_OF_RANGE),
        ("force target -1", 0, BoardFault.REVERSE_POLARITY),
        ("force current 1.1", 0, BoardFault.SHORT_CIRCUIT),
    ],
)
def test_what_protects_a_live_port_protects_a_dead_one(
    asleep: Bench, trouble: str, after: int, fault: BoardFault
) -> None:
    asleep.set(trouble)
    if after:
        asleep.run(after - 2 * MS)
        asleep.check(contactor=1)
    asleep.run(4 * MS)
    asleep.check(contactor=0, fault=fault)
