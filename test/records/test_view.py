# SPDX-License-Identifier: Apache-2.0
"""`deltacharger view`: the Rerun file shows the recording's content; content that cannot be shown is reported."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from deltacharger_bringup.cli.main import main
from deltacharger_kinematics.geometry import DeltaGeometry

from ..bringup.command import run
from ..chargers import DEADLINE, Process, new_namespace, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

rr = pytest.importorskip("rerun", reason="`deltacharger view` needs deltacharger[view]")
pyarrow = pytest.importorskip("pyarrow", reason="comes with rerun")
pytest.importorskip("mcap", reason="recordings need deltacharger[record]")


@pytest.fixture(scope="module")
def docking(tmp_path_factory: pytest.TempPathFactory, context: Any, quick_scene: Any) -> Path:
    """Return the recording of one docking of the quick scene, from its goal until it charges."""
    from deltacharger.msg import DockingState
    from rclpy.node import Node
    from rclpy.serialization import deserialize_message

    from deltacharger_core.mcap_file import Raw
    from deltacharger_records.recording.docking_topics import TOPICS
    from deltacharger_records.recording.mcap_recording import McapWriter
    from deltacharger_ros.client import ChargerClient
    from deltacharger_ros.executor import Spinner
    from deltacharger_ros.outcomes import DockRequest, Pose
    from deltacharger_ros.raw_topics import listen
    from deltacharger_scenes.composition import Composition

    namespace, came = new_namespace(), list[Raw]()
    with Composition(quick_scene, context, namespace), ChargerClient(namespace, context) as client:
        node = Node("recorder", **options(context, namespace))
        listen(node, TOPICS, came.append)
        spinner = Spinner(node)
        try:
            assert client.wait_until_ready(DEADLINE)

            def docks() -> bool:  # a stalled computer is not a failure
                came.clear()
                return client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE).success

            def reports() -> bool:  # the recorder may receive it later than the client
                states = [each.data for each in list(came) if each.topic.endswith("/docking_state")]
                return bool(states) and bool(deserialize_message(states[-1], DockingState).charging)

            wait_until(docks, "a docking that succeeds")
            wait_until(reports, "the state that reports it")
        finally:
            spinner.close()
    path = tmp_path_factory.mktemp("docking") / "docking.mcap"
    with McapWriter(path, {f"/{namespace}/{topic.name}": topic.kind for topic in TOPICS}) as writer:
        for message in sorted(came, key=lambda message: message.received):
            writer.add(message)
    return path


@pytest.fixture(scope="module")
def shown(docking: Path) -> Recording:
    """Return the output of `view --recording` for it."""
    path = docking.with_suffix(".rrd")
    assert main(["view", "--recording", str(docking), "--save", str(path)]) == 0
    return Recording(path)


class Recording:
    """A Rerun file: rows of each entity in the order of the timeline `run`."""

    def __init__(self, path: Path) -> None:
        self._rows: dict[str, list[dict[str, Any]]] = {}
        for chunk in rr.chunk.RrdReader(str(path)).stream().to_chunks():
            batch = chunk.to_record_batch()
            for index, field in enumerate(batch.schema):
                if pyarrow.types.is_temporal(field.type):  # without pandas, nanoseconds have no Python value
                    batch = batch.set_column(index, field.name, batch.column(index).cast("int64"))
            self._rows.setdefault(str(chunk.entity_path).strip("/"), []).extend(batch.to_pylist())
        self.entities = set(self._rows)

    def rows(self, entity: str, component: str) -> list[tuple[float, Any]]:
        """Return (s of `run`, value) of an entity's component; static values have the time NaN."""
        found = []
        for row in self._rows.get(entity, []):
            if row.get(component) is not None:
                found.append((1e-9 * row["run"] if "run" in row else math.nan, row[component]))
        return sorted(found, key=lambda row: row[0])

    def scalars(self, entity: str) -> NDArray[np.float64]:
        """Return (n, 1 + values) of a plot: s, then its values."""
        return np.array([(time, *values) for time, values in self.rows(entity, "Scalars:scalars")])


