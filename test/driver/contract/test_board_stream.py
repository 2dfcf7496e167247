# SPDX-License-Identifier: Apache-2.0
"""Laws of a healthy board with untouched pads, whose contactor is not closed: frames and power."""

import math
import statistics
import time
from itertools import pairwise

import numpy as np
import pytest

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_driver.board import protocol
from deltacharger_driver.port_identity import identify

from ...waiting import wait_until
from .host import BoardHost
from .sites import BoardSite

STRETCH = 40  # frames
SETTLED = 30  # frames whose stamps must follow the board's clock
STAMP_STEP = 0.002  # s
PAUSE = 0.08  # s without a frame, after which a pseudo-terminal loses some
RESTING = 0.05  # N, median of a tared pad


def seconds(frames: list[protocol.TactileSample]) -> float:
    """Time from the first to the last frame on the board's clock."""
    return (frames[-1].device_time_us - frames[0].device_time_us) * 1e-6


def test_the_port_is_identified_as_the_board(board_site: BoardSite) -> None:
    found = identify(board_site.path, speeds=())
    assert found.kind == "board", found.details


@pytest.mark.parametrize("rate", [30.0, 120.0])
def test_frames_have_the_requested_rate_on_the_boards_clock(host: BoardHost, rate: float) -> None:
    host.link.set_rate(rate)
    assert host.link.hello().rate == rate
    frames = host.stream(24)
    # The median over half the frames: this computer reads single ones late, by some milliseconds.
    ends = zip(frames, frames[12:], strict=False)
    period = statistics.median(seconds([a, b]) / (b.sequence - a.sequence) for a, b in ends)
    assert 1.0 / period == pytest.approx(rate, rel=0.02)


def test_an_unsupported_rate_is_refused_and_the_old_one_stays(host: BoardHost) -> None:
    host.link.set_rate(60.0)
    for rate in (0.0, -60.0, 1e6):
        with pytest.raises(protocol.CommandRefused) as refusal:
            host.link.set_rate(rate)
        assert refusal.value.error == protocol.AckError.BAD_PAYLOAD
    assert host.link.hello().rate == 60.0


def test_no_frame_is_lost_damaged_or_repeated(host: BoardHost, board_site: BoardSite) -> None:
    counters, decoder = host.link.counters, host.link.decoder_counters
    first = host.stream(STRETCH)
    arrivals = list(host.arrivals)
    frames = first + host.stream(STRETCH)  # numbers continue over stop and start
    assert all(earlier.device_time_us < later.device_time_us for earlier, later in pairwise(frames))
    assert host.link.counters.duplicates == counters.duplicates
    kept_up = max(np.diff([*arrivals, *host.arrivals])) <= PAUSE
    missing = [b.sequence for a, b in pairwise(frames) if b.sequence != a.sequence + 1 and not b.overrun]
    if kept_up or board_site.real:  # else this computer did not take the emulator's bytes in time
        assert (missing, host.link.decoder_counters.damaged) == ([], decoder.damaged)
    assert not board_site.real or not any(frame.overrun for frame in frames), "the board does not keep up"
    assert host.link.counters.bad_payloads == 0


def test_stamps_on_the_hosts_clock_follow_the_boards_clock(host: BoardHost) -> None:
    host.link.start()

    def settled() -> bool:
        frames = host.frames[-SETTLED:]
        steps = np.diff([frame.time for frame in frames])
        of_board = np.diff([frame.device_time_us * 1e-6 for frame in frames])
        return len(frames) == SETTLED and bool((steps > 0.0).all() and (np.abs(steps - of_board) < STAMP_STEP).all())

    wait_until(settled, f"{SETTLED} frames whose stamps follow the board's clock within {STAMP_STEP * 1e3:g} ms")
    host.link.stop()
    assert all(frame.time <= arrival for frame, arrival in zip(host.frames, host.arrivals, strict=True))


