# SPDX-License-Identifier: Apache-2.0
"""BoardLink over a real pseudo-terminal and the emulated board."""

from __future__ import annotations

import math
import os
import termios
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import serial

from deltacharger_driver.board.errors import BoardMismatch, BoardRebooted, CommandRefused
from deltacharger_driver.board.link import BoardLink
from deltacharger_driver.board.port import BoardPort
from deltacharger_driver.board.protocol import AckError, BoardFault, Packet, PacketDecoder, PacketType, encode_packet
from deltacharger_driver.board.receiver import BoardReceiver
from deltacharger_driver.board.requests import BoardRequests
from deltacharger_driver.board.samples import PowerSample, TactileSample
from deltacharger_driver.emulators.bench_plant import BenchPlant
from deltacharger_driver.emulators.board import BoardEmulator
from deltacharger_driver.errors import NoAnswer, PortBusy, PortDenied, PortGone, PortMissing
from deltacharger_driver.pseudo_terminal import PseudoTerminal

from ..waiting import wait_until


class Rig:
    """Board, cable and host."""

    def __init__(self, directory: Path) -> None:
        self.plant = BenchPlant()
        self.board = BoardEmulator(self.plant, seed=3)
        self.frames: list[TactileSample] = []
        self.powers: list[PowerSample] = []
        self.boots: list[float] = []
        self.losses: list[PortGone] = []
        self._path = directory / "board"
        self.cable = PseudoTerminal(self.board, self._path).start()
        self.link = BoardLink(
            str(self._path),
            on_tactile=self.frames.append,
            on_power=self.powers.append,
            on_boot=lambda: self.boots.append(time.monotonic()),
            on_gone=self.losses.append,
        )

    def replug(self) -> None:
        self.cable = PseudoTerminal(self.board, self._path).start()

    def stop(self) -> None:
        self.link.close()
        self.cable.stop()
        assert self.cable.error is None


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    yield rig
    rig.stop()


@pytest.fixture
def link(rig: Rig) -> BoardLink:
    rig.link.open()
    return rig.link


def test_hello_ping_and_rate(link: BoardLink) -> None:
    hello = link.hello()
    assert (hello.major, hello.rows, hello.columns, hello.rate) == (1, 10, 10, 120.0)
    assert 0.0 < link.ping() < 0.2
    assert link.ping(b"x" * 64) > 0.0
    with pytest.raises(ValueError, match="at most 64"):
        link.ping(bytes(65))
    link.set_rate(60.0)
    assert link.hello().rate == 60.0
    with pytest.raises(CommandRefused, match="does not sample at 0 Hz") as refusal:
        link.set_rate(0.0)
    assert refusal.value.error == AckError.BAD_PAYLOAD


def test_frames_are_sampled_now_and_never_lost(rig: Rig, link: BoardLink) -> None:
    link.tare()
    rig.plant.press(8.0)
    link.start()
    wait_until(lambda: len(rig.frames) >= 60)
    link.stop()
    frame = rig.frames[-1]
    assert frame.pads.shape == (2, 10, 10)
    assert frame.pads.dtype == np.float32
    assert frame.pads[0].sum() == pytest.approx(8.0, abs=2.0)
    assert frame.tared
    assert not frame.overrun
    assert [f.sequence for f in rig.frames] == list(range(len(rig.frames)))
    instants = np.array([f.time for f in rig.frames])
    assert np.abs(np.diff(instants[10:]) - 1 / 120).max() < 0.004
    assert link.counters.lost_tactile == 0
    assert link.decoder_counters.damaged == 0
    assert instants[-1] <= time.monotonic()


def test_power_arrives_without_a_request(rig: Rig, link: BoardLink) -> None:
    wait_until(lambda: len(rig.powers) >= 3)
    power = rig.powers[-1].power
    assert (power.battery_voltage, power.contactor_closed, power.fault) == (26.0, False, 0)
    assert power.target_voltage == 24.0


def test_a_tare_in_contact_is_refused_with_advice(rig: Rig, link: BoardLink) -> None:
    rig.plant.press(20.0)
    with pytest.raises(CommandRefused, match="retract first"):
        link.tare()


