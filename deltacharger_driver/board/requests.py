# SPDX-License-Identifier: Apache-2.0
"""Commands to the board waiting for their answers."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from deltacharger_driver.board.errors import BoardRebooted
from deltacharger_driver.board.payloads import Ack
from deltacharger_driver.board.protocol import PacketType


@dataclass
class BoardRequest:
    """One command. Every attempt has its own sequence number; an answer to any of them counts.

    Attributes:
        type: of the command.
        payload: of the command; identifies a PING.
        sequences: of the attempts so far.
        done: set when `ack`, `error` or a returned PING has arrived.
        received: s, arrival of the answer.
    """

    type: PacketType
    payload: bytes
    sequences: set[int] = field(default_factory=set)
    done: threading.Event = field(default_factory=threading.Event)
    ack: Ack | None = None
    received: float = 0.0
    error: Exception | None = None


class BoardRequests:
    """All waiting commands; any thread may add one, one thread delivers answers."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[BoardRequest] = []

    @contextmanager
    def waiting(self, request: BoardRequest) -> Iterator[BoardRequest]:
        """Accept answers to `request` inside the block."""
        with self._lock:
            self._waiting.append(request)
        try:
            yield request
        finally:
            with self._lock:
                self._waiting.remove(request)

    def attempt(self, request: BoardRequest, sequence: int) -> None:
        """Record an attempt before it is sent."""
        with self._lock:
            request.sequences.add(sequence)

    def acknowledge(self, ack: Ack, received: float) -> None:
        """Deliver an ACK to its command; a late one is dropped."""
        with self._lock:
            for request in self._waiting:
                if request.type == ack.type and ack.sequence in request.sequences:
                    request.ack = ack
                    request.received = received
                    request.done.set()
                    return

    def ping_returned(self, payload: bytes, received: float) -> None:
        """Deliver a returned PING to its sender."""
        with self._lock:
            for request in self._waiting:
                if request.type is PacketType.PING and request.payload == payload and not request.done.is_set():
                    request.received = received
                    request.done.set()
                    return

    def fail(self, error: Exception) -> None:
        """End all waiting commands with `error`."""
        with self._lock:
            for request in self._waiting:
                request.error = error
                request.done.set()

    def rebooted(self) -> None:
        """End all waiting commands except HELLO, whose answer may have revealed the reboot."""
        with self._lock:
            for request in self._waiting:
                if request.type is not PacketType.HELLO and not request.done.is_set():
                    request.error = BoardRebooted(request.type.name)
                    request.done.set()
