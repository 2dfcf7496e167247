# SPDX-License-Identifier: Apache-2.0
"""Malicious files: each replaces the file of every reader of its kind."""

from __future__ import annotations

import io
import json
import os
import socket
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

Attack = Callable[[Path], object]
"""Creates something at a path."""
MEGABYTE = 2**20


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(10 * 2**30)


def bound(path: Path) -> None:
    """Create a socket, bound by its name in the folder because the complete path may be too long."""
    here = os.getcwd()
    os.chdir(path.parent)
    try:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)
    finally:
        os.chdir(here)


def content(data: bytes) -> Attack:
    return lambda path: path.write_bytes(data)


ANYWHERE: dict[str, Attack] = {
    "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a socket": bound,
    "10 GB of nothing": sparse,
    "a loop of links": lambda path: path.symlink_to(path.name),
    "zero bytes": content(bytes(1000)),
    "no UTF-8": content(b"\xff\xfe\xfa" * 300),
    "a terminal": lambda path: path.symlink_to("/dev/tty"),
    "memory of this process": lambda path: path.symlink_to("/proc/self/mem"),
}


def laughs(levels: int = 30) -> bytes:
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, levels)]
    return "\n".join(lines).encode()


YAML = {
    "billion laughs": laughs(),
    "a list in itself": b"a: &a [*a]\n",
    "merged keys": b"a: &a {b: 1}\nc: {<<: *a}\n",
    "nesting": b"a: " + b"[" * 500_000,
    "nested keys": b"{a: " * 200_000,
    "nested dashes": b"- " * 500_000,
    "a number of a million digits": b"gap: " + b"9" * 1_000_000,
    "a text of a megabyte": b"name: [" + b"x" * 1_000_000 + b"]",
    "a key of a megabyte": b"x" * 1_000_000 + b": 1",
    "half a million values": b"limbs: [" + b"{}," * 300_000 + b"]",
    "anchors": b"".join(b"- &a%d 1\n" % n for n in range(60_000)),
    "a date": b"a: 2026-01-31",
    "a date that is none": b"a: 2026-02-31",
    "an object": b"a: !!python/object/apply:os.system [x]",
    "a doubled key": b"a: 1\na: 2\n",
    "two documents": b"a: 1\n---\na: 2\n",
    "more than 64 bits": b"arm: 99999999999999999999999999999",
    "UTF-16": "a: 1".encode("utf-16"),
}
CSV = {
    "one long line": b"x_mm," * 500_000,
    "empty lines": b"\n" * 3_000_000,
    "quotes": b'"' * 1_000_000,
    "rows": b"x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2\n" + b"1,2,3,4,5,6\n" * 200_000,
    "a number of digits": b"x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2\n" + b"9" * 1_000_000 + b",2,3,4,5,6\n",
    "UTF-16": "x_mm,y_mm\n1,2\n".encode("utf-16"),
}
JSON = {
    "nesting": b"[" * 500_000,
    "nested keys": b'{"a":' * 200_000,
    "a number of a million digits": b'{"n": ' + b"9" * 1_000_000 + b"}",
    "a key of a megabyte": b'{"' + b"x" * 1_000_000 + b'": 1}',
    "a doubled key": b'{"n": 1, "n": 2}',
    "a doubled key behind many": json.dumps({f"{n}": 0 for n in range(80_000)}).encode()[:-1] + b', "79999": 1}',
    "a list": b"[]",
    "values": b"[" + b"0," * 450_000 + b"0]",
}


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return out.getvalue()


def array(header: str, data: bytes = b"") -> bytes:
    text = header.encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def header(descr: str, shape: str) -> str:
    return f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"


ARRAYS = {
    "a shape of 10 TB": array(header("<f8", "(1000000, 1250000)"), bytes(64)),
    "a negative shape": array(header("<f8", "(-4, -2)"), bytes(64)),
    "a shape of nothing": array(header("<f8", "(0, 99999999999999999999)")),
    "Python objects": array(header("|O", "(1,)"), b"cos\nsystem\n(S'true'\ntR."),
    "a nested header": array("(" * 5000),
    "a header of 64 kB": b"\x93NUMPY\x01\x00\xff\xff" + b" " * 65535,
    "a type of a gigabyte": array(header("<U999999999", "(1,)"), bytes(64)),
    "a dividing type": array(header("<f8", "(2, 1.5)"), bytes(64)),
}


