# SPDX-License-Identifier: Apache-2.0
"""`deltacharger vision detect` on simulated images in files and recordings, and its errors."""

from __future__ import annotations

import dataclasses
import json
import math
import shutil
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltacharger_bringup.cli.main import main
from deltacharger_bringup.cli.output import DONE, FAILED, WRONG_INPUT
from deltacharger_vision.images import Intrinsics, RgbdImage
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.scene import RenderedScene

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

Array = np.ndarray[Any, Any]
KEYS = {
    *("found", "frame", "position", "roll", "normal", "covariance", "confidence", "range", "source"),
    "detection_time",
}
LENSES = {
    "plumb_bob": (-0.3, 0.1, 0.0005, -0.0005, 0.0),
    "rational_polynomial": (6.5, -3.1, 0.0, 0.0, 0.9, 6.7, -2.4, 0.6),
}


def pose(away: float = 0.3, roll: float = 0.1, x: float = 0.01) -> Array:
    """camera_T_terminal: upright but for `roll`, `away` m before the camera."""
    found = np.eye(4)
    c, s = math.cos(roll), math.sin(roll)
    found[:3, :3] = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)]) @ np.diag([-1.0, -1.0, 1.0])
    found[:3, 3] = x, -0.01, away
    return found


def view(seed: int, *where: float, target: bool = True, camera: SimulatedCamera | None = None) -> RgbdImage:
    random = np.random.default_rng(20_000 + seed)
    return (camera or SimulatedCamera()).render(RenderedScene(target=target), pose(*where), random)


def millimetres(image: RgbdImage) -> Array:
    return np.nan_to_num(np.round(image.depth * 1e3)).astype(np.uint16)


def write_image(path: Path, pixels: Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[:, :, ::-1]))
    return path


def write_info(path: Path, camera: Intrinsics = OAK_D, model: str = "plumb_bob", **other: Any) -> Path:
    content = {
        "image_width": camera.width,
        "image_height": camera.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.matrix().ravel().tolist()},
        "distortion_model": model,
        "distortion_coefficients": {"data": list(camera.distortion)},
    }
    path.write_text(yaml.safe_dump(content | other))
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """a: electrodes, b: none."""
    folder = tmp_path_factory.mktemp("images")
    for name, image in (("a", view(1)), ("b", view(2, target=False))):
        write_image(folder / f"{name}.png", image.color)
        write_image(folder / f"{name}.depth.png", millimetres(image))
        np.save(folder / f"{name}.npy", image.depth)
    write_info(folder / "k.yaml")
    return folder


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, dict[str, Any], str]]:
    """Return exit code, JSON object and stderr."""

    def runner(*words: object) -> tuple[int, dict[str, Any], str]:
        code = main(["vision", "detect", *map(str, words), "--json"])
        captured = capsys.readouterr()
        return code, dict(json.loads(captured.out)), captured.err

    return runner


Run = Callable[..., tuple[int, dict[str, Any], str]]


def one(files: Path, name: str = "a", depth: str = ".depth.png") -> tuple[object, ...]:
    return ("--color", files / f"{name}.png", "--depth", files / f"{name}{depth}", "--camera-info", files / "k.yaml")


def near(found: dict[str, Any], away: float = 0.3, roll: float = 0.1, x: float = 0.01) -> None:
    """Check that the result is within 5 standard deviations of the truth, and that these are small."""
    covariance = np.array(found["covariance"])
    off = np.array(found["position"]) - pose(away, roll, x)[:3, 3]
    assert off @ np.linalg.solve(covariance[:3, :3], off) < 25.0
    assert np.sqrt(np.diag(covariance))[:3].max() < 0.002
    assert abs(found["roll"] - roll) < 0.01


@pytest.mark.parametrize("depth", [".depth.png", ".npy"])
def test_electrodes_are_found_at_their_pose(files: Path, run: Run, depth: str) -> None:
    code, found, _ = run(*one(files, depth=depth))
    assert code == DONE
    assert set(found) == KEYS
    assert found["found"] is True
    assert (found["frame"], found["source"]) == ("camera_color_optical_frame", "fused")
    near(found)
    assert found["normal"] == pytest.approx([0.0, 0.0, -1.0], abs=0.05)
    assert found["range"] == pytest.approx(np.linalg.norm(found["position"]))
    assert 0.0 < found["confidence"] <= 1.0


