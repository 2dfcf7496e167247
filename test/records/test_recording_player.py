# SPDX-License-Identifier: Apache-2.0
"""A recording played as a scene: complete, in order, with the original ages, and never beside a charger."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from ..chargers import DEADLINE, new_namespace, wait_until
from ..nodes import options
from ..waiting import host

pytest.importorskip("mcap", reason="recordings need deltacharger[record]")

from deltacharger.msg import ServoState
from deltacharger.srv import PredictMisalignment
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.serialization import deserialize_message, serialize_message
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core.mcap_file import Raw
from deltacharger_docking.codes import Code, State
from deltacharger_records.recording.mcap_recording import TOPICS
from deltacharger_records.recording.recording_player_node import RecordingPlayerNode
from deltacharger_ros import qos
from deltacharger_ros.node_support import StartupError
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import load_scene

from .docking_tapes import RECORDED, decision, docking, in_order, raw, refused, write

pytestmark = pytest.mark.ros

PLAYER = "recording_player_node"
ZSTANDARD = b"\x28\xb5\x2f\xfd"  # begins a compressed chunk
AGE = 5_000_000  # ns between sampling and reception of the recorded messages


def stamped(message: Raw) -> Raw:
    """Return a message with a stamp in its header, if it has one."""
    content = deserialize_message(message.data, RECORDED[message.topic].kind)
    if not hasattr(content, "header"):
        return message
    content.header.stamp.sec, content.header.stamp.nanosec = divmod(message.received - AGE, 10**9)
    return message._replace(data=serialize_message(content))


def tape() -> list[Raw]:
    """Return a refused docking, with a command to the arm near its end."""
    command = raw(3.5, "joint_trajectory", JointTrajectory(joint_names=["limb_0_arm_joint"]))
    return [stamped(each) for each in in_order([*docking(*refused(Code.CRITICAL_ANGLE, "tilted"), command)])]


class Audience:
    """Receives the played topics of its own namespace, and the player's diagnostics."""

    def __init__(self, context: Any) -> None:
        self.namespace = new_namespace()
        self.received: dict[str, list[tuple[int, Any]]] = {topic.name: [] for topic in TOPICS}
        self.diagnostics: list[DiagnosticStatus] = []
        self.node = Node("audience", **options(context, self.namespace))
        for topic in TOPICS:
            self.node.create_subscription(topic.kind, topic.name, self._taker(topic.name), topic.polled)
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self._executor = SingleThreadedExecutor(context=context)  # Spinner's passes no MessageInfo
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._executor.spin)
        self._thread.start()

    def _taker(self, name: str) -> Callable[[Any, Any], None]:
        def take(message: Any, info: Any) -> None:
            self.received[name].append((int(info["source_timestamp"]), message))

        return take

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.diagnostics += [each for each in message.status if each.name == f"{self.namespace}/{PLAYER}: playback"]

    def diagnostic(self, text: str) -> DiagnosticStatus:
        """Return the first diagnostic with the text, once received."""
        found = wait_until(lambda: [each for each in list(self.diagnostics) if text in each.message], f"'{text}'")
        return found[0]

    def values(self, name: str, field: str) -> list[Any]:
        return [getattr(message, field) for _, message in list(self.received[name])]

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join(DEADLINE)
        self.node.destroy_node()


@pytest.fixture
def audience(context: Any) -> Iterator[Audience]:
    made = Audience(context)
    yield made
    made.close()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("tape") / "refused.mcap", tape())


def playing(path: Path, context: Any, namespace: str, alone: bool = True, **parameters: Any) -> Composition:
    """Return the packaged scene, or its player alone, with a file and other parameters of the player."""
    scene = load_scene("replay")
    settings = {
        PLAYER: {"file": str(path), "delay": 0.0, **parameters},
        "misalignment_node": {"max_age": 5.0, "timeout": 10.0},
    }
    nodes = (PLAYER,) if alone else scene.nodes
    return Composition(dataclasses.replace(scene, nodes=nodes, parameters=settings), context, namespace)


