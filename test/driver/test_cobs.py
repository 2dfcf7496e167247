# SPDX-License-Identifier: Apache-2.0
"""COBS: no zero inside, nothing lost, bounded overhead, and no invalid bytes accepted."""

from __future__ import annotations

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from deltacharger_driver.board import cobs

# From the table in the Wikipedia article on COBS, which follows Cheshire and Baker.
PUBLISHED = [
    ("", "01"),
    ("00", "0101"),
    ("0000", "010101"),
    ("00110000", "0102110101"),
    ("11220033", "0311220233"),
    ("11223344", "0511223344"),
    ("11000000", "0211010101"),
    (bytes(range(1, 255)).hex(), "ff" + bytes(range(1, 255)).hex()),
    (bytes(range(255)).hex(), "01ff" + bytes(range(1, 255)).hex()),
    (bytes(range(1, 256)).hex(), "ff" + bytes(range(1, 255)).hex() + "02ff"),
    ((bytes(range(2, 256)) + b"\0").hex(), "ff" + bytes(range(2, 256)).hex() + "0101"),
    ((bytes(range(3, 256)) + b"\0\1").hex(), "fe" + bytes(range(3, 256)).hex() + "0201"),
]


@pytest.mark.parametrize(("plain", "stuffed"), PUBLISHED)
def test_published_examples(plain: str, stuffed: str) -> None:
    data, expected = bytes.fromhex(plain), bytes.fromhex(stuffed)
    assert cobs.encode(data) == expected
    assert cobs.decode(expected) == data


@given(st.binary(max_size=1200))
@example(b"\1" * 254)
@example(b"\1" * 508)
@example(b"\1" * 254 + b"\0")
def test_round_trip_without_zeros_and_with_bounded_overhead(data: bytes) -> None:
    stuffed = cobs.encode(data)
    assert 0 not in stuffed
    assert cobs.decode(stuffed) == data
    assert len(data) + 1 <= len(stuffed) + (len(data) % 254 == 0 and len(data) > 0)
    assert len(stuffed) <= len(data) + 1 + len(data) // 254


def test_an_unnecessary_closing_code_is_accepted() -> None:
    """Some encoders end a full run of 254 bytes with 01."""
    assert cobs.decode(b"\xff" + b"\7" * 254 + b"\1") == b"\7" * 254


@pytest.mark.parametrize("stuffed", [b"", b"\0", b"\3\1\0", b"\2", b"\5\1\2\3", b"\xff\1\1"])
def test_invalid_bytes_are_refused(stuffed: bytes) -> None:
    with pytest.raises(cobs.CobsError):
        cobs.decode(stuffed)


@given(st.binary(max_size=600))
def test_accepted_bytes_round_trip(noise: bytes) -> None:
    end = 0
    while end < len(noise):  # from code to code; none is 0
        end += noise[end] or len(noise)
    if not noise or 0 in noise or end != len(noise):
        with pytest.raises(cobs.CobsError):
            cobs.decode(noise)
        return
    data = cobs.decode(noise)
    assert len(data) < len(noise)
    assert cobs.decode(cobs.encode(data)) == data