def archives() -> dict[str, bytes]:
    zeros = array(header("|u1", f"({512 * MEGABYTE},)"), bytes(512 * MEGABYTE))
    bomb = zipped({"meta.npy": zeros, "about.npy": array(header("<U2", "()"), b"{\0\0\0}\0\0\0")})
    many = zipped({f"{n}.npy": b"" for n in range(60_000)}, zipfile.ZIP_STORED)
    damaged = {f"{name}.npy": each for each in ARRAYS.values() for name in ("meta", "about")}
    return {
        "a bomb of 512 MB": bomb,
        "60 000 members": many,
        "damaged headers": zipped(damaged),
        "nested headers": zipped({"meta.npy": ARRAYS["a nested header"], "about.npy": ARRAYS["a nested header"]}),
        "another way of packing": zipped({"meta.npy": bytes(64 * MEGABYTE)}, zipfile.ZIP_BZIP2),
        "Python objects": zipped({"meta.npy": ARRAYS["Python objects"], "about.npy": ARRAYS["Python objects"]}),
    }


def png(width: int, height: int, rows: bytes) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def pictures() -> dict[str, bytes]:
    sizes = struct.pack(">BHHB", 8, 65500, 65500, 3) + bytes(9)
    jpeg = b"\xff\xd8\xff\xc0" + struct.pack(">H", len(sizes) + 2) + sizes
    return {
        "a PNG of 50 000 × 50 000": png(50_000, 50_000, bytes(1000)),
        "a PNG of 20 000 × 20 000": png(20_000, 20_000, bytes(1000)),
        "a JPEG of 65 500 × 65 500": jpeg,
        "a JPEG without end": b"\xff\xd8" + b"\xff" * (63 * MEGABYTE),
        "a JPEG of many scans": b"\xff\xd8\xff\xc2" + jpeg[4:] + b"\xff\xda\x00\x02" * 10_000,
        "a bitmap": b"BM" + struct.pack("<IIIIIIHHIIIIII", 54, 0, 54, 40, 40_000, 40_000, 1, 24, 0, 0, 0, 0, 0, 0),
        "another picture's format": b"P6 40000 40000 255\n" + bytes(100),
    }


def recordings() -> dict[str, bytes]:
    import lz4.frame
    import zstandard

    magic = b"\x89MCAP0\r\n"

    def record(opcode: int, data: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(data)) + data

    def chunk(method: bytes, packed: bytes, size: int) -> bytes:
        return record(
            6, struct.pack("<QQQII", 0, 0, size, 0, len(method)) + method + struct.pack("<Q", len(packed)) + packed
        )

    start = magic + record(1, bytes(8))
    much = bytes(400 * MEGABYTE)
    zstd, lz4ed = zstandard.compress(much), lz4.frame.compress(much)
    message = record(5, bytes(22))
    tiny = zstandard.compress(message * (40 * MEGABYTE // len(message)))
    return {
        "a chunk of 400 MB, zstd": start + chunk(b"zstd", zstd, len(much)),
        "a chunk of 400 MB that claims less, zstd": start + chunk(b"zstd", zstd, 1000),
        "a chunk of 400 MB that claims less, lz4": start + chunk(b"lz4", lz4ed, 1000),
        "a chunk that claims 2⁶⁴": start + chunk(b"zstd", zstd, 2**64 - 1),
        "a chunk of a million messages": start + chunk(b"zstd", tiny, len(message) * (40 * MEGABYTE // len(message))),
        "a chunk in a chunk": start + chunk(b"", chunk(b"zstd", zstd, len(much)), 0),
        "a record of 2⁶³ bytes": start + struct.pack("<BQ", 5, 2**63),
        "a record of no kind": start + bytes(100_000),
        "a summary that is everywhere": start + struct.pack("<BQQQI", 2, 20, 9, 2**60, 0) + magic,
        "metadata without end": start + record(12, struct.pack("<II", 0, 2**32 - 1) + bytes(3 * MEGABYTE)),
    }


def attacks(kind: str) -> dict[str, Attack]:
    """Return all attacks on a kind of files, by name."""
    made: dict[str, Callable[[], dict[str, bytes]]] = {
        "yaml": lambda: YAML,
        "csv": lambda: CSV,
        "json": lambda: JSON,
        "npy": lambda: ARRAYS,
        "npz": archives,
        "picture": pictures,
        "mcap": recordings,
        "parquet": lambda: {"a footer of 2 GB": b"PAR1\xff\xff\xff\x7fPAR1"},
    }
    return ANYWHERE | {name: content(data) for name, data in made[kind]().items()}