def test_probe(rig: Rig, link: BoardLink) -> None:
    began = time.monotonic()
    result = link.probe()
    assert (result.resistance, result.target_voltage) == (2.0, 24.0)
    assert 0.14 < result.time - began < 0.4
    rig.plant.resistance = math.inf
    assert math.isinf(link.probe().resistance)


def test_the_heartbeat_lasts_until_its_deadline(rig: Rig, link: BoardLink) -> None:
    assert link.counters.heartbeats == 0
    link.probe()
    with pytest.raises(CommandRefused, match="heartbeat"):
        link.contactor(True)
    until = time.monotonic() + 0.5
    link.keep_alive(until)
    link.contactor(True)
    wait_until(lambda: rig.powers[-1].power.contactor_closed)
    wait_until(lambda: rig.board.fault)
    lag = time.monotonic() - until
    assert rig.board.fault == BoardFault.HEARTBEAT_LOST
    assert 0.0 < lag < 0.2
    assert 15 <= link.counters.heartbeats <= 27
    link.contactor(False)
    wait_until(lambda: rig.powers[-1].power.fault == 0)


def test_stopping_the_heartbeat_opens(rig: Rig, link: BoardLink) -> None:
    link.probe()
    link.keep_alive(math.inf)
    link.contactor(True)
    wait_until(lambda: rig.plant.read_power()[3])
    link.stop_heartbeat()
    stopped = time.monotonic()
    wait_until(lambda: not rig.plant.read_power()[3])
    assert time.monotonic() - stopped < 0.2


def test_closing_the_link_opens_the_contactor(rig: Rig, link: BoardLink) -> None:
    link.probe()
    link.keep_alive(math.inf)
    link.contactor(True)
    link.close()
    wait_until(lambda: rig.board.fault == BoardFault.HEARTBEAT_LOST)


@pytest.mark.parametrize("kind", ["drop", "corrupt", "truncate"])
def test_a_command_with_a_lost_answer_is_repeated(rig: Rig, link: BoardLink, kind: str) -> None:
    rig.board.faults.inject(kind, 1, PacketType.ACK)
    link.start()
    assert 1 <= link.counters.retries <= 3  # on a busy computer a second answer may be late


def test_a_close_with_a_lost_answer_succeeds(rig: Rig, link: BoardLink) -> None:
    link.probe()
    link.keep_alive(math.inf)
    rig.board.faults.inject("drop", 1, PacketType.ACK)
    link.contactor(True)
    assert rig.board.contactor_commanded
    with pytest.raises(CommandRefused, match="already closed"):
        link.contactor(True)


def test_a_missing_answer_is_an_error_after_a_deadline(rig: Rig, link: BoardLink) -> None:
    rig.board.faults.silent = True
    began = time.monotonic()
    with pytest.raises(NoAnswer, match="START within 500 ms"):
        link.start()
    assert time.monotonic() - began < 1.0
    assert isinstance(NoAnswer("", "", 0.0), TimeoutError)


def test_a_noisy_wire_loses_only_frames(rig: Rig, link: BoardLink) -> None:
    rig.board.faults.probability.update(drop=0.05, corrupt=0.05, truncate=0.05, garbage=0.1)
    link.start()
    wait_until(lambda: len(rig.frames) >= 120)
    rig.board.faults.probability.update(drop=0.0, corrupt=0.0, truncate=0.0, garbage=0.0)
    link.stop()
    sequences = [f.sequence for f in rig.frames]
    gaps = sequences[-1] - sequences[0] + 1 - len(sequences)
    assert sequences == sorted(set(sequences))
    assert link.counters.lost_tactile == gaps > 0
    assert link.decoder_counters.damaged > 0


def test_frames_of_a_rebooted_board_keep_rising_and_are_untared(rig: Rig, link: BoardLink) -> None:
    link.tare()
    link.start()
    wait_until(lambda: len(rig.frames) >= 10)
    rig.board.reboot()
    wait_until(lambda: rig.boots)
    before = len(rig.frames)
    link.start()
    wait_until(lambda: len(rig.frames) >= before + 10)
    old, new = rig.frames[before - 1], rig.frames[before]
    assert new.sequence == old.sequence + 1
    assert new.device_time_us < old.device_time_us
    assert (old.tared, new.tared) == (True, False)
    assert new.time > old.time
    assert time.monotonic() - rig.frames[-1].time < 0.1
    assert link.counters.reboots == 1


