# SPDX-License-Identifier: Apache-2.0
"""The firmware's codec against the driver's, byte for byte and in both directions."""

import random
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from deltacharger_driver.board import protocol
from deltacharger_driver.packets import Packet, PacketDecoder, encode_packet

from .codec_process import CodecProcess


@pytest.fixture(scope="module")
def codec(core: Path) -> Iterator[CodecProcess]:
    codec = CodecProcess(core / "codec")
    yield codec
    codec.close()


def assert_same(codec: CodecProcess, chunks: list[bytes]) -> list[Packet]:
    """Feed a stream to both decoders and return what both accepted; both count the same."""
    codec.new_decoder()
    theirs = PacketDecoder()
    accepted = []
    for chunk in chunks:
        expected = theirs.feed(chunk)
        assert codec.feed(chunk) == expected
        accepted += expected
    met = theirs.counters
    refused = -1 if met.refused_version is None else met.refused_version
    decoded, cobs, crc, length, version, header, last = codec.counters()
    assert (decoded, cobs + crc + length + header, version, last) == (
        met.packets,
        met.damaged,
        met.version_errors,
        refused,
    )
    return accepted


def random_packet(source: random.Random, type: int | None = None, size: int | None = None) -> Packet:
    """A packet whose payload is all zeros, has none, or is mixed: the cases of COBS."""
    size = source.choice((0, 1, 4, 16, 64, 200, 300, 400, source.randrange(600))) if size is None else size
    fill = source.choice((b"\0", b"\1", b"\0\1\xff", bytes(range(256)), bytes(range(1, 256))))
    payload = bytes(source.choices(fill, k=size))
    numbers = (source.randrange(each) for each in (65536, 2**64, 256, 256))
    return Packet(source.randrange(256) if type is None else type, payload, *numbers)


@pytest.mark.parametrize("type", [*protocol.PacketType, 0, 15, 255])
def test_every_type_at_every_size_is_encoded_and_decoded_identically(codec: CodecProcess, type: int) -> None:
    source = random.Random(type)
    # With header and checksum a full run of 254 may end anywhere.
    sent = [Packet(type, b"\1" * 234), Packet(type, b"\1" * 508)]
    sent += [random_packet(source, type, size) for size in range(0, 520, 7)]
    wires = [codec.encode(packet) for packet in sent]
    assert wires == [encode_packet(packet) for packet in sent]
    assert assert_same(codec, wires) == sent


def test_every_code_half_between_codes_and_the_edges(codec: CodecProcess) -> None:
    top = 0xFFF
    halves = np.arange(0, 2 * top, dtype=np.float32) * np.float32(protocol.FULL_SCALE / (top - 1) / 2)
    edges = np.array([np.nan, -np.nan, np.inf, -np.inf, -0.0, -1e-30, 1e-30, 10.0, np.nextafter(10, 0), 3e38], "f4")
    forces = np.concatenate((halves, np.nextafter(halves, np.float32(np.inf)), edges))
    forces = np.concatenate((forces, np.zeros(-len(forces) % 200, np.float32))).reshape(-1, 200)
    for row in forces:
        written = codec.ask("s", row.astype("<f4").tobytes())
        assert written == protocol.encode_samples(row[:100], row[100:])
        back, clipped = np.ravel(protocol.decode_samples(written)), np.clip(row, 0.0, 10.0)
        assert np.array_equal(np.isnan(back), np.isnan(row))
        assert np.nanmax(np.abs(back - clipped)) <= protocol.FULL_SCALE / (top - 1) / 2 + 1e-6


def test_damaged_packets_are_decoded_identically(codec: CodecProcess) -> None:
    """Of each packet one byte is changed, lost or new."""
    source = random.Random(4)
    originals = [random_packet(source) for _ in range(300)]
    stream = b""
    for number, packet in enumerate(originals):
        wire = encode_packet(packet)
        at = source.randrange(len(wire))
        stream += wire[:at] + source.randbytes(number % 3) + wire[at + number % 2 :]
    accepted = assert_same(codec, [stream[at : at + 1000] for at in range(0, len(stream), 1000)])
    assert set(originals).issuperset(accepted)
    assert 0 < len(accepted) < 200
