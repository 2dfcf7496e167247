# SPDX-License-Identifier: Apache-2.0
"""One reader for every recording: with or without index and chunks, complete, truncated or damaged."""

import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcap", reason="reads with deltacharger[record]")

from mcap.writer import CompressionType, IndexType, Writer

from deltacharger_core.mcap_file import CUT_SHORT, DamagedRecording, McapFile, Raw, RecordingError

MESSAGES = [Raw(f"/{'ab'[n % 2]}", 1000 + n, 900 + n, f"message {n}".ljust(50).encode()) for n in range(100)]


def write(path: Path, chunk_size: int = 600, **options: Any) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size, CompressionType.NONE, **options)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channels = {"/a": writer.register_channel("/a", "cdr", schema), "/b": writer.register_channel("/b", "cdr", 0)}
        for message in MESSAGES:
            writer.add_message(channels[message.topic], message.received, message.data, message.published)
        writer.add_metadata("about", {"scene": "tape"})
        writer.finish()
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"index_types": IndexType.NONE},
    ],
)
def test_the_complete_content_is_read_from_every_kind_of_file(tmp_path: Path, options: dict[str, Any]) -> None:
    file = McapFile(write(tmp_path / "a.mcap", **options))
    assert list(file.messages()) == MESSAGES
    assert list(file.messages("/b")) == MESSAGES[1::2]
    assert file.types == {"/a": "std_msgs/msg/String", "/b": ""}
    assert file.definitions == {"/a": "string data", "/b": ""}
    assert file.counts == {"/a": 50, "/b": 50}
    assert (file.first, file.last, file.damage) == (1000, 1099, "")
    assert file.metadata == [("about", {"scene": "tape"})]
    assert file.metadata_named("nothing") == []


@pytest.mark.parametrize("share", [0.3, 0.7, 0.99])
@pytest.mark.parametrize("chunks", [True, False])
def test_a_truncated_file_is_read_to_its_end(tmp_path: Path, share: float, chunks: bool) -> None:
    path = write(tmp_path / "a.mcap", use_chunking=chunks)
    os.truncate(path, int(share * path.stat().st_size))
    file, found = McapFile(path), list[Raw]()
    with pytest.raises(DamagedRecording, match=CUT_SHORT):
        found.extend(file.messages())
    assert found == MESSAGES[: len(found)]
    assert 0.2 * share * len(MESSAGES) < len(found) == file.counts.total()
    assert (file.damage, file.first, file.last) == (CUT_SHORT, 1000, found[-1].received)


def test_damage_inside_ends_the_messages_with_an_error_and_other_files_are_refused(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap")
    data = path.read_bytes().replace(b"message 50", b"messAge 50", 1)
    path.write_bytes(data)
    found = list[Raw]()
    with pytest.raises(DamagedRecording, match=r"a\.mcap.*damaged"):
        found.extend(McapFile(path).messages())
    assert 30 < len(found) <= 50
    assert found == MESSAGES[: len(found)]
    for content in (b"", b"no recording at all", b"\x89MCAP0\r\n"):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=r"MCAP|empty"):
            McapFile(path)
    with pytest.raises(FileNotFoundError):
        McapFile(tmp_path / "none.mcap")


def test_of_a_folder_the_only_recording_is_read(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"holds no recording"):
        McapFile(tmp_path)
    (tmp_path / "metadata.yaml").touch()
    path = write(tmp_path / "bag_0.mcap")
    assert (McapFile(tmp_path).path, McapFile(tmp_path).counts.total()) == (path, len(MESSAGES))
    write(tmp_path / "bag_1.mcap")
    with pytest.raises(RecordingError, match=r"holds 2 recordings.*'bag_0\.mcap', 'bag_1\.mcap'"):
        McapFile(tmp_path)


def test_another_kind_of_bag_is_refused_with_the_command_that_converts_it(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    path.write_bytes(b"SQLite format 3\0")
    with pytest.raises(RecordingError, match=r"no MCAP file.*rosbags-convert"):
        McapFile(path)
