# SPDX-License-Identifier: Apache-2.0
"""The folder of records has bounds on files and bytes; the oldest is removed first, never an open or foreign one."""

from __future__ import annotations

import os
import shutil
import socket
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from mcap.writer import Writer

from deltacharger_core.files import flush
from deltacharger_records.recording.folder import RecordFolder
from deltacharger_records.recording.mcap_recording import McapStream
from deltacharger_records.recording.own import ABOUT, PARTIAL, head, is_named_like_one, look, safe_id

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
        path = folder.finish(path, stream, "OK")
        stream.close()
    return path, stream


def contents(folder: Path) -> dict[str, object]:
    """Return the files in a folder with their content and time of change."""
    return {
        path.name: (path.read_bytes() if path.is_file() else None, path.lstat().st_mtime_ns, path.lstat().st_mode)
        for path in folder.iterdir()
    }


def test_the_name_has_time_request_and_ending(tmp_path: Path) -> None:
    path, _ = make(RecordFolder(tmp_path, 9, 10**9), 0, 1, ends=True)
    assert path.name == NAME
    assert is_named_like_one(NAME)
    assert look(path).problem == ""


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


@pytest.mark.parametrize("request_id", ["", "r/1", "-7-OK", "é" * 5000, "/" * 1200 + "abc", "a\nb\x1b[2J", "\udcff"])
def test_a_record_is_ours_with_any_request_id(tmp_path: Path, request_id: str) -> None:
    request_id = request_id.encode(errors="replace").decode()  # as in a message
    folder = RecordFolder(tmp_path, 9, 10**9)
    for _ in range(2):
        path, stream = folder.create(BEGAN, request_id)
        about = head({"version": "0", "scene": "é" * 5000, "namespace": "/" + "a" * 5000}, BEGAN, request_id)
        McapStream(stream, {}, live=True, metadata=[(ABOUT, about)])
        flush(stream)
        assert look(path).problem == ""
        assert look(folder.finish(path, stream, "CRITICAL_ANGLE")).problem == ""


