# SPDX-License-Identifier: Apache-2.0
"""The emulated board against docs/board-link.md: boot, frames, tare, probe, interlocks, heartbeat, latched faults."""

import math
import struct
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet
from deltacharger_sim.emulators.power import PortParameters, StageParameters, TargetPort

from .board_bench import LIMITS, Bench, acks, tactile

PROBE, CONTACTOR = protocol.PacketType.PROBE, protocol.PacketType.CONTACTOR
OPEN, CLEAR_WELD = b"\0", b"\2"


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
    ohm, volt = struct.unpack("<ff", ack.data)
    assert (math.isnan(ohm), volt) == (True, 24.0)


@pytest.mark.parametrize(("gap", "survives"), [(0.090, True), (0.100, False)])
def test_a_gap_between_heartbeats_of_90_ms_is_survived_and_one_of_100_ms_is_not(gap: float, survives: bool) -> None:
    bench = Bench().closed()
    bench.beating = False
    for _ in range(20):
        bench.send(protocol.PacketType.HEARTBEAT)
        bench.run(gap)
    assert bench.board.contactor_commanded == survives
    assert bench.board.fault == (protocol.BoardFault.NONE if survives else protocol.BoardFault.HEARTBEAT_LOST)


@pytest.mark.parametrize("fault", [1, 9])
def test_a_detected_fault_opens_at_once_and_stays_until_the_next_opening_command(fault: int) -> None:
    bench = Bench().closed()
    bench.plant.detected = fault
    bench.run(0.02)
    assert not bench.plant.read_power().closed
    bench.plant.detected = 0
    bench.run(0.5)
    assert bench.power().fault == fault
    assert bench.error(PROBE) == bench.close() == 3
    bench.send(CONTACTOR, OPEN)
    bench.run(0.1)
    assert bench.power().fault == 0
    assert bench.error(CONTACTOR, protocol.encode_limit(2.0)) == 4  # it is open
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
        assert bench.power().fault == protocol.BoardFault.CONTACTOR_WELDED
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
    bench.plant.welded, bench.plant.detected = True, protocol.BoardFault.OVER_CURRENT
    bench.run(0.03)
    assert bench.board.fault == protocol.BoardFault.OVER_CURRENT
    bench.run(0.12)
    bench.board.trip(protocol.BoardFault.SHORT_CIRCUIT)
    assert bench.board.fault == protocol.BoardFault.CONTACTOR_WELDED


@pytest.mark.parametrize("dead", [False, True])
def test_a_bad_probe_forbids_a_close_but_sets_no_fault(dead: bool) -> None:
    bench = Bench()
    bench.beating, bench.plant.resistance, bench.plant.target = True, 0.01, -24.0
    bench.probe()
    assert bench.error(CONTACTOR, protocol.encode_close(LIMITS._replace(dead=dead))) == 3
    bench.run(0.2)
    assert (bench.power().contactor_closed, bench.power().fault) == (False, 0)


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


def charging(port: dict[str, float], **limits: float) -> Bench:
    """A board that closes on this port within these limits."""
    bench = Bench()
    bench.beating, bench.plant.resistance, bench.plant.port = True, 0.01, TargetPort(PortParameters(**port))
    bench.probe()
    assert bench.error(CONTACTOR, protocol.encode_close(LIMITS._replace(**limits))) == 0
    return bench


@pytest.mark.parametrize(("current", "voltage", "flows", "shown"), [(4.0, 29.4, 4.0, 24.64), (18.0, 25.0, 6.25, 25.0)])
def test_current_and_voltage_stay_within_the_limits_of_the_closing(
    current: float, voltage: float, flows: float, shown: float
) -> None:
    bench = charging({}, current=current, voltage=voltage)
    bench.run(1.0)
    assert bench.power().charge_current == pytest.approx(flows, rel=0.01)
    assert bench.power().target_voltage == pytest.approx(shown, abs=0.01)
    assert bench.error(CONTACTOR, protocol.encode_limit(2.0)) == 0
    bench.run(0.1)
    assert bench.power().charge_current == pytest.approx(2.0)


@pytest.mark.parametrize(("gap", "survives"), [(0.15, True), (0.3, False)])
def test_a_gap_is_tolerated_for_its_time_and_current_ramps_again_from_one_ampere(gap: float, survives: bool) -> None:
    port = {"gap_time": gap, "gap_period": 0.5, "gaps": 1}
    bench = charging(port, current=10.0, gap_time=0.2)
    bench.run(0.55)
    assert bench.power().charge_current > 9.0
    packets = bench.run(gap + 0.15)
    powers = [protocol.decode_power(p.payload) for p in packets if p.type == protocol.PacketType.POWER]
    assert powers[-1].contactor_closed == survives
    assert powers[-1].fault == (0 if survives else protocol.BoardFault.NO_CHARGE_CURRENT)
    assert min(p.least_current for p in powers) == 0.0
    assert not survives or any(0.5 < p.charge_current < 9.0 for p in powers)


