# SPDX-License-Identifier: Apache-2.0
"""Topics of the camera in a recording, and reading of truncated recordings."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.ros.recording import CAMERA_INFO, COLOR, DEPTH, IMAGE, INFO, CameraRecording, CameraTopics

pytest.importorskip("mcap", reason="reads with deltacharger[record]")

from mcap.writer import CompressionType, Writer

pytestmark = pytest.mark.ros

OURS = {"/color/image_raw": IMAGE, "/depth/image_raw": IMAGE, "/color/camera_info": CAMERA_INFO}


def recorded(path: Path, types: dict[str, str], rounds: int = 3, chunk: int = 200, finish: bool = True) -> Path:
    """`rounds` messages of each topic in turn, 60 bytes each, with their topic and number."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="test")
        channels = {}
        for topic, kind in types.items():
            schema = writer.register_schema(kind, "ros2msg", b"")
            channels[topic] = writer.register_channel(topic, "cdr", schema)
        for number in range(rounds):
            for topic, channel in channels.items():
                writer.add_message(channel, 1000 + number, f"{topic} {number}".ljust(60).encode(), 0)
        if finish:
            writer.finish()
    return path


def of(names: str) -> dict[str, str]:
    """Return types of topics by their names."""
    kinds = {
        "camera_info": CAMERA_INFO,
        "compressed": "sensor_msgs/msg/CompressedImage",
        "chatter": "std_msgs/msg/Bool",
    }
    return {name: kinds.get(name.rsplit("/", 1)[1], IMAGE) for name in names.split()}


def topics(tmp_path: Path, types: dict[str, str], asked: CameraTopics | None = None) -> tuple[str, str, str]:
    found = CameraRecording(recorded(tmp_path / "rec.mcap", types), asked).topics
    return found.color, found.depth, found.info


def test_messages_have_their_order_and_kind(tmp_path: Path) -> None:
    recording = CameraRecording(recorded(tmp_path / "rec.mcap", {**OURS, "/chatter": "std_msgs/msg/String"}))
    assert recording.images == 3
    found = [(each.kind, each.time, each.data.decode().strip()) for each in recording.messages()]
    kinds = {COLOR: "/color/image_raw", DEPTH: "/depth/image_raw", INFO: "/color/camera_info"}
    assert found == [(kind, 1000 + number, f"{topic} {number}") for number in range(3) for kind, topic in kinds.items()]
    assert [each.kind for each in recording.messages(COLOR, INFO)] == [COLOR, INFO] * 3


@pytest.mark.parametrize(
    ("names", "asked", "found"),
    [
        (
            "/c/color/image_raw /c/depth/image_rect_raw /c/aligned_depth_to_color/image_raw /c/color/camera_info",
            None,
            "/c/color/image_raw /c/aligned_depth_to_color/image_raw /c/color/camera_info",
        ),
        (
            "/oak/rgb/image_raw /oak/stereo/image_raw /oak/rgb/camera_info",
            CameraTopics("oak/rgb/image_raw", "/oak/stereo/image_raw"),
            "/oak/rgb/image_raw /oak/stereo/image_raw /oak/rgb/camera_info",
        ),
        ("/color/image_raw", None, "/color/image_raw  "),
    ],
)
def test_topics_of_other_drivers_are_found_or_named(
    tmp_path: Path, names: str, asked: CameraTopics | None, found: str
) -> None:
    assert topics(tmp_path, of(names), asked) == tuple(found.split(" "))


@pytest.mark.parametrize(
    ("names", "asked", "noun"),
    [
        ("/a/color/image_raw /b/color/image_raw", None, "/a/color/image_raw, /b/color/image_raw"),
        ("/color/image_raw /depth/image_raw /aligned_depth_to_color/image_raw", None, "several depth"),
        ("/color/image_raw", CameraTopics("d"), "/d"),
        ("/color/image_raw/compressed", None, "name one of /color/image_raw/compressed"),
        ("/color/compressed", CameraTopics("/color/compressed"), "CompressedImage"),
    ],
)
def test_ambiguous_compressed_and_missing_topics_are_refused_with_the_choices(
    tmp_path: Path, names: str, asked: CameraTopics | None, noun: str
) -> None:
    with pytest.raises(RecordingError, match=noun) as refused:
        topics(tmp_path, of(names), asked)
    assert str(tmp_path / "rec.mcap") in str(refused.value)


def test_a_truncated_or_damaged_recording_is_read_as_far_as_it_goes(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rec.mcap", OURS, rounds=50, finish=False)
    path.write_bytes(path.read_bytes()[:-30])
    recording = CameraRecording(path)
    messages = recording.messages(COLOR)
    assert 50 >= len(list(itertools.islice(messages, recording.images))) == recording.images > 40
    with pytest.raises(RecordingError, match="ends early"):
        next(messages)
