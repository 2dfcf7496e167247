# SPDX-License-Identifier: Apache-2.0
"""Cause faults in a simulated charger that runs in another process, through a Unix socket beside its ports.

Each connection carries one JSON object on one line each way. Requests: {"command": "begin", "kind", "last", "servo",
"amount"} with the keys of a scene's fault, {"command": "clear"} and {"command": "active"}. Answers:
{"success": true, "active": [...]} or {"success": false, "error"}. Only the user who
runs the charger may connect. Time and bytes are bounded on both sides, and clients do not wait for each other.
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import socket
import stat
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from deltacharger_core import runtime
from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_sim.charger.faults import Fault, Faults

SOCKET = runtime.CONTROL
"""Name of the socket in the ports' folder."""
_LONGEST_LINE = 16384  # bytes of a request
_LONGEST_ANSWER = 2**18  # bytes
_PATIENCE = 1.0  # s for a client to send its line and receive the answer
_PAUSE = 0.02  # s before a failed accept is repeated
_CLIENTS_MAX = 64  # simultaneous conversations; the oldest is closed for a new one
_LONGEST_PATH = 100  # bytes of a socket's path that every system accepts

Answer = dict[str, Any]


class Registration:
    """A link that leads to a charger's socket; replaces the link of a charger that has ended.

    Raises:
        FileExistsError: a running charger has the name.
        OSError: the folder cannot be created, or belongs to another user.
    """

    def __init__(self, name: Path, target: Path) -> None:
        self._name = name
        self._target = str(target.absolute())
        runtime.make(name.parent)
        if _listens(name):
            raise FileExistsError(f"{name} leads to another running charger")
        beside = name.with_name(f".{name.name}.{os.getpid()}")
        beside.unlink(missing_ok=True)
        beside.symlink_to(self._target)
        beside.replace(name)

    def remove(self) -> None:
        """Remove the link, unless another charger has replaced it."""
        with contextlib.suppress(OSError):
            if os.readlink(self._name) == self._target:
                self._name.unlink()


def _listens(path: Path) -> bool:
    try:
        with socket.socket(socket.AF_UNIX) as connection, _short(path) as address:
            _connect(connection, address, time.monotonic() + _PATIENCE)
    except TimeoutError:  # a process listens, but hangs
        return True
    except OSError:
        return False
    return True


def answer(faults: Faults, request: Any) -> Answer:
    """Execute one request and return the answer."""
    command = request.get("command") if isinstance(request, dict) else None
    if command == "begin":
        try:
            fault = from_mapping({key: value for key, value in request.items() if key != "command"}, Fault)
        except ParameterError as error:
            return {"success": False, "error": str(error)}
        faults.begin(fault)
    elif command == "clear":
        faults.clear()
    elif command != "active":
        return {"success": False, "error": f"unknown command {command!r}: give begin, clear or active"}
    return {"success": True, "active": faults.active()}


