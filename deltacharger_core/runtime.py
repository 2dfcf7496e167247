# SPDX-License-Identifier: Apache-2.0
"""Private folder by which processes of one user on this computer find each other, with an entry per charger."""

from __future__ import annotations

import contextlib
import fcntl
import os
import socket
import stat
import time
from collections.abc import Iterator
from pathlib import Path

from deltacharger_core.bounded_file import parse_json
from deltacharger_core.picklable import Picklable

CONTROL = "control"
"""Name of a simulated charger's command socket, beside its ports."""
_TERMINALS = "/dev/pts/"
_PATIENCE = 0.5  # s
_LONGEST_ANSWER = 16384  # bytes


class Taken(Picklable):
    """Another running process holds the lock.

    Args:
        process: its id; '' if it has not written it yet.
    """

    def __init__(self, process: str) -> None:
        self.process = process
        super().__init__(f"held by process {process}" if process else "held by another process")


def folder() -> Path:
    """Return the private folder, below XDG_RUNTIME_DIR or else /tmp."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    return Path(base if base and os.access(base, os.W_OK | os.X_OK) else "/tmp") / f"deltacharger-{os.getuid()}"


def charger(domain: int, namespace: str) -> Path:
    """Return the path of a charger in the private folder, by ROS domain and namespace."""
    name = namespace.strip("/").replace("/", "-")  # ROS names have no dash
    return folder() / (f"{domain}-{name}" if name else str(domain))


def servos(domain: int, namespace: str) -> Path:
    """Return the path of the servo port of a charger whose servos are connected to its board."""
    path = charger(domain, namespace)
    return path.with_name(f"{path.name}.servos")


def is_simulated(port: str) -> bool:
    """Return whether a serial port belongs to a simulated charger that runs on this computer.

    The port must be a pseudo-terminal, and the charger that listens on the socket beside it must confirm that it serves
    this port. No setting can claim it: a robot's port is no pseudo-terminal, and no charger confirms a pseudo-terminal
    that forwards to a cable. False if unknown.
    """
    try:
        path, terminal = Path(port), os.path.realpath(port)
        if not terminal.startswith(_TERMINALS) or not path.exists():
            return False
        answer = parse_json(_ask_for_ports(path.parent))
    except (OSError, ValueError):
        return False
    ports = answer.get("ports") if isinstance(answer, dict) else None
    return isinstance(ports, list) and terminal in ports


def _ask_for_ports(folder: Path) -> str:
    """Return the answer of a folder's charger, or the part received within _PATIENCE."""
    end, answer = time.monotonic() + _PATIENCE, b""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # the path may be too long for a socket address
    try:
        with socket.socket(socket.AF_UNIX) as charger:
            charger.settimeout(_PATIENCE)
            charger.connect(f"/proc/self/fd/{descriptor}/{CONTROL}")
            charger.sendall(b'{"command": "ports"}\n')
            while not answer.endswith(b"\n") and len(answer) < _LONGEST_ANSWER:
                charger.settimeout(max(end - time.monotonic(), 1e-3))
                more = charger.recv(_LONGEST_ANSWER)
                if not more:
                    break
                answer += more
    finally:
        os.close(descriptor)
    return answer.decode()


def make(folder: Path) -> None:
    """Create the private folder if missing.

    Raises:
        OSError: it cannot be created or belongs to another user.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode):
        raise PermissionError(f"{folder} is not a folder of this user")


@contextlib.contextmanager
def only_one(domain: int, namespace: str) -> Iterator[None]:
    """Hold the lock of this user's only charger in a ROS domain and namespace on this computer.

    The kernel releases the lock however the process ends. The file stays and has no meaning by itself.

    Raises:
        Taken: another process holds it.
        OSError: the private folder cannot be used.
    """
    path = charger(domain, namespace).with_suffix(".lock")
    make(path.parent)
    with open(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600), "r+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise Taken(file.read().strip()) from None
        file.truncate()
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
