# SPDX-License-Identifier: Apache-2.0
"""The folder of records has bounds on files and bytes; the oldest is removed first, never an open or foreign file."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pytest

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from mcap.writer import Writer

from deltacharger_core.files import flush
from deltacharger_records.recording.folder import ABOUT, PARTIAL, RecordFolder, head, problem_of, safe_id
from deltacharger_records.recording.mcap_recording import McapStream

BEGAN = 1_795_000_000 * 10**9
SECOND = 10**9
NAME = "20261118T110640Z-id_0-OK.mcap"
"""Of the first record of `make`."""


def make(folder: RecordFolder, number: int, size: int, ends: bool) -> tuple[Path, BinaryIO]:
    """Make a record of `size` bytes after its head."""
    began, request = BEGAN + number * SECOND, f"id {number}"
    path, stream = folder.create(began, request)
    McapStream(stream, {}, live=True, metadata=[(ABOUT, head({"version": "0"}, began, request))])
    stream.write(b"x" * size)
    flush(stream)
    if ends:
        path = end(folder, path, stream, "OK")
        stream.close()
    return path, stream


def end(folder: RecordFolder, path: Path, stream: BinaryIO, ending: str) -> Path:
    """Finish a record, whose packed content is the same."""
    return folder.finish(path, stream, ending, lambda new: shutil.copyfileobj(path.open("rb"), new))


def contents(folder: Path) -> dict[str, object]:
    """Return the files in a folder with their content and time of change."""
    return {
        path.name: (path.read_bytes() if path.is_file() else None, path.lstat().st_mtime_ns, path.lstat().st_mode)
        for path in folder.iterdir()
    }


@pytest.mark.parametrize(
    ("request_id", "name"),
    [
        *(("../../etc/passwd", "etc_passwd"), ("", ""), ("a b/ü", "a_b"), ("x" * 300, "x" * 60), ("...", "")),
        *(("a-b", "a_b"), ("-7-OK", "7_OK"), ("é" * 5000, ""), ("/" * 1200 + "abc", ""), ("a\nb\x1b[2J", "a_b_2J")),
    ],
    ids=range(10),
)
def test_no_request_id_leaves_the_folder_or_its_record(tmp_path: Path, request_id: str, name: str) -> None:
    assert safe_id(request_id) == name
    folder = RecordFolder(tmp_path, 9, 10**9)
    for _ in range(2):
        path, stream = folder.create(BEGAN, request_id)
        about = head({"version": "0", "scene": "é" * 5000, "namespace": "/" + "a" * 5000}, BEGAN, request_id)
        McapStream(stream, {}, live=True, metadata=[(ABOUT, about)])
        flush(stream)
        assert problem_of(path) == ""
        assert problem_of(end(folder, path, stream, "CRITICAL_ANGLE")) == ""
    assert len(folder.entries()) == len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize(
    ("files", "most", "dockings"),
    [
        (2, 10**6, [(0, True)] * 5),
        (5, 700, [(200, True), (0, True), (200, True), (100, True), (300, True)]),
        (1, 200, [(300, True), (300, False), (0, True), (10, False), (10, True)]),
        (3, 1000, [(400, False), (400, False), (400, False), (1, True), (1, True)]),
    ],
)
def test_the_bounds_hold_except_for_dockings_in_progress(
    tmp_path: Path, files: int, most: int, dockings: list[tuple[int, bool]]
) -> None:
    other = tmp_path / "notes.mcap"
    other.write_bytes(b"mine" * 1000)
    folder, running = RecordFolder(tmp_path, files, most), list[tuple[Path, BinaryIO]]()
    for number, (size, ends) in enumerate(dockings):
        made = make(folder, number, size, ends)
        running += [] if ends else [made]
        gone = folder.prune()
        left = folder.entries()
        ended = [entry for entry in left if not entry.under_way]
        assert other.exists()
        assert all(each.exists() for each, _ in running)
        within = len(left) <= files and sum(entry.size for entry in left) <= most
        assert within or not ended, "all removable records are removed"
        assert gone == sorted(gone)
        assert all(entry.path.name > lost.name for entry in ended for lost in gone), "the oldest are removed first"
    for _, stream in running:
        stream.close()


def test_the_file_of_a_killed_recorder_is_a_record(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 1, 10**9)
    _, stream = make(folder, 0, 10, ends=False)
    make(folder, 1, 10, ends=True)
    assert any(path.name.endswith(PARTIAL) for path in tmp_path.iterdir()), "it is under way"
    stream.close()  # as the kernel does with the files of a process that was killed
    folder.prune()
    (left,) = tmp_path.iterdir()
    assert not left.name.endswith(PARTIAL)


def test_a_record_that_cannot_be_packed_stays_as_it_is(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    path, stream = make(folder, 0, 10, ends=False)
    before = path.read_bytes()

    def full(new: BinaryIO) -> None:
        new.write(b"half")
        raise OSError(28, "No space left on device")

    with stream:
        assert folder.finish(path, stream, "OK", full).name == NAME
    assert [(each.name, each.read_bytes()) for each in tmp_path.iterdir()] == [(NAME, before)]


def _bag(path: Path, library: str, metadata: str = "") -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", library)
        if metadata:
            writer.add_metadata(metadata, {"request_id": "id 0", "began": str(BEGAN)})
        writer.finish()


def _record(path: Path) -> None:
    """Put a record of ours there, renamed by a user."""
    with path.open("wb") as stream:
        McapStream(stream, {}, live=True, metadata=[(ABOUT, head({}, BEGAN, "id 0"))])


FOREIGN: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("my bag of yesterday"),
    "a recording of ros2 bag": lambda path: _bag(path, "libmcap 1.3"),
    "a foreign file with our metadata": lambda path: _bag(path, "libmcap", ABOUT),
    "a renamed record": _record,
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "a link to a record": lambda path: path.symlink_to(NAME),
    "a link to itself": lambda path: path.symlink_to(path),
}
LIKE_OURS = (
    *("20260101T000000Z.mcap", "20261118T110640Z-id_0-OK-keep.mcap", "20261118T110641Z-my_bag_of_yesterday.mcap"),
    *("20261118T110641Z-id_1-OK (copy).mcap", NAME.replace("-OK", "-\n\x1b[2J")),
)
UNLIKE_OURS = (f".{NAME}", "20261118T110641Z-id_1-OK.mcap.bak")


@pytest.mark.parametrize("kind", FOREIGN)
def test_foreign_files_are_unchanged_not_counted_and_stop_no_record(tmp_path: Path, kind: str) -> None:
    for name in (*LIKE_OURS, *UNLIKE_OURS):
        FOREIGN[kind](tmp_path / name)
    before = contents(tmp_path)
    folders = [RecordFolder(tmp_path, 2, 10**9) for _ in range(2)]
    made = [make(folders[number % 2], number, 10, ends=True)[0] for number in range(4)]
    folders[0].prune()
    assert [entry.path for entry in folders[1].entries()] == made[-2:], "the newest of both, up to the limit"
    after = contents(tmp_path)
    assert {name: after.get(name) for name in before} == before
    assert len(after) == len(before) + 2
    assert set(folders[1].passed_by) == set(LIKE_OURS)
    assert all(folders[1].passed_by.values())


@pytest.mark.parametrize("kind", [name for name in FOREIGN if name != "a renamed record"])
def test_an_existing_file_with_the_same_name_is_avoided(tmp_path: Path, kind: str) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    for name in (NAME, NAME.replace("-OK.mcap", PARTIAL)):
        FOREIGN[kind](tmp_path / name)
    before = contents(tmp_path)
    path, _ = make(folder, 0, 10, ends=True)
    assert path.name == "20261118T110640Z-id_0-2-OK.mcap"
    after = contents(tmp_path)
    assert {name: after[name] for name in before} == before
    assert [entry.path for entry in folder.entries()] == [path]


def test_a_replaced_record_is_no_longer_ours(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    path, stream = make(folder, 0, 10, ends=False)
    path.rename(tmp_path / "mine")
    path.write_text("mine, too")
    before = contents(tmp_path)
    with stream:
        for finish in (folder.forget, lambda *file: end(folder, *file, "OK")):
            with pytest.raises(FileNotFoundError, match="another program moved"):
                finish(path, stream)
    assert contents(tmp_path) == before


def test_an_unremovable_record_is_reported_and_the_next_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    stuck, next_, *_ = (make(folder, number, 10, ends=True)[0] for number in range(3))
    unlink = Path.unlink

    def refuse(path: Path, missing_ok: bool = False) -> None:
        if path == stuck:
            raise PermissionError(1, "Operation not permitted")
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", refuse)
    small = RecordFolder(tmp_path, 2, 10**9)
    assert small.prune() == [next_]
    assert small.passed_by == {stuck.name: "cannot be removed: Operation not permitted"}


def test_a_damaged_head_is_read_without_errors_and_large_contents_are_not_read(tmp_path: Path) -> None:
    path = tmp_path / NAME
    _record(path)
    whole = path.read_bytes()
    for place in range(0, len(whole), 3):
        for more in (b"", b"\xff" + whole[place + 1 :], b"\0" + whole[place:]):
            path.write_bytes(whole[:place] + more)
            assert isinstance(problem_of(path), str)
    os.truncate(path, 2**40)
    assert isinstance(problem_of(path), str)
