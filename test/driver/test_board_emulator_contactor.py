# SPDX-License-Identifier: Apache-2.0
"""The emulated board's contactor against docs/board-link.md: probe, interlocks, heartbeat, latched faults."""

from __future__ import annotations

import math
import struct

import pytest

from deltacharger_driver.board.protocol import BoardFault, Packet, PacketType

from .board_bench import Bench, acks

PROBE, CONTACTOR = PacketType.PROBE, PacketType.CONTACTOR
OPEN, CLOSE, CLEAR_WELD = b"\0", b"\1", b"\2"


def answers(packets: list[Packet]) -> list[tuple[int, int, int]]:
    """Return type, error and sequence of each ACK."""
    return [(ack.type, ack.error, ack.sequence) for ack in acks(packets)]


def test_a_probe_is_answered_when_measured_and_no_other_runs_meanwhile() -> None:
    bench = Bench()
    assert acks(bench.send(PROBE) + bench.run(0.14)) == []
    first = bench.sequence
    assert bench.error(PROBE) == 4
    (ack,) = acks(bench.run(0.1))
    assert (ack.type, ack.error, ack.sequence) == (PROBE, 0, first)
    assert struct.unpack("<ff", ack.data) == (2.0, 24.0)


def test_heartbeat_loss_opens_within_100_ms_and_latches_fault_8() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.send(PacketType.HEARTBEAT)
    silent_since = bench.now
    while bench.board.contactor_commanded:
        bench.now += bench.board.next_event(bench.now) + 1e-6
        bench.board.poll(bench.now)
    assert 0.09 < bench.now - silent_since < 0.1005
    assert not bench.plant.read_power()[3]
    bench.run(0.06)
    assert bench.power().fault == BoardFault.HEARTBEAT_LOST


@pytest.mark.parametrize(("gap", "survives"), [(0.090, True), (0.100, False), (0.15, False)])
def test_a_gap_between_heartbeats_of_90_ms_is_survived_and_one_of_100_ms_is_not(gap: float, survives: bool) -> None:
    bench = Bench().closed()
    bench.beating = False
    for _ in range(20):
        bench.send(PacketType.HEARTBEAT)
        bench.now += gap  # without polls: a late heartbeat does not keep it closed
    assert bench.board.contactor_commanded == survives
    assert bench.board.fault == (BoardFault.NONE if survives else BoardFault.HEARTBEAT_LOST)


def test_a_missing_heartbeat_while_open_is_no_fault() -> None:
    bench = Bench().closed()
    bench.send(CONTACTOR, OPEN)
    bench.beating = False
    bench.run(0.5)
    assert bench.power().fault == 0


@pytest.mark.parametrize("fault", [1, 2, 4, 5, 6, 9])
def test_a_detected_fault_opens_at_once_and_stays_until_the_next_opening_command(fault: int) -> None:
    bench = Bench().closed()
    bench.plant.detected = fault
    bench.run(0.02)
    assert not bench.plant.read_power()[3]
    bench.plant.detected = 0
    bench.run(0.5)
    assert bench.power().fault == fault
    assert bench.error(PROBE) == bench.close() == 3
    bench.send(CONTACTOR, OPEN)
    bench.run(0.1)
    assert bench.power().fault == 0
    assert bench.close() == 3  # the opening voided the probe
    bench.closed()


def test_a_weld_stays_over_openings_and_boots_until_a_person_clears_it() -> None:
    bench = Bench().closed()
    bench.plant.welded = True
    bench.send(CONTACTOR, OPEN)
    bench.run(0.2)
    assert bench.error(CONTACTOR, CLEAR_WELD) == 3  # it is closed
    bench.plant.welded, bench.plant.resistance = False, math.inf
    for forget in (lambda: bench.send(CONTACTOR, OPEN), bench.board.reboot):
        forget()
        bench.run(0.2)
        assert bench.power().fault == BoardFault.CONTACTOR_WELDED
        assert bench.error(PROBE) == bench.close() == 3
    for live in ({"current": 0.5}, {"current": -0.5}, {"current": math.nan}, {"target": 5.0}, {"target": -5.0}):
        bench.plant.measured = live
        bench.run(0.01)
        assert bench.error(CONTACTOR, CLEAR_WELD) == 3
    bench.plant.measured = {"target": 4.9}
    bench.run(0.01)
    assert bench.error(CONTACTOR, CLEAR_WELD) == 0
    bench.board.reboot()
    bench.run(0.2)
    assert bench.power().fault == 0


