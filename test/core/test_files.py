# SPDX-License-Identifier: Apache-2.0
"""Files are written completely or not at all; links are followed, pipes written directly."""

import os
import signal
from pathlib import Path

from deltacharger_core import files


def test_a_process_killed_while_writing_leaves_the_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"before")
    if (child := os.fork()) == 0:
        with files.atomic_write(path) as beside:
            beside.write_bytes(b"half")
            os.kill(os.getpid(), signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert (path.read_bytes(), len(list(tmp_path.iterdir()))) == (b"before", 2)
    files.remove_unfinished(tmp_path)
    assert [each.name for each in tmp_path.iterdir()] == ["file"]
    with files.atomic_write(path) as beside:
        beside.write_bytes(b"after")
    assert path.read_bytes() == b"after"


def test_a_link_is_followed_and_a_pipe_is_written_to(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    files.write_text(tmp_path / "link", "text")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "text"
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    files.write_text(tmp_path / "pipe", "through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