NAN = math.nan


@pytest.mark.parametrize(
    ("readings", "after", "fault"),
    [
        ({"current": 20.1}, 0.0, 9),
        ({"current": -5.1}, 0.0, 6),
        ({"current": -0.6}, 0.1, 6),
        ({"target": -1.0}, 0.0, 4),
        ({"target": 1.9, "current": 5.0}, 0.0, 2),
        ({"target": 29.8}, 0.1, 5),
        ({"target": 9.9}, 0.1, 5),
        ({"battery": 29.9}, 0.1, 5),
        ({"battery": 22.6}, 5.0, 5),
        ({"target": NAN}, 0.1, 3),
        ({"battery": NAN}, 0.1, 3),
        ({"current": NAN}, 0.1, 3),
        ({"current": 0.04}, 0.2, 1),
    ],
)
def test_a_bad_reading_opens_in_time_and_a_shorter_one_does_not(
    readings: dict[str, float], after: float, fault: int
) -> None:
    bench = charging({}, current=5.0)
    bench.run(0.5)
    if after:
        bench.plant.measured = readings
        bench.run(after - 0.02)
        bench.plant.measured = {}
        bench.run(0.02)
        assert bench.board.contactor_commanded
    bench.plant.measured = readings
    bench.run(after + 0.02)
    assert (bench.board.contactor_commanded, bench.board.fault) == (False, fault)
    assert not bench.plant.read_power().closed


def test_an_unknown_current_does_not_end_a_gap() -> None:
    bench = charging({}, current=5.0, gap_time=0.2)
    bench.run(0.5)
    for current, seconds in ((0.0, 0.15), (NAN, 0.07), (0.0, 0.02)):
        bench.plant.measured = {"current": current}
        bench.run(seconds)
    assert bench.board.fault == protocol.BoardFault.NO_CHARGE_CURRENT


@pytest.mark.parametrize(
    ("readings", "fault"),
    [
        ({"output": 20.0}, 5),
        ({"output": NAN}, 3),
        ({"target": NAN}, 1),
        ({"target": -24.0}, 4),
        ({"target": 9.0}, 5),
        ({"target": 29.5}, 5),
    ],
)
def test_a_close_that_cannot_be_completed_ends_with_its_fault(readings: dict[str, float], fault: int) -> None:
    bench = charging({})
    bench.plant.measured = readings
    bench.run(0.7)
    assert (bench.board.contactor_commanded, bench.board.fault) == (False, fault)
    assert not bench.plant.read_power().closed


@pytest.mark.parametrize(
    ("port", "start", "closed", "fault"),
    [
        ({"diode": 0.4}, 3.0, True, 0),
        ({"wake_voltage": 15.0, "wake_time": 1.5}, 3.0, True, 0),
        ({"wake_voltage": 15.0, "wake_time": 3.5}, 3.0, False, 1),
        ({"voltage": 0.0, "capacitor": 0.01, "power": 60.0, "wake_voltage": 18.0}, 3.0, True, 0),
        ({"voltage": 0.0, "bleeder": 1.5}, 1.0, False, 2),
    ],
)
def test_a_dead_port_gets_half_an_ampere_until_it_takes_current(
    port: dict[str, float], start: float, closed: bool, fault: int
) -> None:
    bench = charging(port, dead=True, current=5.0, start_time=start)
    powers = [protocol.decode_power(p.payload) for p in bench.run(0.2) if p.type == protocol.PacketType.POWER]
    assert max(p.charge_current for p in powers) <= 0.5 + 1e-6
    bench.run(4.0)
    assert (bench.power().contactor_closed, bench.power().fault) == (closed, fault)
    assert not closed or bench.power().charge_current > 1.0


def stage(**parameters: Any) -> Bench:
    """A probed board with a heartbeat and this power stage."""
    bench = Bench(hooks={"stage": StageParameters(**parameters)})
    bench.beating, bench.plant.resistance = True, 0.01
    bench.probe()
    return bench


