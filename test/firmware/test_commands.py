# SPDX-License-Identifier: Apache-2.0
"""Answers, tare and floods on the firmware, in simulated time; more of them in test_emulator_suite.py."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from deltacharger_driver.board import protocol

from .bench import LIMITS, MS, Bench

NewBench = Callable[..., Bench]


def load(bench: Bench, forces: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    bench.set(f"pads {forces.astype('<f4').tobytes().hex()}")


@pytest.mark.parametrize(("force", "taxels", "error"), [(0.999, 1, 0), (1.001, 1, 4), (math.nan, 43, 0)])
@pytest.mark.parametrize("offset", [0.3, -0.8])
def test_one_newton_on_one_taxel_is_contact_and_a_dead_pad_is_none(
    new_bench: NewBench, offset: float, force: float, taxels: int, error: int
) -> None:
    bench = new_bench(noise=0, offset=offset)
    for tared in (False, True):
        forces = np.zeros(200)
        load(bench, forces)
        if tared:
            assert bench.ask(protocol.PacketType.TARE, wait=40 * MS).error == 0
        forces[157 : 157 + taxels] = force
        load(bench, forces)
        assert bench.ask(protocol.PacketType.TARE, wait=40 * MS).error == error


def test_the_heartbeat_still_counts_in_a_flood_of_garbage(bench: Bench) -> None:
    source = random.Random(5)
    bench.charge()
    for _ in range(30):
        garbage = source.randbytes(source.randrange(1, 60_000)) + b"\0"
        bench.host.sent(f"wire {garbage.hex()}")
        bench.run(20 * MS)
    bench.check(commanded=1)
    assert bench.ask(protocol.PacketType.STOP).error == 0


def bad_contactor() -> Iterator[bytes]:
    """Payloads of CONTACTOR that are not in its table."""
    good = protocol.encode_close(LIMITS)
    yield from (b"", b"\1", b"\3", b"\4", b"\0\0", good[:-1], good + b"\0", b"\0" + good[1:], b"\3" + good[1:])
    yield from (
        b"\1\2" + good[2:],
        b"\1\0\1" + good[3:],
        b"\1\0\0\1" + good[4:],
        b"\2" + protocol.encode_limit(5.0)[1:],
    )
    for name, (low, high) in protocol.LIMITS.items():
        for value in (math.nan, math.inf, -1.0, 0.99 * low, 1.01 * high):
            yield protocol.encode_close(LIMITS._replace(**{name: value}))
    for current in (math.nan, math.inf, -1.0, 0.0, 30.1):
        yield protocol.encode_limit(current)


def test_a_bad_contactor_command_changes_nothing(bench: Bench) -> None:
    bench.probe()
    bench.beat()
    for payload in bad_contactor():
        assert bench.ask(protocol.PacketType.CONTACTOR, payload).error == protocol.AckError.BAD_PAYLOAD, payload.hex()
    bench.check(commanded=0, fault=0)
    assert bench.close_contactor() == 0
    for payload in bad_contactor():
        assert bench.ask(protocol.PacketType.CONTACTOR, payload).error == protocol.AckError.BAD_PAYLOAD, payload.hex()
    bench.check(commanded=1, fault=0)


def test_power_carries_mean_and_least_current_since_the_last(bench: Bench) -> None:
    bench.charge()
    bench.run(-bench.now % (50 * MS))
    for current, duration in (("2", 10), ("-0.4", 2), ("nan", 10), ("5", 28)):
        bench.set(f"force current {current}")
        bench.run(duration * MS)
    mean = (10 * 2.0 - 2 * 0.4 + 28 * 5.0) / 40.0
    assert bench.power().charge_current == pytest.approx(mean, abs=0.15)
    assert bench.power().least_current == pytest.approx(-0.4)
    bench.set("force current nan")
    bench.run(50 * MS)
    assert math.isnan(bench.power().charge_current)
    assert math.isnan(bench.power().least_current)
    bench.set("force current 3")
    bench.run(50 * MS)
    assert bench.power()[2::3] == (3.0, 3.0)