@pytest.mark.rest
def test_all_messages_are_played_in_order_at_their_rate_with_their_age(
    audience: Audience, recording: Path, context: Any
) -> None:
    began = time.time_ns()
    with playing(recording, context, audience.namespace, rate=2.0):
        assert audience.diagnostic("the recording is over").level == DiagnosticStatus.OK
        wait_until(lambda: len(audience.received["docking_state"]) >= 6, "the last state")
    for name, field in (("docking_state", "state"), ("docking_decision", "kind")):
        wanted = [
            deserialize_message(each.data, RECORDED[each.topic].kind) for each in tape() if each.topic == f"/a/{name}"
        ]
        assert audience.values(name, field) == [getattr(each, field) for each in wanted]
    assert [list(each.uuid) for each in audience.values("dock/_action/feedback", "goal_id")[:1]] == [[7] * 16]
    ages, stamps = [], []
    for sent, message in audience.received["servo_state"]:
        stamps.append(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
        ages.append(sent - stamps[-1])
    assert stamps[0] > began - AGE
    assert stamps == sorted(stamps)
    assert 1e-9 * (stamps[-1] - stamps[0]) == pytest.approx(3.0 / 2.0, abs=host(0.3)), "twice as fast"
    assert AGE - 1_000_000 < min(ages) < 10 * AGE
    assert [each.stamp.sec > 0 for each in audience.values("joint_trajectory", "header")] == [True]


@pytest.mark.rest
def test_misalignment_is_estimated_from_a_looped_recording(audience: Audience, recording: Path, context: Any) -> None:
    estimates: Any = audience.node.create_client(PredictMisalignment, "predict_misalignment")
    with playing(recording, context, audience.namespace, alone=False, loop=True, rate=4.0) as composition:
        assert estimates.wait_for_service(DEADLINE)
        wait_until(lambda: audience.received["tactile_frame"], "frames")
        asked = estimates.call_async(PredictMisalignment.Request(frames=4))
        wait_until(asked.done, "an estimate")
        assert asked.result().misalignment.contact, asked.result()
        wait_until(lambda: composition.node(PLAYER).passes >= 2, "a second pass")
    states = audience.values("docking_state", "state")
    once = [
        deserialize_message(each.data, RECORDED[each.topic].kind).state
        for each in tape()
        if "docking_state" in each.topic
    ]
    assert states[: 2 * len(once)] == 2 * once


@pytest.mark.rest
@pytest.mark.parametrize("first", [False, True])
def test_it_never_commands_the_arm_of_a_charger(audience: Audience, recording: Path, context: Any, first: bool) -> None:
    publish = lambda: audience.node.create_publisher(ServoState, "servo_state", qos.LATEST)  # noqa: E731
    servos = publish() if first else None
    with playing(recording, context, audience.namespace, delay=60.0 if first else 0.0) as composition:
        if servos is None:
            wait_until(lambda: audience.received["servo_state"], "the first messages")
            servos = publish()
        assert audience.diagnostic("a charger runs here").level == DiagnosticStatus.ERROR
        assert (composition.node(PLAYER).passes, composition.failed()) == (0, []), "its last messages remain available"
    assert audience.received["joint_trajectory"] == []
    assert any(audience.received.values()) is not first
    audience.node.destroy_publisher(servos)


def alone(path: Path, context: Any, **parameters: Any) -> RecordingPlayerNode:
    return RecordingPlayerNode(**options(context, new_namespace(), file=str(path), **parameters))


def damaged(folder: Path) -> Path:
    """Return a recording with a damaged last chunk."""
    path = write(folder / "damaged.mcap", tape())
    content = bytearray(path.read_bytes())
    content[content.rindex(ZSTANDARD) + 100] ^= 0xFF
    path.write_bytes(content)
    return path


def of_two(folder: Path) -> Path:
    other = {topic.replace("/a/", "/b/"): kind for topic, kind in RECORDED.items()}
    twins = [each._replace(topic=each.topic.replace("/a/", "/b/")) for each in tape()]
    return write(folder / "two.mcap", in_order([*tape(), *twins]), topics={**RECORDED, **other})


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (lambda folder: "", "--recording"),
        (lambda folder: folder / "none.mcap", "none.mcap"),
        (lambda folder: folder, "folder"),
        (lambda folder: write(folder / "other.mcap", [decision(1.0, State.IDLE, "x")]), "docking_state"),
        (damaged, "damaged"),
        (of_two, "'charger'"),
    ],
    ids=["none named", "missing", "folder", "foreign", "damaged", "two chargers"],
)
def test_unplayable_files_are_refused_at_the_start(
    make: Callable[[Path], Path], error: str, context: Any, tmp_path: Path
) -> None:
    with pytest.raises(StartupError, match=PLAYER) as caught:
        alone(make(tmp_path), context)
    assert error in str(caught.value)