def test_it_streams_between_start_and_stop_only(host: BoardHost) -> None:
    host.next_powers(2)
    assert host.frames == []

    first = host.stream(20)
    host.next_powers(2)
    assert len(host.frames) == len(first)
    host.link.start()
    host.link.start()  # harmless while it streams
    again = host.stream(20)
    assert again[0].sequence > first[-1].sequence
    host.link.stop()
    host.link.stop()


def test_a_taxel_is_dead_always_or_never(host: BoardHost, board_site: BoardSite) -> None:
    forces = np.array([frame.pads for frame in host.stream(STRETCH)])
    dead = np.isnan(forces)
    assert (dead.all(axis=0) == dead.any(axis=0)).all()
    alive = ~dead[0]
    assert alive.any(axis=(1, 2)).all(), "a pad has no live taxel; check its cable"
    assert (forces[:, alive] >= 0.0).all()
    assert (forces[:, alive] <= protocol.FULL_SCALE).all()
    if board_site.dead is not None:
        assert {tuple(map(int, place)) for place in np.argwhere(~alive)} == board_site.dead


def test_a_tare_brings_untouched_pads_to_zero_and_flags_every_frame(host: BoardHost) -> None:
    host.link.tare()
    frames = host.stream(STRETCH)
    assert all(frame.tared for frame in frames)
    for pad, side in enumerate(("left", "right")):
        forces = np.array([frame.pads[pad] for frame in frames])
        assert np.nanmedian(forces) < RESTING, f"{side} pad"
        assert np.nanmax(forces) < CONTACT_FORCE, f"{side} pad"


def test_a_second_host_finds_the_board_in_the_state_left_by_the_first(host: BoardHost) -> None:
    boot = host.link.hello().boot_id
    host.link.tare()
    before = host.stream(5)[-1]
    host.link.close()
    same = host.link.open().boot_id == boot  # some boards boot when their port is opened
    after = host.stream(5)[0]
    assert after.tared == same
    assert after.sequence > before.sequence
    assert not same or after.device_time_us > before.device_time_us


LARGEST_VOLTAGE = 60.0  # V
LEAKAGE = 0.5  # A, largest reading with an open contactor


def test_power_is_sent_at_its_rate_with_possible_values(host: BoardHost) -> None:
    samples = host.next_powers(12)
    steps = [later.time - earlier.time for earlier, later in pairwise(samples)]
    assert statistics.median(steps) * protocol.POWER_RATE == pytest.approx(1.0, rel=0.05)
    assert host.link.counters.lost_power == 0
    for power in (sample.power for sample in samples):
        assert power.contactor_closed is False
        assert power.fault == protocol.BoardFault.NONE
        assert math.isnan(power.battery_voltage) or 0.0 < power.battery_voltage < LARGEST_VOLTAGE
        assert math.isnan(power.target_voltage) or abs(power.target_voltage) < LARGEST_VOLTAGE
        assert math.isnan(power.charge_current) or abs(power.charge_current) < LEAKAGE


def test_a_probe_answers_in_time_and_another_may_follow(host: BoardHost, board_site: BoardSite) -> None:
    for _ in range(3):
        began = time.monotonic()
        result = host.link.probe()
        assert began < result.time <= time.monotonic()
        assert result.resistance >= 0.0, "the board measured nothing"
        assert math.isnan(result.target_voltage) or abs(result.target_voltage) < LARGEST_VOLTAGE
    assert not board_site.real or host.link.counters.retries == 0  # this computer may pause
    assert all(sample.power.fault == protocol.BoardFault.NONE for sample in host.next_powers(2))


def test_a_probe_in_free_air_finds_an_open_circuit(
    host: BoardHost, board_site: BoardSite, load_connected: bool
) -> None:
    if board_site.real and load_connected:
        pytest.skip("with --close-contactor a load is connected to the electrodes")
    assert math.isinf(host.link.probe().resistance), "the electrodes must touch nothing"