@pytest.mark.parametrize(("target", "fault"), [(25.4, 0), (25.6, 5)])
def test_a_stage_that_steps_down_refuses_a_target_near_its_battery(target: float, fault: int) -> None:
    bench = stage(steps_up=False)
    bench.plant.target = target
    assert bench.close() == 0
    bench.run(0.3)
    assert (bench.power().contactor_closed, bench.power().fault) == (not fault, fault)


def test_a_constant_voltage_above_the_limit_is_refused() -> None:
    assert [stage(stage_voltage=voltage).close() for voltage in (29.49, 29.51)] == [0, 3]


def test_the_output_is_limited_so_that_the_input_stays_within_its_fuse() -> None:
    bench = stage(input_fuse=10.0)
    bench.error(CONTACTOR, protocol.encode_close(LIMITS._replace(current=18.0)))
    bench.run(1.0)
    power = bench.power()
    assert power.charge_current * power.target_voltage == pytest.approx(0.9 * 10.0 * 26.0, rel=0.02)


def test_a_boot_resets_everything() -> None:
    bench = Bench().closed()
    bench.error(protocol.PacketType.CONTACTOR, b"\0")
    bench.send(protocol.PacketType.RATE, struct.pack("<f", 60.0))
    bench.send(protocol.PacketType.START)
    bench.error(protocol.PacketType.TARE, wait=0.1)
    bench.closed()
    first = protocol.decode_hello(bench.packets[0].payload)
    assert first[:7] == (1, 2, 10, 10, first.boot_id, 120.0, True)
    assert math.isnan(first.stage_voltage), "the board sets it"
    bench.board.reboot()
    packets = bench.run(0.2)
    assert packets[0].type == protocol.PacketType.HELLO
    assert (packets[0].sequence, packets[0].device_time_us) == (0, 0)
    hello = protocol.decode_hello(packets[0].payload)
    assert hello.boot_id != first.boot_id
    assert hello.rate == 120.0
    assert not tactile(packets)
    powers = [p for p in packets if p.type == protocol.PacketType.POWER]
    assert [p.sequence for p in powers] == list(range(len(powers)))
    assert powers[0].device_time_us == pytest.approx(50_000, abs=5000)
    assert protocol.decode_power(powers[0].payload) == protocol.Power(26.0, 24.0, 0.0, False, 0, 0.0)
    bench.run(0.02)
    assert bench.close() == 3
    bench.send(protocol.PacketType.START)
    frame = tactile(bench.run(0.1))[0]
    assert (frame.sequence, frame.flags) == (0, 0)


def test_a_frame_has_the_force_of_every_taxel() -> None:
    bench = Bench(offset=0.0, noise=0.0)
    bench.plant.left[0, 0] = 5.0
    bench.plant.right[9, 9] = 50.0
    bench.board.set_dead(1, 0, 9)
    bench.send(protocol.PacketType.START)
    packet = tactile(bench.run(0.1))[-1]
    left, right = protocol.decode_samples(packet.payload)
    assert left[0, 0] == pytest.approx(5.0, abs=0.03)
    assert right[9, 9] == 10.0
    assert np.argwhere(np.isnan(right)).tolist() == [[0, 9]]
    assert not np.isnan(left).any()


def test_a_tare_is_refused_in_contact_even_if_contact_begins_during_it() -> None:
    bench = Bench()
    bench.plant.press(8.0)
    assert bench.error(protocol.PacketType.TARE) == 4
    bench.plant.press(0.0)
    bench.send(protocol.PacketType.TARE)
    bench.run(0.01)
    bench.plant.press(8.0)
    (ack,) = acks(bench.run(0.05))
    assert (ack.type, ack.error) == (protocol.PacketType.TARE, 4)
    bench.plant.press(0.0)
    assert bench.error(protocol.PacketType.TARE, wait=0.05) == 0


def frame(bench: Bench) -> npt.NDArray[np.float32]:
    """Forces of a new frame, (2, 10, 10) N."""
    bench.send(protocol.PacketType.START)
    packet = tactile(bench.run(0.1))[-1]
    return np.stack(protocol.decode_samples(packet.payload))


def test_a_taxel_dead_during_a_tare_stays_unknown_until_the_next() -> None:
    bench = Bench(offset=0.5, noise=0.0)
    bench.board.set_dead(1, 7, 2)
    assert bench.error(protocol.PacketType.TARE, wait=0.05) == 0
    bench.board.set_dead(1, 7, 2, False)
    assert np.argwhere(np.isnan(frame(bench))).tolist() == [[1, 7, 2]]
    assert bench.error(protocol.PacketType.TARE, wait=0.05) == 0
    assert frame(bench) == pytest.approx(0.0, abs=0.003)
