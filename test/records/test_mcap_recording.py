# SPDX-License-Identifier: Apache-2.0
"""A recording contains the bytes of its topics; a file is complete or does not exist."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path

import pytest
import yaml

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import DockingState, TactileFrame
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from deltacharger_core.mcap_file import CUT_SHORT, DamagedRecording, McapFile, Raw
from deltacharger_records.recording.mcap_recording import TOPICS, McapStream, McapWriter, pack, schema_text, type_name

pytestmark = pytest.mark.ros

RECORDED = {f"/a/{topic.name}": topic for topic in TOPICS}
ENDLESS = {"sec": 2**63 // 10**9, "nsec": (2**63 - 1) % 10**9}  # of rmw, as `ros2 bag` writes it


def frame(number: int) -> TactileFrame:
    message = TactileFrame(sequence=number, rows=10, columns=10, pitch=0.5, tared=True)
    message.left = [math.nan, *(0.5 * number + each for each in range(99))]
    message.right = [-1.0] * 100
    message.header.frame_id = "end_effector"
    message.header.stamp.sec = number
    return message


def test_other_readers_can_read_the_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    written = [Raw("/a/tactile_frame", 10 + n, 5 + n, serialize_message(frame(n))) for n in range(60)]
    state = DockingState(state=DockingState.STATE_CONTACT, request_id="é")
    with McapWriter(path, RECORDED) as writer:
        for message in written:
            writer.add(message)
        writer.add_message("/a/docking_state", state, 400, 399)
        writer.add_metadata("docking", {"attempt": "3"})
        writer.attach("note.txt", "text/plain", b"hello")
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        found = list(reader.iter_messages())
        assert {channel.message_encoding for _, channel, _ in found} == {"cdr"}
        assert {schema.encoding for schema, _, _ in found if schema} == {"ros2msg"}
        frames = [message for _, channel, message in found if channel.topic == "/a/tactile_frame"]
        assert [(each.log_time, each.publish_time, each.data) for each in frames] == [each[1:] for each in written]
        for number in (0, 59):
            assert repr(deserialize_message(frames[number].data, TactileFrame)) == repr(frame(number))
        assert [each.metadata for each in reader.iter_metadata()] == [{"attempt": "3"}]
        assert [each.data for each in reader.iter_attachments()] == [b"hello"]
    file = McapFile(path)
    assert (file.metadata_named("docking"), file.attachment("note.txt")) == ([{"attempt": "3"}], b"hello")
    assert [deserialize_message(each.data, DockingState) for each in file.messages("/a/docking_state")] == [state]


def test_each_topic_tells_what_its_publisher_offers_so_that_ros2_bag_offers_it_too() -> None:
    stream = io.BytesIO()
    writer = McapStream(stream, RECORDED, live=True)
    writer.finish()
    stream.seek(0)
    summary = make_reader(stream).get_summary()
    assert summary is not None
    offered = {each.topic: yaml.safe_load(each.metadata["offered_qos_profiles"]) for each in summary.channels.values()}
    unknown = {"history": 3, "depth": 0, "liveliness": 1, "avoid_ros_namespace_conventions": False}
    unknown |= dict.fromkeys(("deadline", "lifespan", "liveliness_lease_duration"), ENDLESS)
    assert offered == {
        name: [{**unknown, "reliability": int(topic.qos.reliability), "durability": int(topic.qos.durability)}]
        for name, topic in RECORDED.items()
    }
    late = {"/a/docking_state", "/a/dock/_action/status", "/a/undock/_action/status"}
    assert {name for name, (each,) in offered.items() if each["durability"] == DurabilityPolicy.TRANSIENT_LOCAL} == late


def test_packing_a_live_file_changes_only_its_size(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    written = [Raw("/a/tactile_frame", 10 + n, 5 + n, serialize_message(frame(n))) for n in range(60)]
    with path.open("wb") as stream:
        writer = McapStream(stream, RECORDED, live=True)
        for message in written[:40]:
            writer.add(message)
        writer.add_metadata("docking", {"attempt": "3"})
        for message in written[40:]:
            writer.add(message)
        writer.flush()
        assert McapFile(path).counts["/a/tactile_frame"] == 60, "a kill loses no flushed data"
        with pytest.raises(DamagedRecording, match=CUT_SHORT):
            pack(path, io.BytesIO(), RECORDED)
        writer.finish()
    size = path.stat().st_size
    packed = io.BytesIO()
    pack(path, packed, RECORDED)
    path.write_bytes(packed.getvalue())
    file = McapFile(path)
    assert list(file.messages()) == written
    assert file.metadata_named("docking") == [{"attempt": "3"}]
    assert path.stat().st_size < 0.4 * size
    with path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    assert summary.chunk_indexes, "ros2 bag plays no file without an index"
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]


def test_a_schema_contains_the_definitions_of_all_parts() -> None:
    first, *parts = schema_text(TactileFrame).split("=" * 80 + "\n")
    assert [part.splitlines()[0] for part in parts] == ["MSG: std_msgs/Header", "MSG: builtin_interfaces/Time"]
    assert [name for name in TactileFrame.get_fields_and_field_types() if f" {name}" not in first] == []
    assert type_name(TactileFrame) == "deltacharger/msg/TactileFrame"


def test_an_exception_leaves_the_existing_file(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(b"before")
    with contextlib.suppress(ZeroDivisionError), McapWriter(path, RECORDED) as writer:
        writer.add(Raw("/a/tactile_frame", 1, 1, serialize_message(frame(1))))
        raise ZeroDivisionError
    assert [each.name for each in tmp_path.iterdir()] == ["run.mcap"]
    assert path.read_bytes() == b"before"
    with pytest.raises(OSError, match="nowhere"):
        McapWriter(tmp_path / "nowhere" / "run.mcap", RECORDED)
