# SPDX-License-Identifier: Apache-2.0
"""Private folder by which processes of one user on this computer find each other, with an entry per charger."""

import contextlib
import fcntl
import os
import stat
from collections.abc import Iterator
from pathlib import Path

CONTROL = "control"
"""Name of a simulated charger's command socket, beside its ports."""


class Taken(Exception):
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
