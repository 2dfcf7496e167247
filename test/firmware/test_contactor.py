# SPDX-License-Identifier: Apache-2.0
"""Heartbeat, probe and contactor on the firmware against docs/board-link.md, in simulated time."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest

from deltacharger_driver.board.protocol import AckError, BoardFault, PacketType

from .bench import MS, STRONG, Bench, S, acks

NewBench = Callable[..., Bench]
OPEN, CLOSE = (PacketType.CONTACTOR, b"\0"), (PacketType.CONTACTOR, b"\1")
PROBE = (PacketType.PROBE, b"")


def test_nothing_is_driven_after_a_boot(bench: Bench) -> None:
    bench.charge()
    bench.host.sent(f"boot {bench.now}")
    state = bench.host.state()
    assert (state["contactor"], state["precharge"], state["probe"], state["limit"]) == (0, 0, 0, 0)
    assert (state["commanded"], state["fault"]) == (0, 0)


def test_the_heartbeats_deadline_is_exact_to_the_microsecond(bench: Bench) -> None:
    bench.charge()
    bench.beating = False
    bench.send((PacketType.HEARTBEAT, b""))
    bench.run(100 * MS - 1)
    assert bench.state("contactor") == 1
    bench.run(1)
    assert bench.state("contactor") == 0
    assert bench.state("fault") == BoardFault.HEARTBEAT_LOST


def test_a_board_that_sleeps_wakes_for_the_heartbeats_deadline(bench: Bench) -> None:
    bench.charge()
    bench.beating = False
    bench.run(300)
    bench.send((PacketType.HEARTBEAT, b""))
    bench.run(100 * MS - 100)
    assert bench.host.idle <= 100


def test_a_heartbeat_after_its_deadline_during_a_sampling_is_too_late(bench: Bench) -> None:
    bench.charge()
    bench.beating = False
    bench.send((PacketType.HEARTBEAT, b""))
    bench.send((PacketType.START, b""))
    bench.run(90 * MS)
    bench.set("scan_time 12000")
    bench.jump(bench.now + 2 * MS)  # a frame is due, and ends 104 ms after the heartbeat
    assert bench.state("contactor") == 0
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.state("fault") == BoardFault.HEARTBEAT_LOST


def test_slow_commands_do_not_hide_a_lost_heartbeat(bench: Bench) -> None:
    bench.charge()
    bench.beating = False
    bench.send((PacketType.HEARTBEAT, b""))
    bench.set("press 8", "scan_time 10000")
    bench.run(95 * MS)
    bench.send((PacketType.TARE, b""), (PacketType.HEARTBEAT, b""))
    assert bench.state("fault") == BoardFault.HEARTBEAT_LOST


def test_a_slow_poll_opens_before_the_limit(new_bench: NewBench) -> None:
    """The time between two polls shortens every deadline, so that 100 ms hold at the pins."""
    bench = new_bench(poll_period=8000)
    bench.charge()
    bench.beating = False
    bench.send((PacketType.HEARTBEAT, b""))
    silent = bench.now
    bench.jump(bench.now + 91 * MS)  # polls that far apart are the worst case
    assert bench.state("contactor") == 1
    bench.jump(bench.now + 8 * MS)
    assert bench.state("contactor") == 0
    assert bench.now - silent <= 100 * MS


@pytest.mark.parametrize("payload", [b"", b"x"])
def test_a_heartbeat_is_never_answered_and_counts_only_when_empty(bench: Bench, payload: bytes) -> None:
    bench.probe()
    assert bench.send((PacketType.HEARTBEAT, payload)) == []
    assert bench.close_contactor() == (AckError.INTERLOCK if payload else AckError.DONE)


def test_a_heartbeat_lost_during_precharge_also_opens(bench: Bench) -> None:
    bench.probe()
    bench.set("force output 0")
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.close_contactor() == 0
    bench.run(100 * MS)
    assert bench.state("precharge") == 0
    assert bench.state("fault") == BoardFault.HEARTBEAT_LOST


@pytest.mark.parametrize(("age", "error"), [(2 * S - 1, 0), (2 * S, 3)])
def test_a_probe_allows_a_close_for_two_seconds(bench: Bench, age: int, error: int) -> None:
    bench.send(PROBE)
    bench.run(150 * MS)
    assert len(acks(bench.packets)) == 1
    bench.run(age)
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.close_contactor() == error


@pytest.mark.parametrize(
    ("resistance", "target", "error"),
    [
        (1.0, 24, 0),
        (1e30, 24, 0),
        (5.0, 0.0, 0),
        (0.999, 24, 3),
        (-2.0, 24, 3),
        (5.0, -0.01, 3),
        (math.inf, 24, 3),
        (-math.inf, 24, 3),
        (math.nan, 24, 3),
        (5.0, math.nan, 3),
    ],
)
def test_what_a_probe_allows(bench: Bench, resistance: float, target: float, error: int) -> None:
    bench.set(f"resistance {resistance}", f"target {target}")
    assert bench.probe().error == 0
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.close_contactor() == error
    assert bench.state("fault") == 0


@pytest.mark.parametrize("bad", ["resistance 0.5", "resistance inf", "target -24"])
def test_a_bad_probe_revokes_the_permission_of_a_good_one(bench: Bench, bad: str) -> None:
    bench.probe()
    bench.set(bad)
    bench.probe()
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.close_contactor() == AckError.INTERLOCK


def test_a_probe_that_never_ends_is_answered_in_time_and_allows_nothing(bench: Bench) -> None:
    bench.set(f"probe_time {2**32 - 1}")
    bench.send(PROBE)
    assert acks(bench.run(249 * MS)) == []
    (answer,) = acks(bench.run(1 * MS))
    assert answer.error == 0
    assert all(math.isnan(number) for number in struct.unpack("<ff", answer.data))
    assert bench.state("probe") == 0
    bench.send((PacketType.HEARTBEAT, b""))
    assert bench.close_contactor() == AckError.INTERLOCK


def test_probe_is_refused_while_closed_while_ramping_down_and_while_one_runs(bench: Bench) -> None:
    bench.set(*STRONG)
    bench.charge()
    assert bench.ask(*PROBE).error == AckError.NOT_NOW
    bench.open()
    assert bench.state("contactor") == 1  # it ramps down
    assert bench.ask(*PROBE).error == AckError.NOT_NOW
    bench.run(60 * MS)
    bench.send(PROBE)
    assert bench.ask(*PROBE).error == AckError.NOT_NOW
    (answer,) = acks(bench.run(200 * MS))
    assert answer.error == 0


def test_no_probe_begins_before_the_coil_is_off(bench: Bench) -> None:
    """Contacts that open early could close again while the coil is still driven."""
    bench.set(*STRONG)
    bench.charge()
    bench.open()
    bench.set("drop 1")
    assert bench.state("contactor") == 0
    assert bench.ask(*PROBE).error == AckError.NOT_NOW
    bench.run(1 * MS)
    assert bench.probe().error == 0


def test_energy_never_depends_on_a_live_host(bench: Bench) -> None:
    """Whatever the commands before, silence opens the contactor."""
    bench.set(*STRONG)
    bench.charge()
    bench.beating = False
    bench.send((PacketType.START, b""), PROBE, (PacketType.TARE, b""), CLOSE)
    for _ in range(10):
        bench.send((PacketType.PING, b"x" * 64), (PacketType.HELLO, b""))
        bench.run(10 * MS)
    assert bench.state("contactor") == 0
    assert bench.state("fault") == BoardFault.HEARTBEAT_LOST
