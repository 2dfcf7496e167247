"""The emulated board against docs/board-link.md, on board time: every `now` is passed in."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from deltacharger_driver.bench_plant import BenchPlant
from deltacharger_driver.board_emulator import BoardEmulator
from deltacharger_driver.board_payloads import Ack, Hello, Power, decode_ack, decode_hello, decode_power, decode_samples
from deltacharger_driver.board_protocol import Fault, Packet, PacketDecoder, PacketType, SampleFormat, encode_packet

STEP = 0.005


class Bench:
    """A board, its plant and a host that only speaks when told; time passes by `run`."""

    def __init__(self, sample_format: SampleFormat = SampleFormat.U12, **plant: float) -> None:
        self.now = 100.0
        self.plant = BenchPlant(clock=lambda: self.now, **plant)  # type: ignore[arg-type]
        self.board = BoardEmulator(self.plant, sample_format, seed=7)
        self.decoder = PacketDecoder()
        self.packets: list[Packet] = []
        self.sequence = 0
        self.beating = False
        self.hear(self.board.poll(self.now))
        self.now += 1e-7  # what is due is due, whatever the last bit of the floats

    def hear(self, data: bytes) -> list[Packet]:
        new = self.decoder.feed(data)
        self.packets += new
        return new

    def send(self, type: int, payload: bytes = b"", version: int = 1) -> list[Packet]:
        self.sequence += 1
        return self.hear(self.board.receive(encode_packet(Packet(type, payload, self.sequence), version), self.now))

    def run(self, seconds: float) -> list[Packet]:
        start = len(self.packets)
        for number in range(round(seconds / STEP)):
            self.now += STEP
            if self.beating and number % 4 == 0:
                self.send(PacketType.HEARTBEAT)
            self.hear(self.board.poll(self.now))
        return self.packets[start:]

    def ack(self, type: int, payload: bytes = b"", wait: float = 0.0) -> Ack:
        packets = self.send(type, payload) + (self.run(wait) if wait else [])
        acks = [decode_ack(p.payload) for p in packets if p.type == PacketType.ACK]
        assert [(a.type, a.sequence) for a in acks if a.type == type][:1] == [(type, self.sequence)] or self.beating
        return next(a for a in acks if a.type == type)

    def error(self, type: int, payload: bytes = b"", wait: float = 0.0) -> int:
        return self.ack(type, payload, wait).error

    def power(self) -> Power:
        return decode_power([p for p in self.packets if p.type == PacketType.POWER][-1].payload)

    def probe(self) -> Ack:
        return self.ack(PacketType.PROBE, wait=0.2)

    def close(self) -> int:
        return self.error(PacketType.CONTACTOR, b"\1")

    def closed(self) -> Bench:
        """Heartbeat, probe, close, and wait until current flows."""
        self.beating = True
        assert self.probe().error == 0
        assert self.close() == 0
        self.run(0.3)
        assert self.power().contactor_closed
        assert self.power().charge_current == pytest.approx(1.0)
        return self


def tactile(packets: list[Packet]) -> list[Packet]:
    return [p for p in packets if p.type == PacketType.TACTILE]


def test_it_introduces_itself_on_boot_and_when_asked() -> None:
    bench = Bench()
    first = bench.packets[0]
    assert (first.type, first.sequence, first.device_time_us) == (PacketType.HELLO, 0, 0)
    hello = decode_hello(first.payload)
    assert hello == Hello(1, 0, 10, 10, hello.boot_id, 120.0)
    bench.run(0.5)
    answer = bench.send(PacketType.HELLO)
    assert [p.type for p in answer] == [PacketType.HELLO, PacketType.ACK]
    assert decode_hello(answer[0].payload) == hello
    assert answer[0].device_time_us == 500_000


def test_power_comes_always_and_tactile_between_start_and_stop() -> None:
    bench = Bench()
    silent = bench.run(1.0)
    assert len(silent) == 20
    assert {p.type for p in silent} == {PacketType.POWER}
    bench.send(PacketType.START)
    streamed = bench.run(1.0)
    assert len(tactile(streamed)) == pytest.approx(120, abs=1)
    assert sum(p.type == PacketType.POWER for p in streamed) == 20
    bench.send(PacketType.STOP)
    assert not tactile(bench.run(0.2))
    bench.send(PacketType.START)
    sequences = [p.sequence for p in tactile(bench.packets)]
    assert sequences == list(range(len(sequences)))  # a stop loses nothing


def test_sampling_instants_are_even_on_the_boards_clock() -> None:
    bench = Bench()
    bench.send(PacketType.START)
    times = [p.device_time_us for p in tactile(bench.run(1.0))]
    assert np.diff(times) == pytest.approx(1e6 / 120, abs=1.5)


@pytest.mark.parametrize("sample_format", [SampleFormat.U8, SampleFormat.U12, SampleFormat.U16])
def test_every_sample_format(sample_format: SampleFormat) -> None:
    bench = Bench(sample_format, offset=0.0, noise=0.0)
    bench.plant.left[0, 0] = 5.0
    bench.plant.right[9, 9] = 50.0
    bench.board.set_dead(1, 0, 9)
    bench.send(PacketType.START)
    packet = tactile(bench.run(0.1))[-1]
    assert packet.format == sample_format
    left, right = decode_samples(packet.payload, packet.format)
    assert left[0, 0] == pytest.approx(5.0, abs=0.03)
    assert right[9, 9] == 10.0
    assert np.argwhere(np.isnan(right)).tolist() == [[0, 9]]
    assert not np.isnan(left).any()


def test_rate() -> None:
    bench = Bench()
    assert bench.error(PacketType.RATE, struct.pack("<f", 50.0)) == 0
    bench.send(PacketType.START)
    assert len(tactile(bench.run(1.0))) == pytest.approx(50, abs=1)
    for bad in (b"", b"\0" * 5, *(struct.pack("<f", hz) for hz in (0.0, -1.0, math.nan, math.inf, 1e6))):
        assert bench.error(PacketType.RATE, bad) == 1
    assert decode_hello(bench.send(PacketType.HELLO)[0].payload).rate == 50.0


def test_tare_subtracts_clips_and_says_so() -> None:
    bench = Bench(offset=0.5, noise=0.05)
    bench.send(PacketType.START)
    before = tactile(bench.run(0.1))[-1]
    assert before.flags == 0
    assert np.mean(decode_samples(before.payload, before.format)) == pytest.approx(0.5, abs=0.03)
    assert bench.error(PacketType.TARE, wait=0.05) == 0
    after = tactile(bench.run(0.1))[-1]
    assert after.flags == 1
    forces = np.stack(decode_samples(after.payload, after.format))
    assert forces.min() == 0.0
    assert forces.mean() < 0.05


def test_tare_is_refused_in_contact_also_where_contact_comes_meanwhile() -> None:
    bench = Bench()
    bench.plant.press(8.0)
    assert bench.error(PacketType.TARE) == 4
    bench.plant.press(0.0)
    bench.send(PacketType.TARE)
    bench.run(0.01)
    bench.plant.press(8.0)
    (ack,) = [decode_ack(p.payload) for p in bench.run(0.05) if p.type == PacketType.ACK]
    assert (ack.type, ack.error) == (PacketType.TARE, 4)
    bench.plant.press(0.0)
    assert bench.error(PacketType.TARE, wait=0.05) == 0


def test_contact_counts_after_the_present_tare_and_ignores_dead_taxels() -> None:
    bench = Bench(offset=0.9)
    assert bench.error(PacketType.TARE, wait=0.05) == 0
    bench.plant.left[5, 5] = 0.5  # 1.4 N raw
    assert bench.error(PacketType.TARE, wait=0.05) == 0
    bench.plant.left[5, 5] = 9.0
    bench.board.set_dead(0, 5, 5)
    assert bench.error(PacketType.TARE, wait=0.05) == 0


def test_the_whole_close() -> None:
    bench = Bench()
    bench.run(0.1)
    assert not bench.power().contactor_closed
    bench.closed()
    assert bench.error(PacketType.CONTACTOR, b"\0") == 0
    bench.run(0.1)
    assert not bench.power().contactor_closed
    assert bench.power().charge_current == 0.0
    assert bench.power().fault == 0


def test_a_probe_is_answered_when_measured() -> None:
    bench = Bench()
    assert not any(p.type == PacketType.ACK for p in bench.send(PacketType.PROBE) + bench.run(0.14))
    (packet,) = [p for p in bench.run(0.1) if p.type == PacketType.ACK]
    ack = decode_ack(packet.payload)
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
    """Bring the board to where one condition of a close fails, and try."""
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
        bench.board.trip(Fault.OVER_CURRENT)
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
    expected = Fault.OVER_CURRENT if case == "latched fault" else Fault.NONE
    assert bench.power().fault == expected  # what a probe finds refuses the close and sets no fault


def test_closing_twice_is_not_now_and_opening_always_works() -> None:
    bench = Bench().closed()
    assert bench.close() == 4
    for _ in range(3):
        assert bench.error(PacketType.CONTACTOR, b"\0") == 0
    assert bench.close() == 3  # the opening voided the probe


@pytest.mark.parametrize("payload", [b"", b"\2", b"\1\0"])
def test_contactor_payloads_that_mean_nothing(payload: bytes) -> None:
    assert Bench().error(PacketType.CONTACTOR, payload) == 1


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
    assert bench.power().fault == Fault.HEARTBEAT_LOST


@pytest.mark.parametrize(("gap", "survives"), [(0.090, True), (0.100, False)])
def test_a_gap_between_heartbeats_of_90_ms_is_survived_and_one_of_100_ms_is_not(gap: float, survives: bool) -> None:
    bench = Bench().closed()
    bench.beating = False
    for _ in range(20):
        bench.send(PacketType.HEARTBEAT)
        bench.now += gap
    assert bench.board.contactor_commanded == survives


def test_a_heartbeat_that_comes_too_late_does_not_save_the_contactor() -> None:
    bench = Bench().closed()
    bench.beating = False
    bench.send(PacketType.HEARTBEAT)
    bench.now += 0.15  # nobody polled meanwhile
    bench.send(PacketType.HEARTBEAT)
    assert not bench.board.contactor_commanded
    assert bench.board.fault == Fault.HEARTBEAT_LOST


def test_the_next_event_is_the_heartbeats_deadline() -> None:
    bench = Bench().closed()
    bench.send(PacketType.HEARTBEAT)
    assert 0.0 < bench.board.next_event(bench.now) <= 0.1


def test_no_heartbeat_while_open_is_no_fault() -> None:
    bench = Bench()
    bench.send(PacketType.HEARTBEAT)
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


def test_the_first_fault_is_kept() -> None:
    bench = Bench().closed()
    bench.board.trip(Fault.SHORT_CIRCUIT)
    bench.board.trip(Fault.OVER_CURRENT)
    assert bench.board.fault == Fault.SHORT_CIRCUIT


def test_a_fault_voids_the_probe() -> None:
    bench = Bench()
    bench.beating = True
    bench.probe()
    bench.board.trip(Fault.OVER_CURRENT)
    bench.send(PacketType.CONTACTOR, b"\0")
    assert bench.close() == 3


def test_an_opening_ends_a_running_probe() -> None:
    bench = Bench()
    bench.send(PacketType.PROBE)
    acks = [decode_ack(p.payload) for p in bench.send(PacketType.CONTACTOR, b"\0")]
    assert {(a.type, a.error) for a in acks} == {(PacketType.CONTACTOR, 0), (PacketType.PROBE, 4)}
    assert not any(p.type == PacketType.ACK for p in bench.run(0.3))


def test_ping_returns_up_to_64_bytes_and_is_not_acknowledged() -> None:
    bench = Bench()
    for size in (0, 64):
        (packet,) = bench.send(PacketType.PING, bytes(range(size)))
        assert (packet.type, packet.payload) == (PacketType.PING, bytes(range(size)))
    assert bench.send(PacketType.PING, bytes(65)) == []
    assert bench.send(PacketType.HEARTBEAT) == []


@pytest.mark.parametrize("type", [0, 1, 2, 10, 13, 255])
def test_a_type_the_board_does_not_know_is_counted_and_answered(type: int) -> None:
    bench = Bench()
    assert bench.error(type) == 2
    assert bench.board.unknown_types == 1


@pytest.mark.parametrize("type", [3, 4, 5, 6, 11])
def test_commands_without_a_value_take_none(type: int) -> None:
    assert Bench().error(type, b"x") == 1


def test_another_version_gets_no_answer_and_is_counted() -> None:
    bench = Bench()
    assert bench.send(PacketType.HELLO, version=2) == []
    assert bench.board.counters.version_errors == 1
    assert bench.board.counters.refused_version == 2


def test_garbage_from_the_host_is_survived() -> None:
    bench = Bench()
    random = np.random.default_rng(0)
    for _ in range(200):
        bench.hear(bench.board.receive(random.bytes(int(random.integers(1, 200))), bench.now))
    bench.hear(bench.board.receive(b"\0", bench.now))
    assert bench.error(PacketType.START) == 0


def test_a_boot_forgets_everything() -> None:
    bench = Bench().closed()
    bench.error(PacketType.CONTACTOR, b"\0")
    bench.send(PacketType.RATE, struct.pack("<f", 60.0))
    bench.send(PacketType.START)
    bench.error(PacketType.TARE, wait=0.1)
    bench.closed()
    first = decode_hello(bench.packets[0].payload)
    bench.board.reboot()
    packets = bench.run(0.2)
    assert packets[0].type == PacketType.HELLO
    assert (packets[0].sequence, packets[0].device_time_us) == (0, 0)
    hello = decode_hello(packets[0].payload)
    assert hello.boot_id != first.boot_id
    assert hello.rate == 120.0
    assert not tactile(packets)
    powers = [p for p in packets if p.type == PacketType.POWER]
    assert [p.sequence for p in powers] == list(range(len(powers)))
    assert powers[0].device_time_us == pytest.approx(50_000, abs=5000)
    assert decode_power(powers[0].payload) == Power(26.0, 24.0, 0.0, False, 0)
    bench.run(0.02)
    assert bench.close() == 3
    bench.send(PacketType.START)
    frame = tactile(bench.run(0.1))[0]
    assert (frame.sequence, frame.flags) == (0, 0)


def test_a_late_poll_sends_what_was_sampled_and_a_very_late_one_says_overrun() -> None:
    bench = Bench()
    bench.send(PacketType.START)
    bench.run(0.1)
    bench.now += 0.1
    late = tactile(bench.hear(bench.board.poll(bench.now)))
    assert len(late) == pytest.approx(12, abs=1)
    assert not any(p.flags & 2 for p in late)
    bench.now += 10.0
    flood = tactile(bench.hear(bench.board.poll(bench.now)))
    assert len(flood) == 16
    assert [bool(p.flags & 2) for p in flood] == [True] + [False] * 15
    assert flood[0].sequence - late[-1].sequence == pytest.approx(1200 - 15, abs=2)


@pytest.mark.parametrize("kind", ["drop", "corrupt", "truncate", "garbage", "duplicate"])
def test_wire_faults_hit_the_packets_they_are_told_to(kind: str) -> None:
    bench = Bench()
    bench.board.faults.inject(kind, 2, PacketType.POWER)
    intact = sum(p.type == PacketType.POWER for p in bench.run(1.0))
    expected = {"drop": 18, "corrupt": 18, "truncate": 18, "garbage": 20, "duplicate": 22}[kind]
    assert intact == expected


def test_a_silent_board_works_on_and_a_deaf_one_loses_its_heartbeat() -> None:
    bench = Bench().closed()
    bench.board.faults.silent = True
    assert bench.run(0.5) == []
    assert bench.board.contactor_commanded
    bench.board.faults.silent = False
    bench.board.faults.deaf = True
    bench.run(0.2)
    assert bench.power().fault == Fault.HEARTBEAT_LOST


def test_an_unknown_wire_fault_is_refused() -> None:
    with pytest.raises(ValueError, match="garbage"):
        Bench().board.faults.inject("gremlins")