def test_two_dockings_in_one_second_are_two_records(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    paths = {make(folder, 0, 1, ends)[0] for ends in (True, True, False, False)}
    assert len(paths) == len(list(tmp_path.iterdir())) == 4
    assert len(folder.entries()) == 4


@settings(deadline=None, max_examples=60)
@given(
    st.integers(1, 5),
    st.integers(200, 1500),
    st.lists(st.tuples(st.integers(0, 400), st.booleans()), min_size=1, max_size=12),
)
def test_the_bounds_hold_except_for_dockings_in_progress(
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
        assert within or not ended, "all removable records are removed"
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


def test_only_the_packed_copy_of_a_recorder_killed_while_packing_is_removed(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 9, 10**9)
    path, stream = make(folder, 0, 10, ends=True)
    beside = tmp_path / f".{path.name}.partial"
    with beside.open("xb") as packing, pytest.raises(FileExistsError), folder.rewriting(path, stream):
        pytest.fail("another process packs it already")
    shutil.copyfile(path, beside)
    assert folder.prune() == [beside]
    assert [each.path for each in folder.entries()] == [path]
    assert packing.closed


def test_a_hidden_record_belongs_to_the_user(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path, 1, 10**9)
    path, _ = make(folder, 0, 10, ends=True)
    hidden = path.rename(path.with_name(f".{path.name}"))
    make(folder, 1, 10, ends=True)
    folder.prune()
    assert hidden.exists()


def test_an_impossible_folder_is_reported(tmp_path: Path) -> None:
    (tmp_path / "records").write_text("a file")
    with pytest.raises(OSError, match="records"):
        RecordFolder(tmp_path / "records", 9, 10**9).create(BEGAN, "")


def _bag(path: Path, library: str, metadata: str = "") -> None:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2", library)
        if metadata:
            writer.add_metadata(metadata, {"request_id": "id 0", "began": str(BEGAN)})
        writer.finish()


def _socket(path: Path) -> None:
    folder = os.open(path.parent, os.O_RDONLY)  # by its descriptor: the path may be too long for a socket
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(f"/proc/self/fd/{folder}/{path.name}")
    os.close(folder)


def _record(path: Path) -> None:
    """Put a record of ours there, renamed by a user."""
    with path.open("wb") as stream:
        McapStream(stream, {}, live=True, metadata=[(ABOUT, head({}, BEGAN, "id 0"))])


FOREIGN: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("my bag of yesterday"),
    "zeros": lambda path: path.write_bytes(bytes(5000)),
    "a recording of ros2 bag": lambda path: _bag(path, "libmcap 1.3"),
    "a recording of ours, not of a docking": lambda path: _bag(path, "deltacharger", "docking"),
    "a foreign file with our metadata": lambda path: _bag(path, "libmcap", ABOUT),
    "a renamed record": _record,
    "a folder": Path.mkdir,
    "a pipe": os.mkfifo,
    "a socket": _socket,
    "a dangling link": lambda path: path.symlink_to("nowhere"),
    "a link to a record": lambda path: path.symlink_to(NAME),
    "a link to itself": lambda path: path.symlink_to(path),
}
names_like_ours = st.builds(
    "{}{}{}{}".format,
    st.sampled_from(["", "."]),
    st.sampled_from(
        [f"{day}Z" for day in ("20260101T000000", "20261118T110640", "20261118T110641", "00000000T000000")]
    ),
    st.sampled_from(["", "-my_bag_of_yesterday", "-id_0-keep", "-id_0-OK-keep", "-id_1-OK (copy)", "-\n\x1b[2J", "-2"]),
    st.sampled_from([".mcap", ".mcap.partial", ".MCAP", ".mcap.bak"]),
)


@settings(deadline=None, max_examples=60)
@given(st.dictionaries(names_like_ours, st.sampled_from(sorted(FOREIGN)), max_size=12), st.integers(1, 4))
def test_foreign_files_are_unchanged_not_counted_and_stop_no_record(
    tmp_path_factory: pytest.TempPathFactory, foreign: dict[str, str], files: int
) -> None:
    path = tmp_path_factory.mktemp("records")
    for name, kind in foreign.items():
        FOREIGN[kind](path / name)
    before = contents(path)
    first, second = RecordFolder(path, files, 10**9), RecordFolder(path, files, 10**9)
    made = [make((first, second)[number % 2], number, 10, ends=True)[0] for number in range(5)]
    first.prune()
    assert [entry.path for entry in second.entries()] == made[-files:], "the newest of both, up to the limit"
    after = contents(path)
    assert {name: after.get(name) for name in before} == before
    assert len(after) == len(before) + files
    named = {name for name in before if is_named_like_one(name)}
    assert set(second.passed_by) == named
    assert all(second.passed_by.values())


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
        for end in (folder.forget, lambda *file: folder.finish(*file, "OK")):
            with pytest.raises(FileNotFoundError, match="another program moved"):
                end(path, stream)
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


def test_a_copied_folder_is_a_folder_of_records(tmp_path: Path) -> None:
    folder = RecordFolder(tmp_path / "a", 9, 10**9)
    made = [make(folder, number, 10, ends=True)[0] for number in range(3)]
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    assert [path.name for path in RecordFolder(tmp_path / "b", 1, 10**9).prune()] == [path.name for path in made[:2]]


@settings(deadline=None, max_examples=200)
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.integers(0, 255)), min_size=1, max_size=4), st.floats(0.0, 1.0))
def test_a_damaged_head_is_read_without_errors(
    tmp_path_factory: pytest.TempPathFactory, changes: list[tuple[float, int]], share: float
) -> None:
    path = tmp_path_factory.mktemp("records") / NAME
    _record(path)
    data = bytearray(path.read_bytes())
    for place, value in changes:
        data[int(place * (len(data) - 1))] = value
    path.write_bytes(data[: int(share * len(data))])
    assert isinstance(look(path).problem, str)


def _unpacked(path: Path, size: int) -> None:
    """Add a chunk after the header that unpacks to `size` bytes."""
    import zstandard
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Header

    packer = zstandard.ZstdCompressor(level=1).compressobj(size=size)
    packed = b"".join(packer.compress(bytes(2**20)) for _ in range(size // 2**20)) + packer.flush()
    builder = RecordBuilder()
    Header("ros2", "deltacharger").write(builder)
    Chunk("zstd", packed, 0, 0, 0, size).write(builder)
    path.write_bytes(b"\x89MCAP0\r\n" + builder.end())


def test_large_contents_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / NAME).open("wb") as file:
        file.truncate(2**40)
    bomb = tmp_path / f"x{NAME}"
    _unpacked(bomb, 2**28)
    assert bomb.stat().st_size < 32_768
    tracemalloc.start()
    try:
        for path in (tmp_path / NAME, bomb):
            assert look(path).problem == "docking_recorder_node did not write it"
        assert tracemalloc.get_traced_memory()[1] < 10 * 2**20
    finally:
        tracemalloc.stop()
