# SPDX-License-Identifier: Apache-2.0
"""Where the processes of one user on this machine find each other: a private folder with a name for each charger."""

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
"""Name of the socket beside the ports of a simulated charger, on which it takes orders."""
_TERMINALS = "/dev/pts/"
_PATIENCE = 0.5  # s
_LONGEST_ANSWER = 16384  # bytes


class Taken(Picklable):
    """Another process that lives holds the lock.

    Args:
        process: its id, or '' where it has not written it yet.
    """

    def __init__(self, process: str) -> None:
        self.process = process
        super().__init__(f"held by process {process}" if process else "held by another process")


def folder() -> Path:
    """Return the private folder: below XDG_RUNTIME_DIR, else below /tmp."""
    base = os.environ.get("XDG_RUNTIME_DIR", "")
    return Path(base if base and os.access(base, os.W_OK | os.X_OK) else "/tmp") / f"deltacharger-{os.getuid()}"


def charger(domain: int, namespace: str) -> Path:
    """Return the path in the private folder that is that of a charger, by its ROS domain and namespace."""
    name = namespace.strip("/").replace("/", "-")  # ROS knows no names with a dash
    return folder() / (f"{domain}-{name}" if name else str(domain))


def servos(domain: int, namespace: str) -> Path:
    """Return the path of the port behind which the servos of a charger are, where they hang on its board."""
    path = charger(domain, namespace)
    return path.with_name(f"{path.name}.servos")


def is_simulated(port: str) -> bool:
    """Return whether a serial port is that of a simulated charger which runs on this computer.

    It is where the port is a pseudo-terminal and the charger whose socket listens beside it says that it serves this
    one. No setting says so: a robot's port is no terminal, and no charger serves a terminal that passes a cable on.
    False where unknown.
    """
    try:
        path, terminal = Path(port), os.path.realpath(port)
        if not terminal.startswith(_TERMINALS) or not path.exists():
            return False
        told = parse_json(_ask_for_ports(path.parent))
    except (OSError, ValueError):
        return False
    ports = told.get("ports") if isinstance(told, dict) else None
    return isinstance(ports, list) and terminal in ports


def _ask_for_ports(folder: Path) -> str:
    """Return what the charger of a folder answers within _PATIENCE, however slowly it does."""
    end, answer = time.monotonic() + _PATIENCE, b""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)  # a path may be longer than an address holds
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
    """Make the private folder where it is missing.

    Raises:
        OSError: it cannot be made, or belongs to somebody else.
    """
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    found = folder.lstat()
    if found.st_uid != os.getuid() or not stat.S_ISDIR(found.st_mode):
        raise PermissionError(f"{folder} is not a folder of this user")


@contextlib.contextmanager
def only_one(domain: int, namespace: str) -> Iterator[None]:
    """Be the only charger of a ROS domain and namespace that this user runs on this machine.

    The kernel gives the lock back when the process ends, however it ends; the file stays and means nothing by itself.

    Raises:
        Taken: another process is it.
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
