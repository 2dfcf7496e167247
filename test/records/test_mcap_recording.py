# SPDX-License-Identifier: Apache-2.0
"""A recording contains the bytes of its topics."""

import math
from pathlib import Path

import pytest
import yaml

pytest.importorskip("mcap", reason="records with deltacharger[record]")

from deltacharger.msg import DockingState, TactileFrame
from mcap.reader import make_reader
from rclpy.qos import DurabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

from deltacharger_bringup.records.recording.mcap_recording import TOPICS, McapWriter
from deltacharger_core.mcap_file import McapFile, Raw

pytestmark = pytest.mark.ros

RECORDED = {f"/a/{topic.name}": topic for topic in TOPICS}


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
    with McapWriter(path.open("wb"), RECORDED, [("docking", {"attempt": "3"})]) as writer:
        for message in written:
            writer.add(message)
        writer.stream.flush()
        assert McapFile(path).counts["/a/tactile_frame"] == 60, "a kill loses no flushed data"
        writer.add(Raw("/a/docking_state", 400, 399, serialize_message(state)))
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
        summary = reader.get_summary()
        assert summary is not None
        offered = {
            one.topic: yaml.safe_load(one.metadata["offered_qos_profiles"])[0] for one in summary.channels.values()
        }
        late = [name for name, each in offered.items() if each["durability"] == DurabilityPolicy.TRANSIENT_LOCAL]
        assert late == ["/a/docking_state"], "so `ros2 bag` offers what its publisher offers"
    file = McapFile(path)
    assert file.metadata_named("docking") == [{"attempt": "3"}]
    assert [deserialize_message(each.data, DockingState) for each in file.messages("/a/docking_state")] == [state]