def test_a_reboot_with_a_lost_hello_is_detected_by_the_clock(rig: Rig, link: BoardLink) -> None:
    wait_until(lambda: rig.powers and rig.powers[-1].time - rig.powers[0].time > 0.7)
    rig.board.faults.inject("drop", 1, PacketType.HELLO)
    rig.board.reboot()
    wait_until(lambda: rig.boots)
    link.hello()
    assert link.counters.reboots == 1


@pytest.mark.parametrize("announced", [True, False], ids=["HELLO", "HELLO lost"])
def test_a_board_that_boots_while_its_port_opens_dates_no_frame_back(announced: bool) -> None:
    board, decoder, frames = BoardEmulator(BenchPlant(), seed=3), PacketDecoder(), list[TactileSample]()
    receiver = BoardReceiver(BoardRequests(), frames.append, None, lambda: None)

    def exchange(now: float, *commands: PacketType) -> None:
        sent = b"".join(encode_packet(Packet(command)) for command in commands)
        for packet in decoder.feed(board.receive(sent, now)):
            receiver.take(packet, now)

    board.poll(10.0)  # the port is not open yet
    exchange(10.06)
    board.reboot()
    if announced:
        exchange(10.1)
    else:
        board.poll(10.1)
    exchange(10.2, PacketType.HELLO, PacketType.START)
    for tick in range(10):
        exchange(10.2 + tick / 120.0)
    assert [frame.time for frame in frames] == pytest.approx([10.2 + tick / 120.0 for tick in range(10)], abs=2e-3)
    assert receiver.counters.reboots == announced


def test_a_command_interrupted_by_a_reboot_reports_it(rig: Rig, link: BoardLink) -> None:
    timer = threading.Timer(0.05, rig.board.reboot)
    timer.start()
    with pytest.raises(BoardRebooted, match="PROBE"):
        link.probe()
    timer.join()


def test_unplugging_ends_every_command_with_port_gone_and_replugging_recovers(rig: Rig, link: BoardLink) -> None:
    link.start()
    wait_until(lambda: len(rig.frames) >= 10)
    pull = threading.Timer(0.05, rig.cable.stop)
    pull.start()
    with pytest.raises(PortGone):
        link.probe()
    pull.join()  # the old terminal removes its link last
    assert len(rig.losses) == 1
    with pytest.raises(PortGone):
        link.start()
    link.close()
    last = rig.frames[-1].sequence
    rig.replug()
    link.open()
    link.start()
    before = len(rig.frames)
    wait_until(lambda: len(rig.frames) > before + 5)
    assert rig.frames[-1].sequence > last
    assert rig.boots == []


def test_a_failing_callback_does_not_end_the_link(tmp_path: Path) -> None:
    board = BoardEmulator(BenchPlant())
    link = BoardLink("", on_power=lambda sample: 1 / 0)  # type: ignore[arg-type, return-value]
    with PseudoTerminal(board) as cable:
        link.port = cable.path
        with link:
            wait_until(lambda: link.counters.callback_errors >= 2)
            link.ping()


def test_a_command_from_a_callback_is_refused() -> None:
    errors: list[str] = []

    def ask(sample: PowerSample) -> None:
        try:
            link.start()
        except RuntimeError as error:
            errors.append(str(error))

    link = BoardLink("", on_power=ask)
    with PseudoTerminal(BoardEmulator(BenchPlant())) as cable:
        link.port = cable.path
        with link:
            wait_until(lambda: errors)
    assert "another thread" in errors[0]


class Puppet:
    """A device that answers every packet with a function."""

    def __init__(self, answer: Callable[[Packet], bytes]) -> None:
        self._answer = answer
        self._decoder = PacketDecoder()
        self.received: list[int] = []

    def receive(self, data: bytes, now: float) -> bytes:
        packets = self._decoder.feed(data)
        self.received += [packet.type for packet in packets]
        return b"".join(self._answer(packet) for packet in packets)

    def poll(self, now: float) -> bytes:
        return b""

    def next_event(self, now: float) -> float:
        return math.inf


