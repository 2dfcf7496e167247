# SPDX-License-Identifier: Apache-2.0
"""A folder of records is bounded in files and bytes; the oldest goes first, one under way and other people's never."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltacharger_records.recording.folder import PARTIAL, RecordFolder, is_record, safe_id

WALL = 1_795_000_000.0


def make(folder: RecordFolder, number: int, size: int, ends: bool) -> tuple[Path, BinaryIO]:
    path, stream = folder.create(WALL + number, f"id {number}")
    stream.write(b"x" * size)
    stream.flush()
    if ends:
        path = folder.finish(path, "OK")
        stream.close()
    return path, stream


def test_the_name_tells_when_for_whom_and_how_it_ended(tmp_path: Path) -> None:
    path, _ = make(RecordFolder(tmp_path, 9, 10**9), 0, 1, ends=True)
    assert path.name == "20261118T110640Z-id_0-OK.mcap"
    assert is_record(path)


@pytest.mark.parametrize(
    ("given_", "name"),
    [
        ("../../etc/passwd", "etc_passwd"),
        ("", ""),
        ("a b/ü", "a_b"),
        ("x" * 300, "x" * 60),
        ("...", ""),
        ("a-b", "a_b"),
    ],
)
def test_a_request_id_cannot_leave_the_folder(given_: str, name: str) -> None:
    assert safe_id(given_) == name


def test_two_dockings_in_one_second_are_two_records(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    paths = {make(folder, 0, 1, ends)[0] for ends in (True, True, False, False)}
    assert len(paths) == len(list(tmp_path.iterdir())) == 4


@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 5),
    st.integers(100, 1000),
    st.lists(st.tuples(st.integers(0, 400), st.booleans()), min_size=1, max_size=12),
)
def test_the_bounds_hold_but_for_dockings_under_way(
    tmp_path_factory: pytest.TempPathFactory, files: int, most: int, dockings: list[tuple[int, bool]]
) -> None:
    path = tmp_path_factory.mktemp("records")
    other = path / "notes.mcap"
    other.write_bytes(b"mine" * 1000)
    folder, running = RecordFolder(path, files, most), list[tuple[Path, BinaryIO]]()
    for number, (size, ends) in enumerate(dockings):
        made = make(folder, number, size, ends)
        if not ends:
            running.append(made)
        gone = folder.prune()
        left = folder.entries()
        assert other.exists()
        assert all(each.exists() for each, _ in running)
        assert gone == sorted(gone)
        ended = [entry for entry in left if not entry.under_way]
        within = len(left) <= files and sum(entry.size for entry in left) <= most
        assert within or not ended, "whatever may go has gone"
        assert all(entry.path.name > lost.name for entry in ended for lost in gone), "the oldest went first"
    for _, stream in running:
        stream.close()


def test_what_a_killed_recorder_left_is_a_record_like_others(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 1, 10**9)
    _, stream = make(folder, 0, 10, ends=False)
    make(folder, 1, 10, ends=True)
    assert any(path.name.endswith(PARTIAL) for path in tmp_path.iterdir()), "it is under way"
    stream.close()  # as the kernel does with the files of a process that was killed
    folder.prune()
    (left,) = tmp_path.iterdir()
    assert not left.name.endswith(PARTIAL)


def test_a_folder_that_cannot_be_is_told(tmp_path: Path) -> None:
    (tmp_path / "records").write_text("a file")
    with pytest.raises(OSError, match="records"):
        RecordFolder(tmp_path / "records", 9, 10**9).create(WALL, "")