def count(file: Path, topic: str) -> int:
    from mcap.reader import make_reader

    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        return sum(counts.get(each.id, 0) for each in summary.channels.values() if each.topic.endswith(f"/{topic}"))


def view(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    return run(capsys, "view", *words)


def test_all_data_of_a_docking_are_shown(shown: Recording) -> None:
    charger = ("arms", "rods", "platform", "trail", "base", "platform/body", "camera/body", "target/given/terminal")
    plots = ("height", "contact/measured", "contact/reported", "contact/band", "servos", "misalignment/horizontal")
    plots += ("misalignment/vertical", "angle", "pads", "charge/current", "charge/voltages", "energy")
    expected = {f"charger/{name}" for name in charger} | {f"plots/{name}" for name in plots}
    expected |= {"pads/left", "pads/right", "state/1_docking", "state/2_docked", "state/3_contactor", "log", "status"}
    assert expected <= shown.entities
    assert not {entity for entity in shown.entities if entity.startswith("camera/")}  # no data, no entity


def test_time_runs_forward_from_zero_in_every_plot(shown: Recording) -> None:
    ends = []
    for entity in shown.entities:
        if entity.startswith("plots/"):
            times = shown.scalars(entity)[:, 0]
            times = times[~np.isnan(times)]
            assert times[0] >= 0.0
            assert (np.diff(times) >= 0.0).all()
            ends.append(times[-1])
    assert max(ends) - min(ends) < max(ends)


def test_fast_topics_are_thinned_and_slow_ones_are_complete(shown: Recording, docking: Path) -> None:
    measured = shown.scalars("plots/contact/measured")
    seconds = measured[-1, 0] - measured[0, 0]
    assert 5 < len(measured) <= 30.0 * seconds + 2 < count(docking, "servo_state")
    assert len(shown.scalars("plots/pads")) <= 30.0 * seconds + 10 < count(docking, "tactile_frame")
    assert len(shown.scalars("plots/charge/current")) == count(docking, "charger_power")
    assert sum("(" in text[0] or ":" in text[0] for _, text in shown.rows("log", "TextLog:text")) >= count(
        docking, "docking_decision"
    )


def test_the_contact_current_comes_to_rest_in_its_band(shown: Recording) -> None:
    np.testing.assert_array_equal(np.unique(shown.scalars("plots/contact/band")[:, 1:], axis=0), [[0.4, 0.5]])
    for entity in ("plots/contact/measured", "plots/contact/reported"):
        assert 0.4 <= shown.scalars(entity)[-1, 1] <= 0.5


def test_states_follow_each_other_as_published(shown: Recording) -> None:
    states = [state[0] for _, state in shown.rows("state/1_docking", "StateChange:state")]
    order = [states.index(name) for name in ("approach", "contact", "measure", "energise", "charging")]
    assert order == sorted(order)
    assert all(first != second for first, second in itertools.pairwise(states))
    contactor = [state[0] for _, state in shown.rows("state/3_contactor", "StateChange:state")]
    assert contactor[:2] == ["open", "closed"]
    assert shown.scalars("plots/energy")[-1, 1] > 0.0


def test_the_drawn_rods_keep_their_length_and_the_arms_theirs(shown: Recording) -> None:
    for name, length in (("arms", 0.100), ("rods", 0.180)):
        drawn = [np.array(strips) for _, strips in shown.rows(f"charger/{name}", "LineStrips3D:strips")]
        assert len(drawn) > 10
        for strips in drawn:
            np.testing.assert_allclose(np.linalg.norm(strips[:, 1] - strips[:, 0], axis=-1), length, atol=1e-6)


def test_one_json_object_counts_the_messages(docking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = view(capsys, "--recording", docking, "--save", tmp_path / "a.rrd", "--json")
    result = json.loads(out)
    assert (code, result["success"], result["saved"]) == (0, True, str(tmp_path / "a.rrd"))
    assert result["messages"]["servo_state"] == count(docking, "servo_state")


def test_a_calibrated_geometry_is_drawn(docking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from deltacharger.msg import ServoState

    from deltacharger_core.mcap_file import McapFile
    from deltacharger_records.recording.folder import PARAMETERS
    from deltacharger_records.recording.mcap_recording import McapWriter

    scene = tmp_path / "long.yaml"
    scene.write_text("parameters: {kinematics_node: {arm: 0.11}}\nsimulation: {}\n")
    settled = tmp_path / "assumed.mcap"
    file = McapFile(docking)
    with McapWriter(settled, {topic: ServoState for topic in file.types if topic.endswith("/servo_state")}) as writer:
        for message in itertools.islice((each for each in file.messages() if each.topic.endswith("/servo_state")), 50):
            writer.add(message)
        writer.add_metadata(PARAMETERS, {"arm": "0.11", "gravity_z": "9.81"})
    for words in (("--recording", docking, "--scene", scene), ("--recording", settled)):
        code, _, err = view(capsys, *words, "--save", tmp_path / "a.rrd")
        assert code == 0, err
        (_, strips), *_ = Recording(tmp_path / "a.rrd").rows("charger/arms", "LineStrips3D:strips")
        arms = np.array(strips)
        np.testing.assert_allclose(np.linalg.norm(arms[:, 1] - arms[:, 0], axis=-1), 0.11, atol=1e-6)


def test_a_file_without_recording_is_refused(docking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text, other = tmp_path / "a.mcap", tmp_path / "other.mcap"
    text.write_text("no recording")
    write(other, {"/chatter": 1})
    for words, complaint in (
        (("--recording", text), "no MCAP file"),
        (("--recording", tmp_path / "none.mcap"), "no such file"),
        (("--recording", other), "it holds /chatter"),
        (("--recording", docking, "--namespace", "elsewhere"), "no topic of a charger of /elsewhere"),
    ):
        code, out, err = view(capsys, *words, "--save", tmp_path / "b.rrd")
        assert (code, out) == (2, "")
        assert complaint in err


def test_of_two_chargers_in_a_recording_one_is_chosen(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    both = tmp_path / "both.mcap"
    write(both, {"/left/docking_state": 2, "/right/docking_state": 3})
    code, _, err = view(capsys, "--recording", both, "--save", tmp_path / "b.rrd")
    assert code == 2
    assert "/left, /right" in err
    code, out, _ = view(capsys, "--recording", both, "--save", tmp_path / "b.rrd", "--namespace", "right", "--json")
    assert code == 0
    assert json.loads(out)["messages"] == {"docking_state": 3}


def write(path: Path, topics: dict[str, int]) -> None:
    """Write a recording with a number of messages of each topic."""
    from deltacharger.msg import DockingState
    from std_msgs.msg import Header

    from deltacharger_records.recording.mcap_recording import McapWriter

    kinds = {topic: DockingState if topic.endswith("docking_state") else Header for topic in topics}
    with McapWriter(path, kinds) as writer:
        for topic, times in topics.items():
            for number in range(times):
                writer.add_message(topic, kinds[topic](), 10**18 + number, 10**18 + number)


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (("--save", "view.png"), "must end in .rrd"),
        (("--save", "/no/such/folder/a.gif"), "does not exist"),
        (("--save", "/no/such/folder/a.rrd"), "does not exist"),
        (("--connect", "localhost"), "rerun+http"),
        (("--save", "a.rrd", "--connect", "rerun+http://h:1/proxy"), "not allowed with"),
        (("--recording", __file__, "--stop-after-s", "3", "--save", "a.rrd"), "for a running charger"),
    ],
)
def test_impossible_destinations_are_refused_before_anything_starts(
    words: tuple[str, ...], complaint: str, capsys: pytest.CaptureFixture[str], monkeypatch: Any, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = view(capsys, *words)
    assert (code, out) == (2, "")
    assert complaint in err
    assert not list(tmp_path.iterdir())


def test_without_a_screen_the_message_names_alternatives(capsys: pytest.CaptureFixture[str], monkeypatch: Any) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    code, _, err = view(capsys)
    assert code == 2
    assert "--save FILE.rrd" in err


def test_the_viewer_beside_this_python_is_found(
    docking: Path, capsys: pytest.CaptureFixture[str], monkeypatch: Any
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setenv("PATH", "/nowhere")
    paths: list[str] = []

    def spawn(recording: Any, **options: Any) -> None:
        paths.append(os.environ["PATH"])
        recording.memory_recording()  # a destination without a window

    monkeypatch.setattr(rr.RecordingStream, "spawn", spawn)
    code, _, err = view(capsys, "--recording", docking)
    assert code == 0, err
    assert paths == [os.pathsep.join([str(Path(sys.executable).parent), "/nowhere"])]


def test_a_docking_is_drawn_as_an_animated_picture(
    docking: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = pytest.importorskip("PIL.Image", reason="comes with matplotlib, deltacharger[report]")
    path = tmp_path / "docking.gif"
    code, _, err = view(capsys, "--recording", docking, "--save", path)
    assert code == 0, err
    assert path.stat().st_size <= 1_000_000
    with image.open(path) as picture:
        assert picture.size == (900, 430)
        assert picture.n_frames > 10
        first = np.asarray(picture.convert("RGB")).astype(int)
        picture.seek(picture.n_frames - 1)
        last = np.asarray(picture.convert("RGB")).astype(int)
    left, right = np.s_[60:, :500], np.s_[60:200, 560:]
    assert (abs(last - first)[left].max(axis=2) > 40).mean() > 0.01, "the arm moves"
    assert (abs(last - first)[right].max(axis=2) > 40).mean() > 0.01, "the pads measure"


@pytest.mark.rest
def test_silent_topics_are_reported_and_ctrl_c_ends_it(
    start: Callable[..., Process], deltacharger: tuple[str, ...], tmp_path: Path
) -> None:
    namespace, path = new_namespace(), tmp_path / "live.rrd"
    process = start(*deltacharger, "view", "--namespace", namespace, "--save", str(path))
    process.wait_for_line("no messages for 5 s", process.err)
    line = next(line for line in process.err if "no messages for" in line)
    for topic in ("servo_state", "tactile_frame", "charger_power", "docking_state"):
        assert f"/{namespace}/{topic}" in line
    assert process.end(signal.SIGINT) == 130
    assert "charger/base" in Recording(path).entities


def test_a_running_charger_is_shown_live(
    start: Callable[..., Process], deltacharger: tuple[str, ...], tmp_path: Path, context: Any, quick_scene: Any
) -> None:
    from deltacharger_scenes.composition import Composition

    namespace, path = new_namespace(), tmp_path / "live.rrd"
    with Composition(quick_scene, context, namespace):
        words = ("--save", str(path), "--stop-after-s", "8", "--json")
        process = start(*deltacharger, "view", "--namespace", namespace, *words)
        assert process.end() == 0, process.err
    result = json.loads(process.out[-1])
    assert result["silent"] == []
    assert result["messages"]["servo_state"] > 10
    live = Recording(path)
    assert {"charger/arms", "pads/left", "plots/contact/band", "state/1_docking"} <= live.entities
    assert len(live.scalars("plots/contact/measured")) < result["messages"]["servo_state"]


def test_a_message_that_cannot_be_shown_does_not_stop_the_others(tmp_path: Path) -> None:
    from deltacharger.msg import DockingState, TactileFrame
    from sensor_msgs.msg import Image

    from deltacharger_records.view.feed import ViewFeed
    from deltacharger_records.view.log import ViewLog

    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "a.rrd")
    feed = ViewFeed(ViewLog(rr, recording, DeltaGeometry(), np.eye(4)), DeltaGeometry())
    feed.take("color/image_raw", 10**18, lambda: Image(encoding="smell", width=2, height=2, step=2, data=b"abcd"))
    feed.take("tactile_frame", 10**18, lambda: TactileFrame(rows=10, columns=10, left=[0.0], right=[0.0]))
    feed.take("docking_state", 10**18 + 1, lambda: DockingState(state=DockingState.STATE_ALIGN))
    recording.flush()
    recording.disconnect()
    assert list(feed.refused) == ["color/image_raw"]
    shown = Recording(tmp_path / "a.rrd")
    assert [state for _, state in shown.rows("state/1_docking", "StateChange:state")] == [["align"]]
