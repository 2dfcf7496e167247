# SPDX-License-Identifier: Apache-2.0
"""Reads the records of an untrusted MCAP file one by one, within bounds.

Before memory is allocated, a record's claims are checked: its length, the unpacked size of a chunk, and how many
messages a file of this size can hold. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Collection, Iterator
from typing import Any, BinaryIO, NamedTuple

SCHEMA, CHANNEL, MESSAGE, ATTACHMENT, METADATA = 0x03, 0x04, 0x05, 0x09, 0x0C
STATISTICS, METADATA_INDEX = 0x0B, 0x0D
_FOOTER, _CHUNK, _DATA_END = 0x02, 0x06, 0x0F
LARGEST_FILE = 2**40
"""Maximum bytes of a recording."""
_LARGEST_KEPT = 4 * 2**20  # bytes of all schemas, channels, metadata and their index records
_LARGEST_SUMMARY = 16 * 2**20  # bytes; at 80 bytes a chunk, 200 000 chunks
_LARGEST_RECORD = 48 * 2**20  # bytes, also of an unpacked chunk; a colour image of 4096 × 3072 px has 38 MB
_EACH = 200  # bytes of overhead of a record in memory
_DENSEST = 2000  # maximum unpacked bytes per byte of file; blank images compress to a thousandth
_MAGIC = b"\x89MCAP0\r\n"
_CLASSES = {  # in mcap.records
    SCHEMA: "Schema",
    CHANNEL: "Channel",
    ATTACHMENT: "Attachment",
    STATISTICS: "Statistics",
    METADATA: "Metadata",
    METADATA_INDEX: "MetadataIndex",
}
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")  # start, end, unpacked size and CRC-32; length of the compression name
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, received, published
_FOOT = struct.Struct("<BQQQI")  # opcode, length; start of summary and of its offsets, CRC-32 of both and of the footer


class DamagedMcap(ValueError):
    """A record violates the format. Example: a chunk of 98 kB that unpacks to 3 GB."""


class EndsEarly(DamagedMcap):
    """The file ends within a record, or before its footer. Example: its recorder was killed."""


class Message(NamedTuple):
    """A message.

    Attributes:
        channel: channel number.
        received, published: ns since 1970.
        data: bytes in the chunk's memory; copy them to keep them.
    """

    channel: int
    received: int
    published: int
    data: memoryview


class Records:
    """The records of a file: Message, or mcap's Schema, Channel, Metadata and so on; None for other kinds.

    Damage may also raise errors of mcap, zstandard, lz4 or struct.

    Args:
        stream: seekable file.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._size = stream.seek(0, io.SEEK_END)
        self._unpacked = self._count = 0
        self._kept_total = 0
        self._kept: dict[tuple[int, int], int] = {}  # bytes that a reader keeps, by opcode and number

    def walk(self, wanted: Collection[int] = ()) -> Iterator[tuple[int, Any]]:
        """Yield opcode and record from the beginning; chunks are replaced by their records.

        Args:
            wanted: opcodes to yield, only kinds outside chunks; empty = all.

        Raises:
            DamagedMcap: the file is damaged from here on.
        """
        self._stream.seek(0)
        if (magic := self._stream.read(len(_MAGIC))) != _MAGIC:
            raise EndsEarly("it does not begin as MCAP")
        checksum, data = zlib.crc32(magic), True  # data section, as opposed to the summary behind it
        while (head := self._head())[0] != _FOOTER:
            opcode, length, start = head
            if not data or (wanted and opcode not in wanted):
                data = data and opcode != _DATA_END
                self._stream.seek(length, io.SEEK_CUR)
                continue
            content = self._content(length)
            if opcode == _DATA_END:
                data = False
                if struct.unpack_from("<I", content)[0] not in (0, checksum):
                    raise DamagedMcap("its data does not have the checksum that it states")
                continue
            checksum = zlib.crc32(content, zlib.crc32(start, checksum))
            if opcode == _CHUNK:
                yield from self._inside(content)
            else:
                yield opcode, self._record(content, opcode)

    def read(self, offset: int, opcode: int) -> Any:
        """Return the record at an offset.

        Raises:
            DamagedMcap: there is no record of this opcode.
        """
        self._stream.seek(min(offset, self._size))
        found, length, _ = self._head()
        if found != opcode:
            raise DamagedMcap(f"the record at byte {offset} has another type")
        return self._record(self._content(length), opcode)

    def summary(self) -> dict[int, list[Any]]:
        """Return the records of the summary by opcode; empty if the file has none.

        Raises:
            DamagedMcap: the summary does not match its footer or is too large.
        """
        foot = self._size - _FOOT.size - len(_MAGIC)
        self._stream.seek(max(foot, 0))
        end = self._stream.read()
        if foot < 0 or end[_FOOT.size :] != _MAGIC:
            raise EndsEarly("it has no footer")
        opcode, length, start, offsets, checksum = _FOOT.unpack_from(end)
        if (opcode, length) != (_FOOTER, _FOOT.size - _HEAD.size) or not 0 <= start <= foot:
            raise DamagedMcap("its footer is damaged")
        if not start:
            return {}
        if foot - start > _LARGEST_SUMMARY:
            raise DamagedMcap("its summary is too large")
        self._stream.seek(start)
        section = self._stream.read(foot - start)
        if checksum not in (0, zlib.crc32(end[: _FOOT.size - 4], zlib.crc32(section))):
            raise DamagedMcap("its summary does not have the checksum that it states")
        found: dict[int, list[Any]] = {}
        for opcode, content in _split(memoryview(section)[: offsets - start] if offsets else memoryview(section)):
            if opcode in _CLASSES:
                found.setdefault(opcode, []).append(self._record(content, opcode))
        return found

    def _head(self) -> tuple[int, int, bytes]:
        head = self._stream.read(_HEAD.size)
        if len(head) < _HEAD.size:
            raise EndsEarly("it ends early")
        opcode, length = _HEAD.unpack(head)
        if not opcode:
            raise DamagedMcap("there is no record where one should begin")
        if length > self._size - self._stream.tell():
            raise EndsEarly("it ends within a record")
        return opcode, length, head

    def _content(self, length: int) -> memoryview:
        if length > _LARGEST_RECORD:
            raise DamagedMcap(f"a record has {length} bytes, more than {_LARGEST_RECORD}")
        content = self._stream.read(length)
        if len(content) < length:
            raise EndsEarly("it ends within a record")
        return memoryview(content)

    def _inside(self, chunk: memoryview) -> Iterator[tuple[int, memoryview]]:
        _, _, size, checksum, named = _CHUNK_HEAD.unpack_from(chunk)
        at = _CHUNK_HEAD.size + named
        method = str(chunk[_CHUNK_HEAD.size : at], "ascii")
        (length,) = struct.unpack_from("<Q", chunk, at)
        packed = chunk[at + 8 :]
        self._unpacked += size
        if length != len(packed) or size > _LARGEST_RECORD:
            raise DamagedMcap(f"a chunk states {length} packed and {size} unpacked bytes, which it cannot hold")
        if self._unpacked > _LARGEST_RECORD + _DENSEST * self._size:
            raise DamagedMcap(f"its chunks unpack to more than {_DENSEST} times its size")
        data = _unpack(packed, method, size)
        if len(data) != size or checksum not in (0, zlib.crc32(data)):
            raise DamagedMcap("a chunk does not unpack to what it states")
        for opcode, content in _split(data):
            self._count += 1
            if self._count > self._size:  # each takes at least one byte of the file, even packed
                raise DamagedMcap("it holds more messages than bytes")
            if opcode in (SCHEMA, CHANNEL, MESSAGE):
                yield opcode, self._record(content, opcode)

    def _record(self, content: memoryview, opcode: int) -> Any:
        if opcode in _CLASSES and opcode != ATTACHMENT:
            number = int.from_bytes(content[:2], "little") if opcode in (SCHEMA, CHANNEL) else len(self._kept)
            size = len(content) + _EACH
            self._kept_total += size - self._kept.get((opcode, number), 0)  # chunks repeat schemas and channels
            self._kept[opcode, number] = size
            if self._kept_total > _LARGEST_KEPT:
                raise DamagedMcap("its schemas, channels and metadata are too large")
        return _parsed(content, opcode)