def test_a_weld_replaces_every_fault_and_none_replaces_it() -> None:
    bench = Bench().closed()
    bench.plant.welded, bench.plant.detected = True, BoardFault.OVER_CURRENT
    bench.run(0.03)
    assert bench.board.fault == BoardFault.OVER_CURRENT
    bench.run(0.12)
    bench.board.trip(BoardFault.SHORT_CIRCUIT)
    assert bench.board.fault == BoardFault.CONTACTOR_WELDED


def test_clearing_a_weld_clears_nothing_else() -> None:
    bench = Bench().closed()
    assert bench.error(CONTACTOR, CLEAR_WELD) == 4
    assert bench.board.contactor_commanded
    bench.board.trip(BoardFault.OVER_CURRENT)
    bench.plant.resistance = math.inf
    bench.run(0.1)
    assert bench.error(CONTACTOR, CLEAR_WELD) == 4
    assert bench.board.fault == BoardFault.OVER_CURRENT
    bench.send(CONTACTOR, OPEN)
    assert bench.error(CONTACTOR, CLEAR_WELD) == 0  # there is none: an answer that was lost is asked for again


def test_no_probe_begins_while_current_flows() -> None:
    bench = Bench()
    for current, error in ((0.5, 3), (-0.5, 3), (0.49, 0)):
        bench.plant.measured = {"current": current}
        assert bench.error(PROBE, wait=0.0 if error else 0.2) == error
        bench.send(CONTACTOR, OPEN)


@pytest.mark.parametrize(("resistance", "target"), [(0.9, 24.0), (math.inf, 24.0), (2.0, -24.0)])
def test_a_bad_probe_forbids_a_close_but_sets_no_fault(resistance: float, target: float) -> None:
    bench = Bench()
    bench.beating, bench.plant.resistance, bench.plant.target = True, resistance, target
    bench.probe()
    assert bench.close() == 3
    bench.run(0.2)
    assert (bench.power().contactor_closed, bench.power().fault) == (False, 0)


def test_a_persisting_fault_is_latched_again_at_once_and_the_first_one_is_kept() -> None:
    bench = Bench()
    bench.plant.detected = BoardFault.SHORT_CIRCUIT
    bench.run(0.11)
    bench.board.trip(BoardFault.OVER_CURRENT)
    assert bench.board.fault == BoardFault.SHORT_CIRCUIT
    bench.send(CONTACTOR, OPEN)
    assert bench.board.fault == 0
    bench.run(0.02)  # before the next POWER
    assert bench.board.fault == BoardFault.SHORT_CIRCUIT


def test_an_opening_ends_a_running_probe_even_if_another_follows_it() -> None:
    bench = Bench()
    bench.send(PROBE)
    first = bench.sequence
    assert set(answers(bench.send(CONTACTOR, OPEN))) == {(CONTACTOR, 0, first + 1), (PROBE, 4, first)}
    assert acks(bench.run(0.3)) == []
    bench.send(PROBE)
    first = bench.sequence
    bench.run(0.05)
    packets = bench.send_together((CONTACTOR, OPEN), (PROBE, b""))
    assert answers(packets) == [(CONTACTOR, 0, first + 1), (PROBE, 4, first)]
    assert answers(bench.run(0.3)) == [(PROBE, 0, first + 2)]


def test_a_close_ends_a_running_probe_before_the_battery_is_connected() -> None:
    bench = Bench()
    bench.beating = True
    assert bench.probe().error == 0
    bench.send(PROBE)
    probing = bench.sequence
    assert answers(bench.send(CONTACTOR, CLOSE)) == [(CONTACTOR, 0, probing + 1), (PROBE, 4, probing)]
    assert acks(bench.run(0.4)) == []
    assert bench.power().contactor_closed


def test_a_refused_close_does_not_end_a_running_probe() -> None:
    bench = Bench()
    bench.beating = True
    bench.run(0.01)
    bench.send(PROBE)
    probing = bench.sequence
    assert bench.close() == 3
    assert answers(bench.run(0.3)) == [(PROBE, 0, probing)]


@pytest.mark.parametrize(("flags", "format"), [(0, 0), (1, 0), (0, 1)])
def test_a_heartbeat_with_flags_or_a_format_is_ignored(flags: int, format: int) -> None:
    bench = Bench()
    assert bench.probe().error == 0
    bench.send(PacketType.HEARTBEAT, flags=flags, format=format)
    assert bench.close() == (3 if flags or format else 0)
