# SPDX-License-Identifier: Apache-2.0
"""misalignment_node with a real ROS client that publishes tactile frames."""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
import zipfile
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from deltacharger.msg import Misalignment, TactileFrame
from deltacharger.srv import PredictMisalignment
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import qos_profile_sensor_data

from deltacharger_ros.node_support import StartupError
from deltacharger_tactile import default_model
from deltacharger_tactile.calibration.rig import TactileCalibration
from deltacharger_tactile.classifiers import files, packaged
from deltacharger_tactile.generator import generate_paper
from deltacharger_tactile.misalignment_node import MisalignmentNode
from deltacharger_tactile.source import ContactSource

from ..chargers import Spin, wait_until
from ..nodes import call, numbers, options

pytestmark = pytest.mark.ros

TRUTH = (0.001, 0.003, 0.08)


class Pads(Node):
    """Replaces tactile_node: 120 Hz of one simulated docking."""

    def __init__(self, context: Any) -> None:
        super().__init__("pads", **options(context))
        self.publisher = self.create_publisher(TactileFrame, "tactile_frame", qos_profile_sensor_data)
        self.client = self.create_client(PredictMisalignment, "predict_misalignment")
        self.setter = self.create_client(SetParameters, "misalignment_node/set_parameters")
        self.atomic = self.create_client(SetParametersAtomically, "misalignment_node/set_parameters_atomically")
        self.received: list[Misalignment] = []
        self.create_subscription(Misalignment, "misalignment", self.received.append, 1)
        self.tared, self.delay, self.streaming = True, 0.0, False
        source = ContactSource(rig_seed=21, seed=3)
        tare = np.mean([source.sample(i / 120, None, 0.0) for i in range(60)], axis=0)
        source.begin_docking()
        self.frames = [np.maximum(source.sample(1 + i / 120, TRUTH, 65.0) - tare, 0.0) for i in range(120)]
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._stream, daemon=True)
        self._thread.start()

    def _stream(self) -> None:
        count = 0
        while not self._stop.wait(1 / 120):
            if not self.streaming:
                continue
            left, right = self.frames[count % len(self.frames)]
            message = TactileFrame(rows=10, columns=10, pitch=0.0024, tared=self.tared, sequence=count)
            stamp = self.get_clock().now().nanoseconds - int(1e9 * self.delay)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
            message.left = array("f", left.ravel().astype(np.float32).tobytes())
            message.right = array("f", right.ravel().astype(np.float32).tobytes())
            self.publisher.publish(message)
            count += 1

    def ask(self, frames: int = 0, model: str = "") -> Any:
        return call(self.client, PredictMisalignment.Request(frames=frames, model=model))

    def set(self, **values: Any) -> Any:
        """Set one parameter of the node and return the result."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return call(self.setter, SetParameters.Request(parameters=parameters)).results[-1]

    def set_together(self, **values: Any) -> Any:
        """Set several parameters at once and return the result."""
        parameters = [Parameter(name, value=value).to_parameter_msg() for name, value in values.items()]
        return call(self.atomic, SetParametersAtomically.Request(parameters=parameters)).result

    def close(self) -> None:
        self._stop.set()
        self._thread.join(2.0)


@pytest.fixture
def pads(context: Any, spin: Spin) -> Pads:
    spin(MisalignmentNode(**options(context, rate=20.0, timeout=0.4)))
    client: Pads = spin(Pads(context))
    for service in (client.client, client.setter, client.atomic):
        wait_until(service.service_is_ready)
    wait_until(lambda: client.publisher.get_subscription_count() == 1)
    return client


def test_an_answer_lists_its_frames_and_a_refusal_lists_none(pads: Pads) -> None:
    assert list(pads.ask(4).sequences) == []
    pads.streaming = True
    first = list(pads.ask(12).sequences)
    second = list(pads.ask(12).sequences)
    assert len(first) == len(second) == 12
    assert sorted({*first, *second}) == first + second, "each once, increasing, the second's all later"


def test_answers_from_fresh_frames_and_publishes(pads: Pads) -> None:
    pads.streaming = True
    asked = pads.get_clock().now().nanoseconds
    answer = pads.ask()
    assert answer.success, answer.message
    found = answer.misalignment
    assert found.header.frame_id == "end_effector"
    assert found.header.stamp.sec * 10**9 + found.header.stamp.nanosec > asked
    assert found.contact
    assert found.in_range
    assert found.sure
    assert abs(found.angle - TRUTH[2]) < 4 * found.angle_stddev
    assert abs(found.vertical - TRUTH[1]) < 4 * found.vertical_stddev
    assert abs(found.horizontal - TRUTH[0]) < 4 * found.horizontal_stddev
    across = TRUTH[1] * math.cos(TRUTH[2]) - TRUTH[0] * math.sin(TRUTH[2])
    assert abs(found.across - across) < 4 * found.across_stddev
    for unknown in ("yaw", "pitch"):
        assert math.isnan(getattr(found, unknown))
        assert math.isnan(getattr(found, f"{unknown}_stddev"))
    assert len(found.angle_probability) == 6
    assert found.model.startswith("pose")
    assert found.left_force > 10
    wait_until(lambda: pads.received)
    assert pads.received[-1].in_range


def test_refuses_without_frames_untared_and_stale(pads: Pads) -> None:
    silent = pads.ask()
    assert not silent.success
    assert "tactile_node" in silent.message
    pads.tared, pads.streaming = False, True
    untared = pads.ask(4)
    assert not untared.success
    assert "tare" in untared.message
    pads.tared, pads.delay = True, 2.0  # every stamp is now before the request
    stale = pads.ask(4)
    assert not stale.success
    assert "old" in stale.message
    assert not pads.received
    too_many = pads.ask(1000)
    assert not too_many.success
    assert "240" in too_many.message
    for refused in (silent, untared, stale, too_many):
        assert all(map(math.isnan, numbers(refused.misalignment)))
        assert not len(refused.sequences)


def test_models_change_while_the_node_runs(pads: Pads, tmp_path: Path) -> None:
    other = default_model()
    other.name = "pose-other"
    other.save(tmp_path / "other.npz")
    pads.streaming = True
    before = pads.ask().misalignment.model
    assert pads.set(model=str(tmp_path / "other.npz")).successful
    assert pads.ask().misalignment.model == "pose-other"
    pads.received.clear()
    wait_until(lambda: any(message.model == "pose-other" for message in pads.received))
    assert pads.set(model="").successful
    assert pads.ask().misalignment.model == before


def test_no_answer_mixes_two_models_while_they_change(pads: Pads, tmp_path: Path) -> None:
    TactileCalibration(rig=9, bias=np.array([0.0, 0.004, 0.0])).save(tmp_path / "pads.yaml")
    pads.frames, pads.streaming = pads.frames[:1], True
    plain = pads.ask().misalignment.vertical
    pads.received.clear()
    for turn in range(10):
        assert pads.set(calibration=str(tmp_path / "pads.yaml") if turn % 2 else "").successful
        count = len(pads.received)
        wait_until(lambda count=count: len(pads.received) > count + 1)
    for message in pads.received:
        moved = 0.004 if message.model.endswith("+rig9") else 0.0
        assert message.vertical == pytest.approx(plain - moved, abs=1e-6)
    assert {message.model.endswith("+rig9") for message in pads.received} == {True, False}


def test_a_calibration_changes_the_estimate(pads: Pads, tmp_path: Path) -> None:
    dead = np.zeros((2, 10, 10), dtype=bool)
    dead[0, :3] = True
    bias = np.array([0.002, 0.0005, 0.01])
    TactileCalibration(rig=4, bias=bias, bias_stddev=np.full(3, 1e-4)).save(tmp_path / "biased.yaml")
    TactileCalibration(rig=4, dead=dead).save(tmp_path / "dead.yaml")
    pads.frames, pads.streaming = pads.frames[:1], True  # one repeated frame: no noise between answers
    raw = pads.ask().misalignment
    assert pads.set(calibration=str(tmp_path / "biased.yaml")).successful
    got = pads.ask().misalignment
    assert got.horizontal == pytest.approx(raw.horizontal - bias[0], abs=1e-6)
    assert got.angle == pytest.approx(raw.angle - bias[2], abs=1e-6)
    assert pads.set(calibration=str(tmp_path / "dead.yaml")).successful
    crippled = pads.ask().misalignment
    assert (crippled.contact, crippled.in_range, crippled.sure) == (True, False, False)


def always(path: Path, target: str, favoured: int, count: int) -> str:
    """Write a classifier with a constant answer."""
    bias = np.zeros(count)
    bias[favoured] = 9.0
    about = {"name": "logistic", "target": target, "threshold": 1.0, "kind": "linear"}
    files.write(path, about, {"weights": np.zeros((200, count)), "bias": bias})
    return str(path)


def test_classifiers_replace_the_probabilities_of_their_target(pads: Pads, tmp_path: Path) -> None:
    angle, vertical = always(tmp_path / "a.npz", "angle", 2, 6), always(tmp_path / "v.npz", "vertical", 4, 5)
    pads.frames, pads.streaming = pads.frames[:1], True
    raw = pads.ask().misalignment
    assert pads.set(classifiers=[angle, vertical]).successful
    got = pads.ask().misalignment
    assert np.argmax(got.angle_probability) == 2
    assert np.argmax(got.vertical_probability) == 4
    assert np.argmax(got.horizontal_probability) == np.argmax(raw.horizontal_probability)
    assert got.angle == pytest.approx(raw.angle, abs=1e-6)
    twice = pads.set(classifiers=[angle, angle])
    assert not twice.successful
    assert "second one for angle" in twice.reason
    assert np.argmax(pads.ask().misalignment.angle_probability) == 2
    assert pads.set(classifiers=[""]).successful
    assert np.argmax(pads.ask().misalignment.angle_probability) == np.argmax(raw.angle_probability)


def test_a_request_selects_the_classifier(pads: Pads) -> None:
    pads.frames, pads.streaming = pads.frames[:1], True
    usual = pads.ask().misalignment
    answers = {name: pads.ask(model=name).misalignment for name in packaged.MODELS}
    frame = np.stack(pads.frames[0])[None]
    for name, found in answers.items():
        assert found.model == f"{usual.model}+{name}"
        assert found.angle == pytest.approx(usual.angle, abs=1e-6), "the continuous estimate must not change"
        for target, model in packaged.load(name).items():
            np.testing.assert_allclose(
                getattr(found, f"{target}_probability"), model.predict_proba(frame)[0], atol=1e-5
            )
    assert pads.set(classifiers=["forest"]).successful
    result = pads.ask().misalignment
    assert result.model == answers["forest"].model
    assert list(result.angle_probability) == list(answers["forest"].angle_probability)
    assert pads.ask(model="cnn").misalignment.model == answers["cnn"].model


@pytest.mark.parametrize("name", ["resnet", "../models/cnn", str(packaged.path("cnn", "angle")), "x" * 100_000])
def test_an_unknown_model_is_answered_with_the_known_ones(pads: Pads, name: str) -> None:
    pads.streaming = True
    refused = pads.ask(model=name)
    assert not refused.success
    assert "known are logistic, svm, knn, tree, gbdt, forest, xgboost, nn, cnn" in refused.message
    assert len(refused.message) < 300
    assert math.isnan(refused.misalignment.angle)
    assert pads.ask().success


def test_damaged_packaged_files_are_refused_and_the_node_continues(
    pads: Pads, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(packaged.FOLDER, tmp_path / "models"))
    with zipfile.ZipFile(packaged.path("svm", "angle", folder), "a") as file:
        file.writestr("weights.npy", b"\x93NUMPY")
    monkeypatch.setattr(packaged, "FOLDER", folder)
    pads.streaming = True
    before = pads.ask().misalignment.model
    refused = pads.ask(model="svm")
    assert not refused.success
    assert "svm-angle.npz" in refused.message
    result = pads.set(classifiers=["svm"])
    assert not result.successful
    assert before in result.reason
    assert pads.ask().misalignment.model == before
    assert pads.ask(model="tree").success


def broken_files(folder: Path) -> dict[str, list[str]]:
    """Write files to refuse, by parameter; other faults are in the tests of each reader."""
    model = folder / "model.npz"
    default_model().save(model)
    (folder / "cut.npz").write_bytes(model.read_bytes()[:5000])
    generate_paper(rigs=(1,), seed=1).save(folder / "data.npz")
    TactileCalibration().save(folder / "pads.yaml")
    (folder / "zero").symlink_to("/dev/zero")
    os.mkfifo(folder / "pipe")
    with zipfile.ZipFile(model) as good, zipfile.ZipFile(folder / "header.npz", "w") as bad:
        for name in good.namelist():  # unparsable header in a valid archive
            bad.writestr(name, good.read(name).replace(b"'descr'", b"'" + b"(" * 6))
    (folder / "laughs.yaml").write_text("a: &a [1]\n" + "".join(f"b{n}: *a\n" for n in range(9)))
    common = ["missing", "data.npz", ".", "zero", "pipe"]
    return {
        "model": [*common, "cut.npz", "pads.yaml", "header.npz"],
        "calibration": [*common, "model.npz", "laughs.yaml"],
        "classifiers": [*common, "model.npz", "cut.npz"],
    }


def test_unusable_files_are_refused_with_a_reason_and_change_nothing(pads: Pads, tmp_path: Path) -> None:
    wrong = broken_files(tmp_path)
    pads.streaming = True
    before = pads.ask().misalignment
    for parameter, names in wrong.items():
        for name in names:
            path = str(tmp_path / name)
            result = pads.set(**{parameter: [path] if parameter == "classifiers" else path})
            assert not result.successful, (parameter, name)
            assert parameter in result.reason
            assert before.model in result.reason
            assert len(result.reason) > len(path) + 40
    together = pads.set_together(calibration=str(tmp_path / "pads.yaml"), model=str(tmp_path / "cut.npz"))
    assert not together.successful
    after = pads.ask().misalignment
    assert (after.model, after.sure) == (before.model, True)
    assert pads.set(calibration=str(tmp_path / "pads.yaml")).successful


def test_one_wrong_parameter_rejects_all_set_with_it(pads: Pads, tmp_path: Path) -> None:
    TactileCalibration(rig=8).save(tmp_path / "pads.yaml")
    pads.streaming = True
    result = pads.set_together(calibration=str(tmp_path / "pads.yaml"), rate=500.0)
    assert not result.successful
    assert "rate" in result.reason
    result = pads.set_together(frames=3, calibration=str(tmp_path / "none.yaml"))
    assert not result.successful
    assert "none.yaml" in result.reason
    answer = pads.ask()
    assert not answer.misalignment.model.endswith("+rig8")
    assert len(answer.sequences) == 12


def test_rate_and_limits_change_while_the_node_runs(pads: Pads) -> None:
    pads.streaming = True
    wait_until(lambda: pads.received, "an estimate at the initial rate")
    assert pads.set_together(rate=0.0, frames=3).successful
    assert len(pads.ask().sequences) == 3
    pads.received.clear()
    assert pads.ask(60).success
    assert not pads.received, "ten would have arrived at the old rate"
    assert pads.set(rate=50.0).successful
    wait_until(lambda: len(pads.received) > 3, "estimates at another rate")
    pads.streaming = False
    assert pads.set(timeout=1.0).successful
    began = time.monotonic()
    assert not pads.ask().success
    assert time.monotonic() - began > 1.0, "longer than the initial 0.4 s"
    result = pads.set(max_age=1.0)
    assert not result.successful
    assert "read-only parameter: max_age" in result.reason


def bad(kind: str, pad: Any) -> Any:
    """Return a pad's readings with a fault."""
    wrong = np.array(pad)
    if kind == "half dead":
        wrong[:, :5] = np.nan
    elif kind == "a row at full scale":
        wrong[4] = 9.0
    else:
        wrong[:] = {
            "zero": 0.0,
            "dead": np.nan,
            "full scale": 9.0,
            "infinite": np.inf,
            "huge": 1e30,
            "negative": -5.0,
        }[kind]
    return wrong


