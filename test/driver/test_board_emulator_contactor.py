# SPDX-License-Identifier: Apache-2.0
"""The emulated board's contactor against docs/board-link.md: probe, interlocks, heartbeat, latched faults."""

from __future__ import annotations

import math
import struct

import pytest

from deltacharger_driver.board.protocol import BoardFault, PacketType

from .board_bench import Bench, acks


def test_a_probe_is_answered_when_measured() -> None:
    bench = Bench()
    assert acks(bench.send(PacketType.PROBE) + bench.run(0.14)) == []
    (ack,) = acks(bench.run(0.1))
    assert (ack.type, ack.error, ack.sequence) == (PacketType.PROBE, 0, bench.sequence)
    assert struct.unpack("<ff", ack.data) == (2.0, 24.0)


def test_one_probe_at_a_time_and_none_while_closed() -> None:
    bench = Bench()
    bench.send(PacketType.PROBE)
    assert bench.error(PacketType.PROBE) == 4
    bench.run(0.2)
    bench.closed()
    assert bench.error(PacketType.PROBE) == 4


def interlock(bench: Bench, case: str) -> int:
    """Make one condition of a close fail, and try to close."""
    bench.beating = case != "no heartbeat"
    if case == "short":
        bench.plant.resistance = 0.9
    elif case == "open circuit":
        bench.plant.resistance = math.inf
    elif case == "reverse polarity":
        bench.plant.target = -24.0
    if case != "no probe":
        bench.probe()
    if case == "old probe":
        bench.run(2.0)
    elif case == "voided probe":
        bench.send(PacketType.CONTACTOR, b"\0")
    elif case == "latched fault":
        bench.board.trip(BoardFault.OVER_CURRENT)
        bench.probe()
    elif case == "lost heartbeat":
        bench.beating = False
        bench.run(0.11)
    bench.run(0.02 if bench.beating else 0.0)
    return bench.close()


@pytest.mark.parametrize(
    ("case", "error"),
    [
        ("everything right", 0),
        ("no heartbeat", 3),
        ("lost heartbeat", 3),
        ("no probe", 3),
        ("old probe", 3),
        ("voided probe", 3),
        ("latched fault", 3),
        ("short", 3),
        ("open circuit", 3),
        ("reverse polarity", 3),
    ],
)
def test_interlocks_of_a_close(case: str, error: int) -> None:
    bench = Bench()
    assert interlock(bench, case) == error
    bench.run(0.2)
    assert bench.power().contactor_closed == (error == 0)
    expected = BoardFault.OVER_CURRENT if case == "latched fault" else BoardFault.NONE
    assert bench.power().fault == expected  # a bad probe forbids the close but sets no fault


def test_closing_twice_is_not_now_and_opening_always_works() -> None:
    bench = Bench().closed()
    assert bench.close() == 4
    for _ in range(3):
        assert bench.error(PacketType.CONTACTOR, b"\0") == 0
    assert bench.close() == 3  # the opening voided the probe


def test_heartbeat_loss_opens_within_100_ms_and_latches_fault_8() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.send(PacketType.HEARTBEAT)
    silent_since = bench.now
    while bench.board.contactor_commanded:
        bench.now += 0.001
        bench.board.poll(bench.now)
        assert bench.now - silent_since < 0.1005
    assert bench.now - silent_since > 0.09
    assert not bench.plant.read_power()[3]
    bench.run(0.06)
    assert bench.power().fault == BoardFault.HEARTBEAT_LOST


@pytest.mark.parametrize(("gap", "survives"), [(0.090, True), (0.100, False)])
def test_a_gap_between_heartbeats_of_90_ms_is_survived_and_one_of_100_ms_is_not(gap: float, survives: bool) -> None:
    bench = Bench().closed()
    bench.beating = False
    for _ in range(20):
        bench.send(PacketType.HEARTBEAT)
        bench.now += gap
    assert bench.board.contactor_commanded == survives


def test_a_late_heartbeat_does_not_keep_the_contactor_closed() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.send(PacketType.HEARTBEAT)
    bench.now += 0.15  # without polls
    bench.send(PacketType.HEARTBEAT)
    assert not bench.board.contactor_commanded
    assert bench.board.fault == BoardFault.HEARTBEAT_LOST


