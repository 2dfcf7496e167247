# SPDX-License-Identifier: Apache-2.0
"""Checks the board's HELLO and explains a missing answer."""

from __future__ import annotations

import contextlib

from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_driver.board.errors import BoardMismatch
from deltacharger_driver.board.payloads import Hello
from deltacharger_driver.board.port import BoardPort
from deltacharger_driver.board.protocol import MINOR, VERSION, DecoderCounters
from deltacharger_driver.errors import NoAnswer, PortError, WrongDevice
from deltacharger_driver.port_identity import find_servos


def check_hello(port: str, hello: Hello) -> None:
    """Refuse an incompatible board.

    Raises:
        BoardMismatch: it speaks another version or has other array sizes.
    """
    if hello.major != VERSION or hello.minor < MINOR:
        raise BoardMismatch(port, f"the board speaks version {hello.major}.{hello.minor}")
    if (hello.rows, hello.columns) != (ROWS, COLUMNS):
        raise BoardMismatch(port, f"the board has {hello.rows} x {hello.columns} taxels per pad")


def explain_silence(port: str, before: DecoderCounters, now: DecoderCounters, error: NoAnswer) -> Exception:
    """Return the error for a board that did not answer, from the bytes received since `before`."""
    if now.version_errors > before.version_errors:
        return BoardMismatch(port, f"the board speaks version {now.refused_version}")
    if now.packets > before.packets:
        return NoAnswer(f"{port} (the board sends other packets)", error.action, error.timeout)
    if now.bytes > before.bytes:
        count = now.bytes - before.bytes
        return BoardMismatch(port, f"received {count} bytes, but no intact packet: wrong baud rate or device")
    return error


def refuse_servos(port: str, baud_rate: int) -> None:
    """Look for servos at the port's speed and at the factory default.

    Raises:
        WrongDevice: they answer.
    """
    with contextlib.suppress(PortError):
        opened = BoardPort(port, baud_rate)
        try:
            found = find_servos(opened, dict.fromkeys((baud_rate, 57600)), ids=())
        finally:
            opened.close()
        if found:
            raise WrongDevice(port, "the board with the pads and the power stage", "the servos")
