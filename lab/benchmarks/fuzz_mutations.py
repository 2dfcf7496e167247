# SPDX-License-Identifier: Apache-2.0
"""Random damage of good files: bytes, lines, numbers and archive members, by a seed."""

from __future__ import annotations

import io
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable, Sequence

MOST = 2**20  # bytes of a mutated file
SIZES = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
TOKENS = (
    *(".nan", "-.inf", "nan", "Infinity", "1e999", "-1e308", "1e-400", "0", "-1", "-0.0", "0x7fffffff", "1_0", "1:30"),
    *("9" * 19, "9" * 400, "1" * 5000, "1." + "0" * 500, "true", "null", "~", "''", "[]", "{}", "2026-01-31", "no"),
    *("[" * 200, "{a: " * 200, '{"a":' * 2000, "[" * 5000, "- " * 300, "*a", "&a [1]", "<<: *a", "---", "!!int ''"),
    *("!!python/object/apply:os.getcwd []", "!!timestamp 2026-01-31", "!!bool maybe", "!!binary aGk=", "\0", "\x1b"),
    *("\ufeff", "\u2028", "\t", "\r", '"', "'", "#", ",", ";", ":", "%", "x" * 3000, "=1+1", "../../x", "/dev/zero"),
)
Mutation = Callable[[random.Random, bytes, Sequence[bytes]], bytes]


def flip_bits(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    changed = bytearray(data)
    for _ in range(source.choice((1, 1, 2, 8))):
        changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
    return bytes(changed)


def set_bytes(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    changed, at = bytearray(data), source.randrange(len(data))
    changed[at : at + source.choice((1, 2, 4, 16))] = source.randbytes(source.choice((1, 2, 4, 16)))
    return bytes(changed)


def cut(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    return data[: source.randrange(len(data))]


def leave_out(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    at = source.randrange(len(data))
    return data[:at] + data[at + source.choice((1, 2, 4, 8, 64, 512)) :]


def repeat(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    at, size = source.randrange(len(data)), source.choice((1, 4, 9, 64, 500, 5000))
    return data[:at] + data[at : at + size] * source.choice((2, 2, 3, 50)) + data[at + size :]


def splice(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    other = source.choice(others)
    return data[: source.randrange(len(data))] + other[source.randrange(len(other)) :]


def move(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    a, b, c = sorted(source.randrange(len(data)) for _ in range(3))
    return data[:a] + data[b:c] + data[a:b] + data[c:]


def blank(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    at, size = source.randrange(len(data)), source.choice((1, 8, 64, 512))
    return (data[:at] + bytes([source.choice((0, 0xFF, 0x20))]) * size + data[at + size :])[: len(data)]


def claim(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Overwrite a possible size field with a value at the limit of a type."""
    size, order = source.choice((1, 2, 4, 8)), source.choice(("little", "big"))
    value = source.choice(SIZES) + source.choice((0, 0, 1, -1))
    at = source.randrange(len(data))
    return data[:at] + (value % 2 ** (8 * size)).to_bytes(size, order) + data[at + size :]  # type: ignore[arg-type]


def token(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Replace a number or a word, or insert one."""
    places = [match.span() for match in re.finditer(rb"[-+.\w]+", data[:200_000])]
    start, end = source.choice(places) if places else (0, 0)
    if source.random() < 0.2:
        start = end = source.randrange(len(data) + 1)
    return data[:start] + source.choice(TOKENS).encode() + data[end:]


def lines(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    every = data.split(b"\n")
    line = source.randrange(len(every))
    kind = source.randrange(4)
    if kind == 0:
        every.insert(source.randrange(len(every)), every[line])
    elif kind == 1:
        del every[line]
    elif kind == 2:
        every[line] = b" " * source.choice((1, 2, 4, 40)) + every[line]
    else:
        every[line:line] = source.choice(others).split(b"\n")[: source.choice((1, 3, 1000))]
    return b"\n".join(every)


BYTES: tuple[Mutation, ...] = (flip_bits, set_bytes, cut, leave_out, repeat, splice, move, blank, claim)
TEXT: tuple[Mutation, ...] = (flip_bits, cut, leave_out, repeat, splice, token, token, token, lines, lines)


def zip_members(mutate: Callable[[random.Random, bytes, Sequence[bytes]], bytes]) -> Mutation:
    """Return a mutation of the members of a zip file, with correct checksums."""

    def changed(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(io.BytesIO(source.choice(others))) as archive:
            strange = [archive.read(name) for name in archive.namelist()[:5]]
        if not members:  # an earlier change removed the last one
            return data
        name = source.choice(list(members))
        kind = source.randrange(6)
        if kind == 0:
            del members[name]
        elif kind == 1:
            members[name] = source.choice([*members.values(), *strange])
        else:
            # The first 128 bytes hold sizes and types, the rest are numbers.
            head = 128 if kind < 4 else len(members[name])
            members[name] = mutate(source, members[name][:head] or b"\0", strange) + members[name][head:]
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", source.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
            for each, content in members.items():
                archive.writestr(each, content)
        return out.getvalue()

    return changed


def any_of(*mutations: Mutation) -> Mutation:
    def changed(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
        return source.choice(mutations)(source, data, others)

    return changed


def png_again(source: random.Random, data: bytes, others: Sequence[bytes]) -> bytes:
    """Mutate a chunk of a PNG and correct its checksum; for other files mutate bytes."""
    if not data.startswith(b"\x89PNG"):
        return any_of(*BYTES)(source, data, others)
    at, chunks = 8, []
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    index = source.randrange(len(chunks))
    kind, content = chunks[index]
    chunks[index] = kind, any_of(*BYTES)(source, content or b"\0", others)
    if source.random() < 0.2:
        chunks.insert(source.randrange(len(chunks)), source.choice(chunks))
    packed = (struct.pack(">I", len(c)) + k + c + struct.pack(">I", zlib.crc32(k + c)) for k, c in chunks)
    return data[:8] + b"".join(packed)


def mutated(seed: str, good: Sequence[bytes], mutations: Sequence[Mutation]) -> bytes:
    """Return one of the good files with one or more changes; the seed determines them."""
    source = random.Random(seed)
    data = source.choice(good)
    for _ in range(source.choice((1, 1, 1, 2, 4))):
        try:
            data = source.choice(mutations)(source, data or b"\0", good)[:MOST]
        except Exception:  # no longer valid for the mutation; zipfile raises many kinds of errors
            data = any_of(*BYTES)(source, data or b"\0", good)[:MOST]
    return data
