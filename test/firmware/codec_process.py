# SPDX-License-Identifier: Apache-2.0
"""The firmware's codec as a process; firmware/host/codec.c describes the protocol of its pipes."""

import struct
import subprocess
from pathlib import Path

from deltacharger_driver.packets import Packet

_HEAD = struct.Struct("<cI")
_SIZE = struct.Struct("<I")
_PACKET = struct.Struct("<BHQBB")
_LISTED = struct.Struct("<HBHQBB")
_COUNTERS = struct.Struct("<6Ih")


class CodecProcess:
    """Encodes and decodes in C."""

    def __init__(self, program: Path) -> None:
        pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self._process = subprocess.Popen([program], **pipes)
        self._in, self._out = self._process.stdin, self._process.stdout

    def ask(self, operation: str, body: bytes = b"") -> bytes:
        """Send a request and return the answer."""
        self._in.write(_HEAD.pack(operation.encode(), len(body)) + body)
        self._in.flush()
        head = self._out.read(_SIZE.size)
        assert len(head) == _SIZE.size, self._process.stderr.read()
        return self._out.read(_SIZE.unpack(head)[0])

    def new_decoder(self, longest: int = 1024) -> None:
        """Start a new stream."""
        self.ask("r", struct.pack("<H", longest))

    def feed(self, data: bytes) -> list[Packet]:
        """Decode the next bytes of the stream and return completed packets."""
        answer = self.ask("d", data)
        packets, position = [], 0
        while position < len(answer):
            size, type, sequence, time, flags, sample_format = _LISTED.unpack_from(answer, position)
            position += _LISTED.size
            packets.append(Packet(type, answer[position : position + size], sequence, time, flags, sample_format))
            position += size
        return packets

    def counters(self) -> tuple[int, ...]:
        """Return packets, COBS, CRC, length, version and header errors, and the refused version (-1 = none)."""
        return _COUNTERS.unpack(self.ask("c"))

    def encode(self, packet: Packet) -> bytes:
        """Return the bytes on the wire."""
        head = _PACKET.pack(packet.type, packet.sequence, packet.device_time_us, packet.flags, packet.format)
        return self.ask("e", head + packet.payload)

    def close(self) -> None:
        """End the process; a sanitizer's finding is a failure."""
        _, errors = self._process.communicate(timeout=10.0)
        assert (self._process.returncode, errors) == (0, b"")
