# SPDX-License-Identifier: Apache-2.0
"""Sequence and detectors of the power stage, in simulated time; the emulator's plant has none of them."""

import itertools
from collections.abc import Callable

import pytest

from deltacharger_driver.board.protocol import AckError, BoardFault, PacketType, decode_power

from .bench import LIMITS, MS, STRONG, Bench, S

NewBench = Callable[..., Bench]


def closing(bench: Bench) -> None:
    """Heartbeat, a good probe and an accepted close."""
    bench.beating = True
    bench.run(0)
    bench.probe()
    assert bench.close_contactor() == 0


def test_the_close_precharges_then_closes_then_ramps_up(bench: Bench) -> None:
    bench.set(*STRONG)
    closing(bench)
    bench.check(precharge=1, contactor=0, limit=0)
    while bench.state("contactor") == 0:
        bench.check(limit=0)  # the contacts close without current
        assert bench.now < 1 * S
        bench.run(1 * MS)
    bench.run(5 * MS)
    bench.check(precharge=0)
    limits = []
    for _ in range(60):
        limits.append(bench.state("limit"))
        assert bench.state("current") <= 18.0
        bench.run(10 * MS)
    assert max(after - before for before, after in itertools.pairwise(limits)) <= 0.010 * 40.0 + 0.05
    bench.check(limit=18.0, current=18.0)


def test_an_opening_ramps_below_1_a_within_50_ms(bench: Bench) -> None:
    bench.set(*STRONG)
    bench.charge().check(current=18.0)
    assert bench.open() == 0
    bench.check(commanded=0)
    assert bench.run_until("contactor", 0, 51 * MS) <= 50 * MS
    assert bench.state("broken") < 1.0
    bench.run(200 * MS)
    bench.check(fault=0)


def test_an_opening_opens_after_50_ms_if_the_current_does_not_fall(bench: Bench) -> None:
    bench.charge().set("force current 12")
    bench.open()
    bench.run(49 * MS)
    bench.check(contactor=1)
    bench.open()  # a repeated opening does not restart the ramp
    bench.run(1 * MS)
    bench.check(contactor=0)


def test_a_fault_opens_at_once_under_full_current(bench: Bench) -> None:
    bench.set(*STRONG)
    bench.charge().set("trip 2")
    bench.check(contactor=0, broken=18.0)


def test_a_contactor_that_opens_on_its_own_is_no_fault_and_needs_a_new_probe(bench: Bench) -> None:
    bench.charge().set("drop 1")
    bench.run(22 * MS)
    bench.check(commanded=0, limit=0)
    assert bench.close_contactor() == AckError.INTERLOCK
    bench.check(fault=0)
    bench.set("drop 0")
    bench.charge()


def test_contacts_may_bounce_for_20_ms_of_100(bench: Bench) -> None:
    bench.charge()
    for _ in range(10):
        bench.set("drop 1")
        packets = bench.run(18 * MS)
        bench.set("drop 0")
        packets += bench.run(82 * MS)
        assert all(decode_power(each.payload).contactor_closed for each in packets if each.type == PacketType.POWER)
    bench.check(commanded=1, contactor=1, fault=0)
    for trouble, duration in (("drop 1", 5), ("drop 0", 20), ("drop 1", 2)):
        bench.set(trouble)
        bench.run(duration * MS)
    bench.check(commanded=0, limit=0, fault=0)
    bench.run(50 * MS)
    assert not bench.power().contactor_closed


@pytest.mark.parametrize(("release", "fault"), [(45 * MS, 0), (60 * MS, BoardFault.CONTACTOR_WELDED)])
def test_contacts_have_50_ms_to_open(bench: Bench, release: int, fault: int) -> None:
    bench.charge().set(f"release_time {release}", "trip 9")
    bench.open()  # clears the tripped fault
    bench.run(200 * MS)
    bench.check(fault=fault)


@pytest.mark.parametrize("trouble", ["welded 1", "force current 0.6"])
def test_contacts_welded_before_a_boot_are_detected_without_a_command(bench: Bench, trouble: str) -> None:
    bench.charge().set(trouble)
    bench.reboot()
    bench.run(130 * MS)
    bench.check(fault=BoardFault.CONTACTOR_WELDED)


def test_the_boards_own_limits_stay_the_outer_bounds(bench: Bench) -> None:
    bench.set(*STRONG)
    bench.charge(limits=LIMITS._replace(current=30.0, voltage=60.0)).check(limit=18.0, voltage=60.0)
    bench.set("force target 30.1")
    bench.run(102 * MS)
    bench.check(contactor=0, fault=BoardFault.VOLTAGE_OUT_OF_RANGE)
