# SPDX-License-Identifier: Apache-2.0
"""How faults are ordered from a simulated charger that runs in another process: a Unix socket beside its ports.

One connection carries one JSON object on one line each way. Requests: {"command": "begin", "kind", "last", "servo",
"amount"} with the keys of a scene's fault, {"command": "clear"}, {"command": "active"}. Answers: {"success": true,
"active": [...]} or {"success": false, "error"}. Only the user who runs the charger may connect.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import socketserver
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from deltacharger_core import runtime
from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_sim.charger.faults import Fault, Faults

SOCKET = "control"
"""Name of the socket in the ports' folder."""
_LONGEST_LINE = 16384  # bytes
_PATIENCE = 1.0  # s for a client to say its line
_TURN = 0.2  # s between two looks whether the server shall end
_LONGEST_PATH = 100  # bytes of a socket's path that every system takes

Answer = dict[str, Any]


class Registration:
    """A link under which a charger's socket is found; takes the place of one whose charger is gone.

    Raises:
        FileExistsError: a charger that runs has the name.
        OSError: the folder cannot be made, or belongs to somebody else.
    """

    def __init__(self, name: Path, target: Path) -> None:
        self._name = name
        self._target = str(target.absolute())
        runtime.make(name.parent)
        if _listens(name):
            raise FileExistsError(f"{name} leads to another charger that runs")
        beside = name.with_name(f".{name.name}.{os.getpid()}")
        beside.unlink(missing_ok=True)
        beside.symlink_to(self._target)
        beside.replace(name)

    def remove(self) -> None:
        """Remove the link, unless another charger has taken it over."""
        with contextlib.suppress(OSError):
            if os.readlink(self._name) == self._target:
                self._name.unlink()


def _listens(path: Path) -> bool:
    try:
        with socket.socket(socket.AF_UNIX) as connection, _short(path) as address:
            connection.settimeout(_PATIENCE)
            connection.connect(address)
    except OSError:
        return False
    return True


def answer(faults: Faults, request: Any) -> Answer:
    """Carry out one request and return what to answer."""
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
        return {"success": False, "error": f"unknown command {command!r}; there are begin, clear, active"}
    return {"success": True, "active": faults.active()}


class ControlServer:
    """Answer requests on a Unix socket, one after the other, from a thread of its own.

    Args:
        path: of the socket; an older one is replaced.
        handler: answers a request.

    Raises:
        OSError: the socket cannot be made, or something else stands there.
    """

    def __init__(self, path: Path, handler: Callable[[Any], Answer]) -> None:
        self._path = path
        with contextlib.suppress(FileNotFoundError):
            if stat.S_ISSOCK(path.lstat().st_mode):
                path.unlink()
        with _short(path) as address:
            self._server = _Server(address, _Conversation)
        path.chmod(0o600)
        self._server.handler = handler
        self._made = path.stat().st_ino
        self._thread = threading.Thread(target=self._server.serve_forever, args=(_TURN,), name="faults' socket")
        self._thread.daemon = True
        self._thread.start()

    def close(self) -> None:
        """Stop answering and remove the socket, unless another charger has taken its place."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        with contextlib.suppress(OSError):
            if self._path.lstat().st_ino == self._made:
                self._path.unlink()


class _Server(socketserver.UnixStreamServer):
    handler: Callable[[Any], Answer]


class _Conversation(socketserver.StreamRequestHandler):
    timeout = _PATIENCE

    def handle(self) -> None:
        """Read one line, write one line; who says nothing, or nothing that is JSON, is told or let go."""
        assert isinstance(self.server, _Server)
        try:
            line = self.rfile.readline(_LONGEST_LINE)
            try:
                request = json.loads(line)
            except ValueError:
                reply = {"success": False, "error": "not one line of JSON"}
            else:
                reply = self.server.handler(request)
            self.wfile.write(json.dumps(reply).encode() + b"\n")
        except OSError:  # gone, or too slow
            return


def ask(path: Path, request: Answer, timeout: float = 10.0) -> Answer:
    """Send one request to a charger's socket and return its answer.

    Args:
        path: of the socket, or of a link to it.
        request: see the module.
        timeout: s.

    Raises:
        ConnectionError: nothing listens there.
        OSError: it does not answer in time, or may not be asked.
    """
    try:
        with socket.socket(socket.AF_UNIX) as connection, _short(path) as address:
            connection.settimeout(timeout)
            connection.connect(address)
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as stream:
                line = stream.readline()
    except FileNotFoundError as error:
        raise ConnectionError(f"{path}: {error.strerror}") from error
    if not line:
        raise ConnectionError(f"{path}: closed without an answer")
    reply = json.loads(line)
    assert isinstance(reply, dict)
    return reply


@contextlib.contextmanager
def _short(path: Path) -> Iterator[str]:
    """Yield a name of a socket that fits into an address, which holds 108 bytes at most."""
    if len(os.fsencode(path)) <= _LONGEST_PATH:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