def test_a_missing_heartbeat_while_open_is_no_fault() -> None:
    bench = Bench()
    bench.send(PacketType.HEARTBEAT)
    bench.run(0.5)
    assert bench.power().fault == 0
    bench.closed()
    bench.send(PacketType.CONTACTOR, b"\0")
    bench.beating = False
    bench.run(0.5)
    assert bench.power().fault == 0


@pytest.mark.parametrize("fault", [1, 2, 4, 5, 6, 7, 9])
def test_a_detected_fault_opens_at_once_and_stays_until_the_next_opening_command(fault: int) -> None:
    bench = Bench().closed()
    bench.plant.detected = fault
    bench.run(0.02)
    assert not bench.plant.read_power()[3]
    bench.plant.detected = 0
    bench.run(0.5)
    assert bench.power().fault == fault
    bench.probe()
    assert bench.close() == 3
    bench.send(PacketType.CONTACTOR, b"\0")
    bench.run(0.1)
    assert bench.power().fault == 0
    bench.closed()


def test_a_fault_that_persists_after_an_opening_command_is_latched_again_at_once() -> None:
    bench = Bench()
    bench.plant.detected = BoardFault.SHORT_CIRCUIT
    bench.run(0.11)
    assert bench.board.fault == BoardFault.SHORT_CIRCUIT
    bench.send(PacketType.CONTACTOR, b"\0")
    assert bench.board.fault == 0
    bench.run(0.02)  # before the next POWER
    assert bench.board.fault == BoardFault.SHORT_CIRCUIT


def test_the_first_fault_is_kept() -> None:
    bench = Bench().closed()
    bench.board.trip(BoardFault.SHORT_CIRCUIT)
    bench.board.trip(BoardFault.OVER_CURRENT)
    assert bench.board.fault == BoardFault.SHORT_CIRCUIT


def test_a_fault_voids_the_probe() -> None:
    bench = Bench()
    bench.beating = True
    bench.probe()
    bench.board.trip(BoardFault.OVER_CURRENT)
    bench.send(PacketType.CONTACTOR, b"\0")
    assert bench.close() == 3


def test_an_opening_ends_a_running_probe() -> None:
    bench = Bench()
    bench.send(PacketType.PROBE)
    answers = acks(bench.send(PacketType.CONTACTOR, b"\0"))
    assert {(a.type, a.error) for a in answers} == {(PacketType.CONTACTOR, 0), (PacketType.PROBE, 4)}
    assert acks(bench.run(0.3)) == []


def test_a_close_ends_a_running_probe_before_the_battery_is_connected() -> None:
    bench = Bench()
    bench.beating = True
    assert bench.probe().error == 0
    bench.send(PacketType.PROBE)
    probing = bench.sequence
    answers = acks(bench.send(PacketType.CONTACTOR, b"\1"))
    assert [(a.type, a.error, a.sequence) for a in answers] == [
        (PacketType.CONTACTOR, 0, bench.sequence),
        (PacketType.PROBE, 4, probing),
    ]
    assert acks(bench.run(0.4)) == []
    assert bench.power().contactor_closed


def test_a_refused_close_does_not_end_a_running_probe() -> None:
    bench = Bench()
    bench.beating = True
    bench.run(0.01)
    bench.send(PacketType.PROBE)
    probing = bench.sequence
    assert bench.close() == 3
    assert [(a.type, a.error, a.sequence) for a in acks(bench.run(0.3))] == [(PacketType.PROBE, 0, probing)]


def test_an_opening_and_a_probe_sent_together_still_answer_the_first_probe() -> None:
    bench = Bench()
    bench.send(PacketType.PROBE)
    first = bench.sequence
    bench.run(0.05)
    answers = acks(bench.send_together((PacketType.CONTACTOR, b"\0"), (PacketType.PROBE, b"")))
    assert [(a.type, a.error, a.sequence) for a in answers] == [
        (PacketType.CONTACTOR, 0, first + 1),
        (PacketType.PROBE, 4, first),
    ]
    assert [(a.type, a.error, a.sequence) for a in acks(bench.run(0.3))] == [(PacketType.PROBE, 0, first + 2)]


@pytest.mark.parametrize(("flags", "format"), [(0, 0), (1, 0), (0, 1)])
def test_a_heartbeat_with_flags_or_a_format_is_ignored(flags: int, format: int) -> None:
    bench = Bench()
    assert bench.probe().error == 0
    bench.send(PacketType.HEARTBEAT, flags=flags, format=format)
    assert bench.close() == (3 if flags or format else 0)