def test_no_electrodes_ends_with_1_and_without_a_guess(files: Path, run: Run) -> None:
    code, found, _ = run(*one(files, "b"))
    assert code == FAILED
    assert found["found"] is False
    assert set(found) == KEYS
    assert all(found[name] is None for name in KEYS - {"found", "frame", "detection_time"})


def test_text_is_in_millimetres_and_degrees(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["vision", "detect", *map(str, one(files))]) == DONE
    text = capsys.readouterr().out
    assert "camera_color_optical_frame: x 10." in text
    assert "roll 5." in text
    assert "image and depth" in text
    assert main(["vision", "detect", *map(str, one(files, "b"))]) == FAILED
    assert "no electrodes found" in capsys.readouterr().out


def test_with_a_mount_the_pose_is_also_in_charger_base(files: Path, tmp_path: Path, run: Run) -> None:
    """The camera looks along +z of charger_base: its x is −x there, its y is −y."""
    mount = tmp_path / "mount.yaml"
    numbers = {"position": [0.0, 0.1, -0.2], "orientation": [0.0, 0.0, 1.0, 0.0]}
    mount.write_text(yaml.safe_dump({"frame": "charger_base", **numbers}))
    code, found, _ = run(*one(files), "--mount", mount)
    assert code == DONE
    x, y, z = found["position"]
    placed = found["charger_base"]
    assert set(placed) == {"position", "roll", "normal", "covariance"}
    assert placed["position"] == pytest.approx([-x, 0.1 - y, z - 0.2])
    assert placed["roll"] == pytest.approx(found["roll"])
    assert placed["covariance"][0][0] > found["covariance"][0][0]
    code, found, _ = run(*one(files, "b"), "--mount", mount)
    assert (code, found["charger_base"]["position"]) == (FAILED, None)


def test_without_depth_the_image_alone_is_used(files: Path, tmp_path: Path, run: Run) -> None:
    code, found, stderr = run("--color", files / "a.png", "--camera-info", files / "k.yaml")
    assert (code, found["source"]) == (DONE, "pnp")
    near(found)
    assert "image alone" in stderr
    empty = write_image(tmp_path / "empty.png", np.zeros((400, 640), dtype=np.uint16))
    code, found, stderr = run("--color", files / "a.png", "--depth", empty, "--camera-info", files / "k.yaml")
    assert (code, found["source"]) == (DONE, "pnp")
    assert "image alone" in stderr


def test_an_unknown_normal_is_null(tmp_path: Path, run: Run) -> None:
    image = view(3, 0.9, 0.0, 0.0)
    color = write_image(tmp_path / "far.png", image.color)
    code, found, _ = run("--color", color, "--camera-info", write_info(tmp_path / "k.yaml"))
    assert code == DONE
    assert found["normal"] == [None, None, None]


def test_a_terminal_of_another_size_needs_its_file(files: Path, tmp_path: Path, run: Run) -> None:
    small = tmp_path / "small.yaml"
    small.write_text("{bar_length: 0.035, bar_height: 0.005, gap: 0.0037, bar_thickness: 0.003}")
    assert run(*one(files), "--terminal", small)[0] == FAILED
    paper = tmp_path / "paper.yaml"
    paper.write_text("bar_length: 0.070")
    assert run(*one(files), "--terminal", paper)[0] == DONE


def test_the_picture_shows_the_result(files: Path, tmp_path: Path, run: Run) -> None:
    for name in ("a", "b"):
        run(*one(files, name), "--picture", tmp_path / f"{name}.png")
        before, after = cv2.imread(str(files / f"{name}.png")), cv2.imread(str(tmp_path / f"{name}.png"))
        assert before.shape == after.shape
        assert (before != after).any()


