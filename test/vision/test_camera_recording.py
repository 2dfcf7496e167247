# SPDX-License-Identifier: Apache-2.0
"""Topics of the camera in a recording, and reading of truncated recordings."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from deltacharger_core.mcap_file import RecordingError
from deltacharger_vision.cameras.recording import (
    CAMERA_INFO,
    COLOR,
    DEPTH,
    IMAGE,
    INFO,
    CameraRecording,
    CameraTopics,
)

pytest.importorskip("mcap", reason="reads with deltacharger[record]")

from mcap.writer import CompressionType, Writer

COMPRESSED = "sensor_msgs/msg/CompressedImage"
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


def topics(tmp_path: Path, types: dict[str, str], asked: CameraTopics | None = None) -> tuple[str, str, str]:
    found = CameraRecording(recorded(tmp_path / "rec.mcap", types), asked).topics
    return found.color, found.depth, found.info


def refusal(tmp_path: Path, types: dict[str, str], asked: CameraTopics | None = None) -> str:
    with pytest.raises(RecordingError) as refused:
        topics(tmp_path, types, asked)
    assert str(tmp_path / "rec.mcap") in str(refused.value)
    return str(refused.value)


def test_messages_have_their_order_and_kind(tmp_path: Path) -> None:
    recording = CameraRecording(recorded(tmp_path / "rec.mcap", {**OURS, "/chatter": "std_msgs/msg/String"}))
    assert recording.images == 3
    found = [(each.kind, each.time, each.data.decode().strip()) for each in recording.messages()]
    kinds = {COLOR: "/color/image_raw", DEPTH: "/depth/image_raw", INFO: "/color/camera_info"}
    assert found == [(kind, 1000 + number, f"{topic} {number}") for number in range(3) for kind, topic in kinds.items()]
    assert [each.kind for each in recording.messages(COLOR, INFO)] == [COLOR, INFO] * 3


@pytest.mark.parametrize("prefix", ["", "/charger", "/a/b"])
def test_the_camera_is_found_under_any_namespace(tmp_path: Path, prefix: str) -> None:
    types = {f"{prefix}{topic}": kind for topic, kind in OURS.items()}
    types |= {"/other/infra/image_raw": IMAGE, "/other/depth/image_raw": IMAGE}
    assert topics(tmp_path, types) == tuple(f"{prefix}{topic}" for topic in OURS)


def test_depth_aligned_by_another_driver_is_found(tmp_path: Path) -> None:
    types = {
        "/cam/color/image_raw": IMAGE,
        "/cam/depth/image_rect_raw": IMAGE,
        "/cam/aligned_depth_to_color/image_raw": IMAGE,
        "/cam/color/camera_info": CAMERA_INFO,
    }
    assert topics(tmp_path, types)[1] == "/cam/aligned_depth_to_color/image_raw"


def test_other_names_can_be_given_and_the_info_is_next_to_the_color(tmp_path: Path) -> None:
    types = {"/oak/rgb/image_raw": IMAGE, "/oak/stereo/image_raw": IMAGE, "/oak/rgb/camera_info": CAMERA_INFO}
    named = CameraTopics("oak/rgb/image_raw", "/oak/stereo/image_raw")
    assert topics(tmp_path, types, named) == ("/oak/rgb/image_raw", "/oak/stereo/image_raw", "/oak/rgb/camera_info")
    types["/info"] = CAMERA_INFO
    assert topics(tmp_path, types, CameraTopics("oak/rgb/image_raw", info="info")) == (
        "/oak/rgb/image_raw",
        "",
        "/info",
    )


def test_color_alone_is_a_recording(tmp_path: Path) -> None:
    assert topics(tmp_path, {"/color/image_raw": IMAGE}) == ("/color/image_raw", "", "")


def test_ambiguous_topics_are_refused_with_the_choices(tmp_path: Path) -> None:
    two = {f"{prefix}{topic}": kind for prefix in ("/a", "/b") for topic, kind in OURS.items()}
    assert "name one of /a/color/image_raw, /b/color/image_raw" in refusal(tmp_path, two)
    assert topics(tmp_path, two, CameraTopics("/b/color/image_raw")) == tuple(f"/b{topic}" for topic in OURS)
    assert "name one of /rgb/image" in refusal(tmp_path, {"/rgb/image": IMAGE})
    depths = {"/color/image_raw": IMAGE, "/depth/image_raw": IMAGE, "/aligned_depth_to_color/image_raw": IMAGE}
    assert "several depth topics" in refusal(tmp_path, depths)
    assert "no topic /c" in refusal(tmp_path, OURS, CameraTopics("c"))
    assert "must be sensor_msgs/msg/Image" in refusal(tmp_path, OURS, CameraTopics(depth="/color/camera_info"))
    assert "holds no images, only /chatter" in refusal(tmp_path, {"/chatter": "std_msgs/msg/String"})


def test_errors_for_compressed_images_name_the_topic_to_record(tmp_path: Path) -> None:
    types = {"/depth/image_raw": IMAGE, "/color/image_raw/compressed": COMPRESSED}
    assert "record /color/image_raw instead" in refusal(tmp_path, types)
    assert "record /rgb instead" in refusal(tmp_path, {"/rgb/compressed": COMPRESSED})
    asked = CameraTopics("/color/image_raw/compressed")
    assert "record /color/image_raw instead" in refusal(tmp_path, types, asked)


def test_a_truncated_recording_is_read_to_its_end(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rec.mcap", OURS, rounds=50, finish=False)
    recording = CameraRecording(path)
    assert 40 < recording.images <= 50  # the last chunk was not written yet
    path.write_bytes(path.read_bytes()[:-30])
    recording = CameraRecording(path)
    messages = recording.messages(COLOR)
    assert len(list(itertools.islice(messages, recording.images))) == recording.images > 40
    with pytest.raises(RecordingError, match="ends early"):
        next(messages)


def test_a_damaged_part_raises_an_error(tmp_path: Path) -> None:
    path = recorded(tmp_path / "rec.mcap", OURS, rounds=50)
    data = bytearray(path.read_bytes())
    data[data.index(b"/color/image_raw 25") + 5] ^= 0xFF
    path.write_bytes(bytes(data))
    recording = CameraRecording(path)
    assert recording.images == 50
    with pytest.raises(RecordingError, match="damaged"):
        list(recording.messages())


@pytest.mark.parametrize("content", [b"", b"no recording at all", b"\x89MCAP0\r\n"])
def test_other_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "rec.mcap"
    path.write_bytes(content)
    with pytest.raises(RecordingError):
        CameraRecording(path)
    with pytest.raises(FileNotFoundError):
        CameraRecording(tmp_path / "none.mcap")
