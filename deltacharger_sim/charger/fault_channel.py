# SPDX-License-Identifier: Apache-2.0
"""Cause faults in a simulated charger that runs in another process, through a Unix socket beside its ports.

Each connection carries one JSON object on one line each way. Requests: {"command": "begin", "kind", "last", "servo",
"amount"} with the keys of a scene's fault, {"command": "clear"} and {"command": "active"}. Answers:
{"success": true, "active": [...]} or {"success": false, "error"}. Only the user who
runs the charger may connect. Bytes and pauses are bounded on both sides, and clients do not wait for each other.
"""

import contextlib
import json
import os
import socket
import socketserver
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltacharger_core import runtime
from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_sim.charger.faults import Fault, Faults

SOCKET = runtime.CONTROL
"""Name of the socket in the ports' folder."""
_LONGEST_LINE = 16384  # bytes of a request
_LONGEST_ANSWER = 2**18  # bytes
_PATIENCE = 1.0  # s for a client to send its line and take the answer
_QUEUE = 128  # clients that wait to be accepted
_POLL = 0.05  # s until a server notices that it is to end

_ENTRY = {"kind", "servo", "amount", "remaining_s"}  # keys of an active fault

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
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(_PATIENCE)
            connection.connect(str(path))
    except BlockingIOError:  # a process listens, but hangs
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
        faults.begin_fault(fault)
    elif command == "clear":
        faults.clear()
    elif command != "active":
        return {"success": False, "error": f"unknown command {command!r}: give begin, clear or active"}
    return {"success": True, "active": faults.active()}


class _Server(socketserver.ThreadingUnixStreamServer):
    request_queue_size = _QUEUE
    daemon_threads, block_on_close = True, False

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Do nothing: the client is gone or silent."""


class ControlServer:
    """Answers requests on a Unix socket, each client in a thread of its own; silent clients are dropped.

    Args:
        path: of the socket; an existing one is replaced.
        handler: answers a request.

    Raises:
        OSError: the socket cannot be created, or another file is in its place.
    """

    def __init__(self, path: Path, handler: Callable[[Any], Answer]) -> None:
        class Conversation(socketserver.StreamRequestHandler):
            timeout = _PATIENCE

            def handle(self) -> None:
                reply = _answered(handler, self.rfile.readline(_LONGEST_LINE))
                self.wfile.write(json.dumps(reply).encode() + b"\n")

        self._path = path
        if path.is_socket():
            path.unlink()
        self._server = _Server(str(path), Conversation)
        path.chmod(0o600)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(_POLL,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and remove the socket."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()
        self._path.unlink(missing_ok=True)


def _answered(handler: Callable[[Any], Answer], line: bytes) -> Answer:
    try:
        request = json.loads(line)
    except (ValueError, RecursionError):
        return {"success": False, "error": "not one line of JSON"}
    try:
        return handler(request)
    except Exception as error:  # one bad request must not end the service
        return {"success": False, "error": f"{type(error).__name__}: {error}"}


def ask(path: Path, request: Answer, timeout: float = 10.0) -> Answer:
    """Send one request to a charger's socket and return its answer.

    Args:
        path: of the socket, or of a link to it.
        request: see the module.
        timeout: for each step, s.

    Raises:
        ConnectionError: no process listens there.
        OSError: the answer is late or invalid, or the user may not connect.
    """
    try:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(timeout)
            connection.connect(str(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            line = connection.makefile("rb").readline(_LONGEST_ANSWER)
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


def _is_answer(reply: Any) -> bool:
    if not isinstance(reply, dict) or reply.get("success") is not True:
        return isinstance(reply, dict) and isinstance(reply.get("error"), str)
    active = reply.get("active")
    return isinstance(active, list) and all(isinstance(each, dict) and set(each) >= _ENTRY for each in active)
