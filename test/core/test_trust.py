# SPDX-License-Identifier: Apache-2.0
"""Four laws for files from others: size bounded before reading, no pickle, no doubled keys, refused by name.

Each known attack replaces a file of the one reader of its kind. It is refused with the file's name, soon, and without
the memory that it claims.
"""

import io
import os
import pickle
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deltacharger_core import arrays, files, mcap_file, yaml_file
from deltacharger_kinematics.calibration.data import read_measurements

MEGABYTE = 2**20
SOON, MORE = 2.0, 200  # s; MB
Attack = Callable[[Path], object]


def content(data: bytes) -> Attack:
    return lambda path: path.write_bytes(data)


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


ANYWHERE: dict[str, Attack] = {
    "/dev/zero": lambda path: path.symlink_to("/dev/zero"),
    "a pipe": os.mkfifo,
    "a folder": Path.mkdir,
    "a terabyte of nothing": sparse,
    "no UTF-8": content(b"\xff\xfe\xfa" * 300),
    "a pickle": content(pickle.dumps({"x": print})),
}


def laughs() -> bytes:
    lines = ["a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30)]
    return "\n".join(lines).encode()


YAML = {
    "billion laughs": laughs(),
    "nesting": b"a: " + b"[" * 500_000,
    "a number of a million digits": b"gap: " + b"9" * 1_000_000,
    "an object": b"a: !!python/object/apply:os.system [x]",
    "a doubled key": b"a: 1\na: 2\n",
}
JSON = {
    "nesting": b"[" * 500_000,
    "a doubled key": b'{"n": 1, "n": 2}',
}
CSV = {
    "one long line": b"x_mm," * 500_000,
    "a number of digits": b"x_mm,y_mm,z_mm,ticks_0,ticks_1,ticks_2\n" + b"9" * 1_000_000 + b",2,3,4,5,6\n",
}


def array(descr: str, shape: str, data: bytes = b"") -> bytes:
    text = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(118) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + data


def zipped(name: str, data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, data)
        archive.writestr("meta.npy", array("<U2", "()", "{}".encode("utf-32-le")))
    return out.getvalue()


ARRAYS = {
    "objects": array("|O", "(1,)", pickle.dumps([print])),
    "ten terabytes": array("<f8", "(1099511627776,)"),
    "a header that calls": array("<f8", "__import__('os').getcwd()"),
}


def archives() -> dict[str, bytes]:
    twice = zipped("b.npy", array("<f8", "(1,)", bytes(8))).replace(b"meta.npy", b"b.npy\0\0\0")
    held = {name: zipped("a.npy", data) for name, data in ARRAYS.items()}
    return held | {"a bomb": zipped("a.npy", bytes(300 * MEGABYTE)), "a name twice": twice}


def pictures() -> dict[str, bytes]:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 65500, 65500, 16, 0, 0, 0, 0))
    huge = b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(10**6))) + chunk(b"IEND", b"")
    return {"4 gigapixels": huge}


def recordings() -> dict[str, bytes]:
    import zstandard

    def record(opcode: int, data: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(data)) + data

    def chunk(method: bytes, packed: bytes, size: int) -> bytes:
        head = struct.pack("<QQQII", 0, 0, size, 0, len(method)) + method + struct.pack("<Q", len(packed))
        return record(6, head + packed)

    start, much = b"\x89MCAP0\r\n" + record(1, bytes(8)), bytes(400 * MEGABYTE)
    zstd = zstandard.compress(much)
    return {
        "a chunk of 400 MB that claims less": start + chunk(b"zstd", zstd, 1000),
        "a record of 2⁶³ bytes": start + struct.pack("<BQ", 5, 2**63),
    }


def read_recording(path: Path) -> None:
    file = mcap_file.McapFile(path)
    assert not list(file.messages())
    if file.damage:
        raise ValueError(f"{path}: {file.damage}")


def read_picture(path: Path) -> None:
    pytest.importorskip("cv2", reason="reads with deltacharger[vision]")
    from deltacharger_vision.image_files import read_color

    read_color(path)


def read_depth(path: Path) -> None:
    pytest.importorskip("cv2", reason="reads with deltacharger[vision]")
    from deltacharger_vision.image_files import read_depth

    read_depth(path)


def named(read: Callable[[Path], object]) -> Callable[[Path], None]:
    """Return a reader whose users add the file's name."""

    def read_and_name(path: Path) -> None:
        try:
            read(path)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error

    return read_and_name


KINDS: dict[str, tuple[str, Callable[[Path], Any], Callable[[], dict[str, bytes]]]] = {
    "yaml": ("a.yaml", yaml_file.read_yaml, lambda: YAML),
    "json": ("a.json", named(lambda path: files.parse_json(files.read_text(path))), lambda: JSON),
    "csv": ("a.csv", named(read_measurements), lambda: CSV),
    "npz": ("a.npz", named(lambda path: arrays.read_npz(path, "meta", arrays.LARGEST_MODEL)), archives),
    "npy": ("a.npy", read_depth, lambda: ARRAYS),
    "picture": ("a.png", read_picture, pictures),
    "mcap": ("a.mcap", read_recording, recordings),
}


def most_memory() -> int:
    """Return the largest memory of this process since it was last forgotten, MB."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) // 1024


@pytest.mark.parametrize("kind", KINDS)
def test_known_attacks_are_refused_by_name_soon_and_in_little_memory(kind: str, tmp_path: Path) -> None:
    if kind == "mcap":
        for library in ("mcap", "zstandard"):
            pytest.importorskip(library, reason="reads with deltacharger[record]")
    name, read, made = KINDS[kind]
    for number, (attack, do) in enumerate((ANYWHERE | {key: content(data) for key, data in made().items()}).items()):
        path = tmp_path / str(number) / name
        path.parent.mkdir()
        do(path)
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        before, began = most_memory(), time.process_time()
        with pytest.raises((OSError, ValueError, RuntimeError)) as caught:
            read(path)
        assert str(path) in str(caught.value), attack
        assert time.process_time() - began < SOON, attack
        assert most_memory() - before < MORE, attack
