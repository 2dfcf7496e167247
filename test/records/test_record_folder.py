# SPDX-License-Identifier: Apache-2.0
"""The folder of records has a bound; the one unchanged for the longest time is removed first, never a foreign file."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from mcap.writer import Writer

from deltacharger_bringup.records.recording.folder import ABOUT, RecordFolder, is_ours, safe_id
from deltacharger_bringup.records.recording.mcap_recording import McapWriter

BEGAN = 1_795_000_000 * 10**9
NAME = "20261118T110640Z-id_0-OK.mcap"
"""Of the first record of `make`."""


def make(folder: RecordFolder, number: int, size: int = 10) -> Path:
    """Make a record of `size` bytes after its head."""
    path, stream = folder.create(BEGAN + number * 10**9, f"id {number}")
    McapWriter(stream, {}, [(ABOUT, {"version": "0"})])
    stream.write(b"x" * size)
    stream.close()
    os.utime(path, (number, number))
    return folder.finish(path, "OK")


def contents(folder: Path) -> dict[str, object]:
    """Return the files in a folder with their content and time of change."""
    return {
        path.name: (path.read_bytes() if path.is_file() else None, path.lstat().st_mtime_ns, path.lstat().st_mode)
        for path in folder.iterdir()
    }


@pytest.mark.parametrize(
    ("request_id", "name"),
    [("../../etc/passwd", "etc_passwd"), ("", ""), ("x" * 300, "x" * 60), ("...", ""), ("a\nb\x1b[2J", "a_b_2J")],
    ids=range(5),
)
def test_no_request_id_leaves_the_folder_or_its_record(tmp_path: Path, request_id: str, name: str) -> None:
    assert safe_id(request_id) == name
    folder = RecordFolder(tmp_path, 10**9)
    made = [folder.create(BEGAN, request_id)[0] for _ in range(2)]
    assert sorted(tmp_path.iterdir()) == sorted(made)


def test_the_oldest_records_are_removed_until_the_bound_holds(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 5_000)
    made = [make(folder, number, 1_500) for number in range(4)]
    folder.prune()
    assert sorted(tmp_path.iterdir()) == made[1:]
    os.utime(made[1])  # one that is still written, such as another charger's long charge
    RecordFolder(tmp_path, 100).prune()
    assert list(tmp_path.iterdir()) == [made[1]], "the newest may be in progress"


def _bag(path: Path, library: str, metadata: str) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", library)
        writer.add_metadata(metadata, {"request_id": "id 0"})
        writer.finish()


FOREIGN: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("my bag of yesterday"),
    "a foreign file with our metadata": lambda path: _bag(path, "libmcap", ABOUT),
    "a file of our library without our metadata": lambda path: _bag(path, "deltacharger", "docking"),
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "a link to a record": lambda path: path.symlink_to(NAME),
}
LIKE_OURS = ("20260101T000000Z.mcap", "20261118T110640Z-id_0-OK.mcap", "20261118T110640Z-id_0.mcap.partial")


@pytest.mark.parametrize("kind", FOREIGN)
def test_foreign_files_are_unchanged_and_stop_no_record(tmp_path: Path, kind: str) -> None:
    for name in LIKE_OURS:
        FOREIGN[kind](tmp_path / name)
    before = contents(tmp_path)
    made = [make(RecordFolder(tmp_path, 100), number) for number in range(2)]
    RecordFolder(tmp_path, 100).prune()
    after = contents(tmp_path)
    assert {name: after.get(name) for name in before} == before
    assert set(after) - set(before) == {made[-1].name}
    assert is_ours(made[-1])


def test_a_damaged_head_is_read_without_errors_and_large_contents_are_not_read(tmp_path: Path) -> None:
    path = make(RecordFolder(tmp_path, 10**9), 0)
    whole = path.read_bytes()
    for place in range(0, len(whole), 7):
        for more in (b"", b"\xff" + whole[place + 1 :], b"\0" + whole[place:]):
            path.write_bytes(whole[:place] + more)
            assert is_ours(path) in (True, False)
    os.truncate(path, 2**40)
    assert is_ours(path) in (True, False)