def refused(run: Run, *words: object) -> str:
    code, found, stderr = run(*words)
    assert code == WRONG_INPUT, found
    assert found["success"] is False
    assert found["error"] in stderr
    return str(found["error"])


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        ({"camera_matrix": {"data": [0.0] * 9}}, "calibrate the camera first"),
        ({"distortion_coefficients": {"data": [-9.0, 0, 0, 0, 0]}}, "two directions"),
    ],
)
def test_wrong_intrinsics_are_named(files: Path, tmp_path: Path, run: Run, other: dict[str, Any], reason: str) -> None:
    info = write_info(tmp_path / "k.yaml", **other)
    assert reason in refused(run, "--color", files / "a.png", "--depth", files / "a.npy", "--camera-info", info)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("", "--color"),
        ("--color a.png", "--camera-info"),
        ("--color a.png --camera-info none.yaml", "none.yaml: there is no such file"),
        ("--color none.png --camera-info k.yaml", "none.png: there is no such file"),
        ("--color a.png --depth none.npy --camera-info k.yaml", "none.npy: there is no such file"),
        ("--color k.yaml --camera-info k.yaml", "k.yaml: is not an image"),
        ("--color empty.png --camera-info k.yaml", "empty.png: is empty"),
        ("--color . --camera-info k.yaml", "it is a folder"),
        ("--color a.png --camera-info a.png", "a.png: not valid YAML"),
        ("--color a.png --camera-info k.yaml --terminal none.yaml", "none.yaml: there is no such file"),
        ("--color a.png --camera-info k.yaml --terminal k.yaml", "k.yaml: camera_matrix: unknown key"),
        ("--color a.png --camera-info k.yaml --mount k.yaml", "k.yaml: unknown key"),
        ("--color a.png --camera-info k.yaml --picture none/out.png", "does not exist"),
        ("--color a.png --camera-info k.yaml --picture out.gif", "ends in"),
        ("--color a.png --camera-info k.yaml --picture folder.png", "folder.png"),
        ("--color a.png --camera-info k.yaml --pictures out", "--pictures is for"),
        ("--color a.png .", "not both"),
        (". --picture out.png", "--picture is for one image"),
        ("none", "none: there is no such file"),
        ("k.yaml", "give a folder or a recording"),
        ("nothing", "holds no images"),
        ("bare", "contains no camera_info.yaml"),
        ("bag", "give bag/x_0.mcap"),
        ("bare --camera-info k.yaml --color-topic /x", "--color-topic is for a recording"),
        ("bare --camera-info k.yaml --pictures a.png", "cannot be a folder"),
        ("none.mcap", "none.mcap: there is no such file"),
    ],
)
def test_wrong_usage_is_named(
    files: Path, tmp_path: Path, run: Run, monkeypatch: pytest.MonkeyPatch, words: str, reason: str
) -> None:
    pytest.importorskip("mcap", reason="reads recordings with deltacharger[record]")
    monkeypatch.chdir(tmp_path)
    for name in ("a.png", "k.yaml"):
        shutil.copy(files / name, name)
    Path("empty.png").touch()
    for folder in ("folder.png", "nothing", "bare", "bag"):
        Path(folder).mkdir()
    shutil.copy(files / "a.png", "bare/a.color.png")
    Path("bag/x_0.mcap").touch()
    assert reason in refused(run, *words.split())


def test_broken_images_do_not_stop_a_folder(files: Path, tmp_path: Path, run: Run) -> None:
    for name in ("a", "b"):
        shutil.copy(files / f"{name}.png", tmp_path / f"{name}.color.png")
        shutil.copy(files / f"{name}.depth.png", tmp_path / f"{name}.depth.png")
    shutil.copy(files / "a.png", tmp_path / "alone.color.png")
    (tmp_path / "broken.color.png").write_bytes((files / "a.png").read_bytes()[:9000])
    shutil.copy(files / "a.depth.png", tmp_path / "colorless.depth.png")
    shutil.copy(files / "k.yaml", tmp_path / "camera_info.yaml")
    code, found, stderr = run(tmp_path, "--pictures", tmp_path / "out")
    assert code == DONE
    results = {each.pop("name"): each for each in found["results"]}
    assert list(results) == ["a", "alone", "b", "broken", "colorless"]
    assert (found["found"], found["images"], found["broken"], found["left_out"]) == (2, 5, 2, 0)
    assert set(results["a"]) == set(results["b"]) == KEYS
    near(results["a"])
    assert (results["alone"]["source"], results["b"]["found"]) == ("pnp", False)
    assert "broken.color.png: is not an image, or damaged" in results["broken"]["error"]
    assert "no colour image" in results["colorless"]["error"]
    times = [results[name]["detection_time"] for name in ("a", "alone", "b")]
    assert found["detection_time"]["median"] == sorted(times)[1]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.png", "alone.png", "b.png"]
    for line in ("broken: ", "2 of 5 images", "100 %", "ms per image"):
        assert line in stderr