@pytest.mark.parametrize(
    ("answer", "error", "words"),
    [
        (lambda p: encode_packet(Packet(PacketType.HELLO, bytes(12)), version=2), BoardMismatch, "speaks version 2"),
        (lambda p: b"Welcome to minicom\r\n", BoardMismatch, "wrong baud rate or device"),
        (lambda p: b"", NoAnswer, "no answer to HELLO"),
        (
            lambda p: (
                encode_packet(Packet(PacketType.HELLO, bytes([2, 1, 10, 10]) + bytes(8)))
                + encode_packet(Packet(PacketType.ACK, bytes([3, 0]) + p.sequence.to_bytes(2, "little")))
            ),
            BoardMismatch,
            r"version 2\.1",
        ),
        (
            lambda p: (
                encode_packet(Packet(PacketType.HELLO, bytes([1, 0, 16, 8]) + bytes(8)))
                + encode_packet(Packet(PacketType.ACK, bytes([3, 0]) + p.sequence.to_bytes(2, "little")))
            ),
            BoardMismatch,
            "16 x 8 taxels",
        ),
    ],
)
def test_an_incompatible_device_is_refused_with_the_reason(
    answer: Callable[[Packet], bytes], error: type[Exception], words: str
) -> None:
    puppet = Puppet(answer)
    with PseudoTerminal(puppet) as cable, pytest.raises(error, match=words):
        BoardLink(cable.path).open()
    assert set(puppet.received) == {PacketType.HELLO}, "an incompatible board receives only HELLO"
    assert len(puppet.received) <= 3


def test_unknown_types_and_bad_payloads_are_counted_and_dropped(link: BoardLink) -> None:
    for type, payload in ((99, b""), (PacketType.START, b""), (PacketType.POWER, b"short"), (PacketType.TACTILE, b"")):
        link._receiver.take(Packet(type, payload, 0, 10**9), time.monotonic())
    assert link.counters.unknown_types == 2
    assert link.counters.bad_payloads == 2


def test_a_sending_board_that_does_not_answer_is_distinguished_from_a_dead_one(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.board.faults.deaf = True
    with pytest.raises(NoAnswer, match="the board sends other packets"):
        rig.link.open()
    rig.board.faults.silent = True
    with pytest.raises(NoAnswer) as silence:
        rig.link.open()
    assert "does not answer" not in str(silence.value)
    rig.stop()


def test_a_missing_port_has_its_own_error() -> None:
    with pytest.raises(PortMissing, match="no such port"):
        BoardLink("/dev/does-not-exist").open()


def test_a_busy_port_has_its_own_error(rig: Rig, link: BoardLink) -> None:
    with pytest.raises(PortBusy, match="another program"):
        BoardLink(rig.link.port).open()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open anything")
def test_a_forbidden_port_has_its_own_error(tmp_path: Path) -> None:
    (tmp_path / "port").touch(mode=0)
    with pytest.raises(PortDenied, match="dialout"):
        BoardLink(str(tmp_path / "port")).open()


@pytest.mark.parametrize(
    "hang_up",
    [serial.SerialException("gone"), OSError(5, "Input/output error"), termios.error(5, "gone"), b""],
    ids=["SerialException", "OSError", "termios.error", "end of file"],
)
def test_every_kind_of_hang_up_is_one_error(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, hang_up: Exception | bytes
) -> None:
    port = BoardPort(rig.link.port, 1_000_000)

    def read(descriptor: int, size: int) -> bytes:
        if isinstance(hang_up, bytes):
            return hang_up
        raise hang_up

    with monkeypatch.context() as patch:
        patch.setattr("deltacharger_driver.board.port.os.read", read)
        wait_until(lambda: _is_gone(port))
    port.close()


def _is_gone(port: BoardPort) -> bool:
    try:
        return port.read(1.0) != b""
    except PortGone:
        return True


def test_closing_twice_is_harmless(link: BoardLink) -> None:
    link.close()
    link.close()
    with pytest.raises(PortGone, match="closed"):
        link.start()
