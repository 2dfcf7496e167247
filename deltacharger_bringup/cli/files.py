# SPDX-License-Identifier: Apache-2.0
"""Check the files that a command will read or write before it starts, so that no work is lost."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from deltacharger_bringup.cli.output import FAILED, WRONG_INPUT, CommandError, is_wrong_path

_PICTURES = (".png", ".pdf", ".svg", ".jpg", ".jpeg")


def file_to_read(flag: str, name: str) -> Path:
    """Return an existing path, which its reader checks; CommandError with exit code 2 if there is none."""
    if not Path(name).exists():
        raise CommandError(f"{flag} {name}: there is no such file", WRONG_INPUT)
    return Path(name)


def file_to_write(flag: str, name: str, kind: str = "", overwrite: bool = True) -> Path:
    """Return the path of a file that can be written.

    Args:
        flag: the option that names it.
        name: its value.
        kind: required suffix.
        overwrite: whether it may exist already.

    Raises:
        CommandError: it cannot or must not be written; exit code 2.
    """
    path = Path(name)
    if kind and path.suffix != kind:
        raise CommandError(f"{flag} '{name}': the name must end in {kind}", WRONG_INPUT, file=name)
    if not path.parent.is_dir():
        problem = f"{flag} {name}: the folder {path.parent} does not exist; create it"
        raise CommandError(problem, WRONG_INPUT, file=name)
    if path.is_dir() or not (os.access(path, os.W_OK) if path.exists() else _takes_files(path.parent)):
        raise CommandError(f"{flag} {name}: cannot be written; give another file", WRONG_INPUT, file=name)
    if path.exists() and not overwrite:
        problem = f"{path} exists: choose another name, or overwrite it with --force"
        raise CommandError(problem, WRONG_INPUT, file=name)
    return path


def picture_to_write(name: str) -> Path:
    """Return the path of `--picture`, with a suffix that matplotlib supports; errors as in `file_to_write`."""
    if Path(name).suffix.lower() not in _PICTURES:
        raise CommandError(f"--picture '{name}': the name must end in {', '.join(_PICTURES)}", WRONG_INPUT, file=name)
    return file_to_write("--picture", name)


def folder_to_write(flag: str, name: str) -> Path:
    """Return a folder, created if missing; errors as in `file_to_write`."""
    folder = Path(name)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        code = WRONG_INPUT if is_wrong_path(error) else FAILED
        raise CommandError(f"{flag} {name}: cannot be a folder ({error.strerror}); give another", code) from error
    if not _takes_files(folder):
        raise CommandError(f"{flag} {name}: the folder is not writable; give another one", WRONG_INPUT)
    return folder


def _takes_files(folder: Path) -> bool:
    """Whether a file can be created there. Permissions alone do not show this for root.

    Raises:
        OSError: the disk is full or fails.
    """
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError as error:
        if not is_wrong_path(error):
            raise
        return False