class ControlServer:
    """Answers requests on a Unix socket in a separate thread. A silent client is dropped and delays no other.

    Args:
        path: of the socket; an existing one is replaced.
        handler: answers a request.

    Raises:
        OSError: the socket cannot be created, or another file is in its place.
    """

    def __init__(self, path: Path, handler: Callable[[Any], Answer]) -> None:
        self._path = path
        self._handler = handler
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(path.lstat().st_mode):
                path.unlink()
        self._listener = socket.socket(socket.AF_UNIX)
        try:
            with _short(path) as address:
                self._listener.bind(address)
            path.chmod(0o600)
            self._made = path.stat().st_ino
            self._listener.listen(_CLIENTS_MAX)
        except BaseException:
            self._listener.close()
            raise
        self._listener.setblocking(False)
        self._wake, self._woken = socket.socketpair()
        self._clients: dict[socket.socket, _Conversation] = {}  # oldest first
        self._thread = threading.Thread(target=self._serve, name="faults' socket", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and remove the socket, unless another charger has replaced it."""
        self._wake.close()
        self._thread.join()
        self._woken.close()
        self._listener.close()
        with contextlib.suppress(OSError):
            if self._path.lstat().st_ino == self._made:
                self._path.unlink()

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._listener, selectors.EVENT_READ)
            selector.register(self._woken, selectors.EVENT_READ)
            while True:
                ready = {key.fileobj for key, _ in selector.select(self._time_left())}
                if self._woken in ready:
                    break
                for client, conversation in list(self._clients.items()):
                    if client in ready:
                        conversation.go_on(selector)
                    if conversation.time_left() <= 0.0:
                        self._drop(selector, client)
                if self._listener in ready:
                    self._accept(selector)
            for client in list(self._clients):
                self._drop(selector, client)

    def _time_left(self) -> float | None:
        oldest = next(iter(self._clients.values()), None)
        return None if oldest is None else max(oldest.time_left(), 0.0)

    def _accept(self, selector: selectors.BaseSelector) -> None:
        try:
            client, _ = self._listener.accept()
        except OSError:  # client gone, or no descriptors left: do not repeat at once
            time.sleep(_PAUSE)
            return
        client.setblocking(False)
        if len(self._clients) == _CLIENTS_MAX:
            self._drop(selector, next(iter(self._clients)))
        self._clients[client] = _Conversation(client, self._handler)
        selector.register(client, selectors.EVENT_READ)

    def _drop(self, selector: selectors.BaseSelector, client: socket.socket) -> None:
        del self._clients[client]
        selector.unregister(client)
        client.close()


class _Conversation:
    """One request line and one answer line."""

    def __init__(self, client: socket.socket, handler: Callable[[Any], Answer]) -> None:
        self._client = client
        self._handler = handler
        self._end = time.monotonic() + _PATIENCE
        self._request = b""
        self._reply = b""

    def time_left(self) -> float:
        """Return the remaining time, s; ≤ 0 at its end."""
        return self._end - time.monotonic()

    def go_on(self, selector: selectors.BaseSelector) -> None:
        """Read or write as much as possible without waiting."""
        try:
            if not self._reply:
                part = self._client.recv(_LONGEST_LINE)
                self._request += part
                if part and b"\n" not in part and len(self._request) < _LONGEST_LINE:
                    return
                self._reply = json.dumps(self._answer()).encode() + b"\n"
                selector.modify(self._client, selectors.EVENT_WRITE)
            self._reply = self._reply[self._client.send(self._reply) :]
        except BlockingIOError:
            return
        except OSError:  # gone
            self._reply = b""
        if not self._reply:
            self._end = 0.0

    def _answer(self) -> Answer:
        try:
            request = json.loads(self._request.partition(b"\n")[0])
        except (ValueError, RecursionError):
            return {"success": False, "error": "not one line of JSON"}
        try:
            return self._handler(request)
        except Exception as error:  # one bad request must not end the service
            return {"success": False, "error": f"{type(error).__name__}: {error}"}


def ask(path: Path, request: Answer, timeout: float = 10.0) -> Answer:
    """Send one request to a charger's socket and return its answer.

    Args:
        path: of the socket, or of a link to it.
        request: see the module.
        timeout: for all of it, s.

    Raises:
        ConnectionError: no process listens there.
        OSError: the answer is late or invalid, or the user may not connect.
    """
    end = time.monotonic() + timeout
    try:
        with socket.socket(socket.AF_UNIX) as connection, _short(path) as address:
            _connect(connection, address, end)
            connection.settimeout(max(end - time.monotonic(), _PAUSE))
            connection.sendall(json.dumps(request).encode() + b"\n")
            line = _line(connection, end)
    except FileNotFoundError as error:
        raise ConnectionError(f"{path}: {error.strerror}") from error
    if not line:
        raise ConnectionError(f"{path}: closed without an answer")
    try:
        reply = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise OSError("the answering program is not a charger") from error
    if not _is_answer(reply):
        raise OSError("the answering program is not a charger of this version")
    return dict(reply)


def _connect(connection: socket.socket, address: str, end: float) -> None:
    """Connect, even while the server's queue is full; TimeoutError after `end`."""
    connection.setblocking(False)
    while True:
        try:
            return connection.connect(address)
        except BlockingIOError as error:
            if time.monotonic() >= end:
                raise TimeoutError("the connection was not accepted") from error
            time.sleep(_PAUSE)


def _line(connection: socket.socket, end: float) -> bytes:
    """Return the bytes up to the end of the line or of the connection.

    Raises:
        OSError: it takes longer than until `end` (s, monotonic), or is longer than an answer.
    """
    line = b""
    while not line.endswith(b"\n"):
        left = end - time.monotonic()
        if left <= 0.0 or len(line) > _LONGEST_ANSWER:
            raise TimeoutError("the answer did not end")
        connection.settimeout(left)
        part = connection.recv(_LONGEST_ANSWER)
        if not part:
            break
        line += part
    return line


def _is_answer(reply: Any) -> bool:
    if not isinstance(reply, dict):
        return False
    if reply.get("success") is not True:
        return isinstance(reply.get("error"), str)
    active = reply.get("active")
    return isinstance(active, list) and all(_is_active(each) for each in active)


def _is_active(each: Any) -> bool:
    if not isinstance(each, dict) or not {"kind", "servo", "amount"} <= set(each):
        return False
    numbers = (each["amount"], each.get("remaining_s"))
    return isinstance(each["kind"], str) and all(isinstance(number, float | int | None) for number in numbers)


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """Yield a socket name that fits into an address, which holds 108 bytes."""
    if len(os.fsencode(path)) <= _LONGEST_PATH:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