@pytest.mark.parametrize(
    ("kind", "contact"),
    [
        ("zero", False),
        ("dead", False),
        ("full scale", True),
        ("infinite", False),
        ("huge", False),
        ("negative", False),
        ("half dead", True),
        ("a row at full scale", True),
    ],
)
def test_faulty_frames_are_out_of_range(pads: Pads, tmp_path: Path, kind: str, contact: bool) -> None:
    TactileCalibration(rig=3, load_shift=8.0, bias=np.full(3, 1e-3), bias_stddev=np.full(3, 1e-4)).save(
        tmp_path / "pads.yaml"
    )
    for calibration in ("", str(tmp_path / "pads.yaml")):
        for both in (True, False):
            good = pads.frames[0]
            pads.frames = [(bad(kind, left), bad(kind, right) if both else right) for left, right in [good] * 4]
            assert pads.set(calibration=calibration).successful
            pads.streaming = True
            answer = pads.ask(3)
            pads.frames, pads.streaming = [good], False
            assert answer.success, answer.message
            found = answer.misalignment
            assert (found.in_range, found.sure) == (False, False)
            assert found.contact == (contact or not both)
            if not found.contact:
                assert np.isnan([found.angle, found.vertical, found.horizontal]).all()


def test_a_frame_of_another_shape_is_ignored(pads: Pads) -> None:
    message = TactileFrame(rows=5, columns=20, pitch=0.0024, tared=True)
    message.left = message.right = array("f", [1.0] * 100)
    for _ in range(5):
        pads.publisher.publish(message)
    assert not pads.ask(1).success
    pads.streaming = True
    assert pads.ask(4).success


def test_a_bad_model_stops_the_start(context: Any) -> None:
    with pytest.raises(StartupError, match="model"):
        MisalignmentNode(**options(context, model="/nowhere.npz"))
    with pytest.raises(StartupError, match="calibration"):
        MisalignmentNode(**options(context, calibration="/nowhere.yaml"))
    with pytest.raises(StartupError, match="max_age"):
        MisalignmentNode(**options(context, maxage=1.0))