def test_a_folder_of_folders_and_its_exit_codes(
    files: Path, tmp_path: Path, run: Run, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(tmp_path / "color" / "7.png", view(2, target=False).color)
    (tmp_path / "depth").mkdir()
    shutil.copy(files / "b.npy", tmp_path / "depth" / "7.npy")
    code, found, _ = run(tmp_path, "--camera-info", files / "k.yaml")
    assert (code, found["found"], found["images"]) == (FAILED, 0, 1)
    (tmp_path / "color" / "7.png").write_bytes(b"broken")
    code, found, _ = run(tmp_path, "--camera-info", files / "k.yaml")
    assert (code, found["broken"], found["detection_time"]) == (WRONG_INPUT, 1, {"median": None, "p95": None})
    shutil.copy(files / "a.png", tmp_path / "color" / "8.png")
    assert main(["vision", "detect", str(tmp_path), "--camera-info", str(files / "k.yaml")]) == DONE
    text = capsys.readouterr().out
    assert "8: x 10." in text
    assert "electrodes found in 1 of 2 images" in text


class Recording:
    """Writes the messages of a camera."""

    def __init__(self, path: Path, prefix: str = "", model: str = "plumb_bob") -> None:
        pytest.importorskip("mcap", reason="reads recordings with deltacharger[record]")
        from sensor_msgs.msg import CameraInfo, CompressedImage, Image

        self.path = path
        self._image, self._info, self._compressed = Image, CameraInfo, CompressedImage
        self._prefix, self._model = prefix, model
        self._messages: list[tuple[str, Any, int]] = []

    def stamped(self, message: Any, stamp: int) -> Any:
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        return message

    def info(self, camera: Intrinsics = OAK_D, **other: Any) -> Recording:
        k = camera.matrix().ravel()
        numbers = {"width": camera.width, "height": camera.height, "k": k, "d": [*map(float, camera.distortion)]}
        message = self._info(**(numbers | {"distortion_model": self._model} | other))
        return self.add("color/camera_info", message, 0)

    def color(self, pixels: Array, stamp: int, topic: str = "color/image_raw", encoding: str = "rgb8") -> Recording:
        return self.image(topic, pixels, encoding, stamp)

    def depth(self, image: RgbdImage, stamp: int, topic: str = "depth/image_raw", metres: bool = False) -> Recording:
        return self.image(topic, image.depth if metres else millimetres(image), "32FC1" if metres else "16UC1", stamp)

    def image(self, topic: str, pixels: Array, encoding: str, stamp: int) -> Recording:
        step = pixels.nbytes // len(pixels)
        message = self._image(height=len(pixels), width=pixels.shape[1], encoding=encoding, step=step)
        message.data = array("B", np.ascontiguousarray(pixels).tobytes())
        return self.add(topic, message, stamp)

    def compressed(self, topic: str) -> Recording:
        return self.add(topic, self._compressed(format="jpeg"), 0)

    def add(self, topic: str, message: Any, stamp: int) -> Recording:
        self._messages.append((f"{self._prefix}/{topic}", self.stamped(message, stamp), stamp))
        return self

    def write(self) -> Path:
        from deltacharger_records.recording.mcap_recording import McapWriter

        with McapWriter(self.path, {topic: type(message) for topic, message, _ in self._messages}) as writer:
            for number, (topic, message, stamp) in enumerate(self._messages):
                writer.add_message(topic, message, stamp + number, stamp)
        return self.path


def test_a_recording_is_matched_by_stamps(tmp_path: Path, run: Run) -> None:
    """Depth is late and 5 ms off; one colour image has no depth, one depth image has another size."""
    recording, period = Recording(tmp_path / "rec.mcap", "/charger").info(), 33_000_000
    views = [view(each, 0.25 + 0.02 * each) for each in range(5)]
    for number, image in enumerate(views):
        recording.color(image.color, 10**9 + number * period)
    for number, image in enumerate(views):
        if number == 1:
            continue
        if number == 3:
            recording.image("depth/image_raw", millimetres(image)[:200], "16UC1", 10**9 + number * period)
        else:
            recording.depth(image, 10**9 + number * period + 5_000_000, metres=number == 2)
    code, found, stderr = run(recording.write(), "--pictures", tmp_path)
    assert code == DONE
    assert (found["found"], found["images"], found["broken"], found["left_out"]) == (3, 4, 1, 1)
    results = {each["name"]: each for each in found["results"]}
    assert list(results) == ["1.000000000", "1.066000000", "1.099000000", "1.132000000"]
    for name, number in (("1.000000000", 0), ("1.066000000", 2), ("1.132000000", 4)):
        near(results[name], 0.25 + 0.02 * number)
        assert results[name]["source"] == "fused"
        assert (tmp_path / f"{name}.png").exists()
    assert "64" in results["1.099000000"]["error"]
    assert "1.099000000: " in stderr
    assert "1 more left out" in stderr


def test_topic_names_of_another_driver_and_intrinsics_from_a_file(files: Path, tmp_path: Path, run: Run) -> None:
    image = view(1)
    recording = Recording(tmp_path / "rec.mcap")
    recording.color(image.color[:, :, ::-1], 5, "oak/rgb/image_raw", "bgr8").depth(image, 5, "oak/stereo/image_raw")
    path = recording.write()
    words = ("--color-topic", "oak/rgb/image_raw", "--depth-topic", "/oak/stereo/image_raw")
    assert "no camera_info" in refused(run, path, *words)
    code, found, _ = run(path, *words, "--camera-info", files / "k.yaml")
    assert (code, found["results"][0]["source"]) == (DONE, "fused")
    near(found["results"][0])
    assert "name one of" in refused(run, path, "--camera-info", files / "k.yaml")
    code, found, stderr = run(path, *words[:2], "--camera-info", files / "k.yaml")
    assert (code, found["results"][0]["source"]) == (DONE, "pnp")
    assert "no depth topic" in stderr


def test_lens_distortion_is_read_from_the_recording(tmp_path: Path, run: Run) -> None:
    for model, distortion in LENSES.items():
        camera = dataclasses.replace(OAK_D, distortion=distortion)
        image = view(4, 0.3, 0.1, 0.06, camera=SimulatedCamera(camera))
        recording = Recording(tmp_path / f"{model}.mcap", model=model).info(camera)
        code, found, _ = run(recording.color(image.color, 1).depth(image, 1).write())
        assert code == DONE
        near(found["results"][0], 0.3, 0.1, 0.06)


def test_recordings_without_images_are_refused(tmp_path: Path, run: Run) -> None:
    image = view(1)
    path = tmp_path / "rec.mcap"
    assert "no topic /x" in refused(run, Recording(path).info().color(image.color, 1).write(), "--color-topic", "x")
    assert "holds no images" in refused(run, Recording(path).info().write())
    compressed = Recording(path).info().compressed("color/image_raw/compressed").write()
    assert "record /color/image_raw instead" in refused(run, compressed)
    apart = Recording(path).info().color(image.color, 1).depth(image, 10**9).write()
    assert "same instant" in refused(run, apart)
    assert "binning" in refused(run, Recording(path).info(binning_x=2).color(image.color, 1).write())
    assert "calibrate" in refused(run, Recording(path).info(k=[0.0] * 9).color(image.color, 1).write())
    path.write_bytes(b"no recording")
    assert "no MCAP file" in refused(run, path)


def test_images_before_damage_count(tmp_path: Path, run: Run) -> None:
    recording = Recording(tmp_path / "rec.mcap").info()
    for number in range(3):
        image = view(number)
        recording.color(image.color, number * 10**8).depth(image, number * 10**8)
    path = recording.write()
    path.write_bytes(path.read_bytes()[: int(0.7 * path.stat().st_size)])
    code, found, stderr = run(path)
    assert code == DONE
    assert 1 <= found["found"] == found["images"] < 3
    assert "ends early" in stderr


def test_without_opencv_it_ends_with_2(files: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert "pip install 'deltacharger[vision]'" in refused(run, *one(files))