def _split(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    at = 0
    while at < len(data):
        opcode, length = _HEAD.unpack_from(data, at)
        at += _HEAD.size
        if length > len(data) - at:
            raise DamagedMcap("a record is longer than the chunk or summary that contains it")
        yield opcode, data[at : at + length]
        at += length


def _unpack(packed: memoryview, method: str, size: int) -> memoryview:
    """Return a chunk's content, at most `size` + 1 bytes."""
    if not method:
        return packed
    if method == "zstd":
        import zstandard

        unpacker = zstandard.ZstdDecompressor(max_window_size=_LARGEST_RECORD)
        return memoryview(unpacker.stream_reader(packed, read_across_frames=True).read(size + 1))
    if method == "lz4":
        import lz4.frame  # type: ignore[import-untyped]

        return memoryview(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))
    raise DamagedMcap(f"a chunk has the unsupported compression {method[:20]!r}")


def _parsed(content: memoryview, opcode: int) -> Any:
    if opcode == MESSAGE:
        channel, _, received, published = _MESSAGE.unpack_from(content)
        return Message(channel, received, published, content[_MESSAGE.size :])
    if opcode == ATTACHMENT and int.from_bytes(content[-4:], "little") not in (0, zlib.crc32(content[:-4])):
        raise DamagedMcap("an attachment does not have the checksum that it states")
    if opcode not in _CLASSES:
        return None
    from mcap import records
    from mcap.data_stream import ReadDataStream

    return getattr(records, _CLASSES[opcode]).read(ReadDataStream(io.BytesIO(content)))
