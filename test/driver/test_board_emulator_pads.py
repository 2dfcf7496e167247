# SPDX-License-Identifier: Apache-2.0
"""The emulated board's tactile arrays against docs/board-link.md: formats, tare, dead taxels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from deltacharger_driver.board.protocol import PacketType, decode_samples

from .board_bench import Bench, acks, tactile


def test_a_frame_has_the_force_of_every_taxel() -> None:
    bench = Bench(offset=0.0, noise=0.0)
    bench.plant.left[0, 0] = 5.0
    bench.plant.right[9, 9] = 50.0
    bench.board.set_dead(1, 0, 9)
    bench.send(PacketType.START)
    packet = tactile(bench.run(0.1))[-1]
    left, right = decode_samples(packet.payload)
    assert left[0, 0] == pytest.approx(5.0, abs=0.03)
    assert right[9, 9] == 10.0
    assert np.argwhere(np.isnan(right)).tolist() == [[0, 9]]
    assert not np.isnan(left).any()


def test_a_tare_is_refused_in_contact_even_if_contact_begins_during_it() -> None:
    bench = Bench()
    bench.plant.press(8.0)
    assert bench.error(PacketType.TARE) == 4
    bench.plant.press(0.0)
    bench.send(PacketType.TARE)
    bench.run(0.01)
    bench.plant.press(8.0)
    (ack,) = acks(bench.run(0.05))
    assert (ack.type, ack.error) == (PacketType.TARE, 4)
    bench.plant.press(0.0)
    assert bench.error(PacketType.TARE, wait=0.05) == 0


def frame(bench: Bench) -> npt.NDArray[np.float32]:
    """Forces of a new frame, (2, 10, 10) N."""
    bench.send(PacketType.START)
    packet = tactile(bench.run(0.1))[-1]
    return np.stack(decode_samples(packet.payload))


def test_a_taxel_dead_during_a_tare_stays_unknown_until_the_next() -> None:
    bench = Bench(offset=0.5, noise=0.0)
    bench.board.set_dead(1, 7, 2)
    assert bench.error(PacketType.TARE, wait=0.05) == 0
    bench.board.set_dead(1, 7, 2, False)
    assert np.argwhere(np.isnan(frame(bench))).tolist() == [[1, 7, 2]]
    assert bench.error(PacketType.TARE, wait=0.05) == 0
    assert frame(bench) == pytest.approx(0.0, abs=0.003)
