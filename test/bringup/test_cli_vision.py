# SPDX-License-Identifier: Apache-2.0
"""`deltacharger vision detect` on simulated images in files and recordings, and its errors."""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltacharger_vision.images import RgbdImage
from deltacharger_vision.mount import CAMERA_FRAME
from deltacharger_vision.rendering import camera, scene

from .command import Capture, answer

cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")

Array = np.ndarray[Any, Any]
KEYS = {
    *("name", "found", "frame", "position", "roll", "normal", "covariance", "confidence", "range", "source"),
}


def pose(away: float = 0.3, roll: float = 0.1, x: float = 0.01) -> Array:
    """camera_T_terminal: upright but for `roll`, `away` m before the camera."""
    found = np.eye(4)
    c, s = math.cos(roll), math.sin(roll)
    found[:3, :3] = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)]) @ np.diag([-1.0, -1.0, 1.0])
    found[:3, 3] = x, -0.01, away
    return found


def view(seed: int, *where: float, target: bool = True) -> RgbdImage:
    random = np.random.default_rng(20_000 + seed)
    return camera.SimulatedCamera().render(scene.RenderedScene(target=target), pose(*where), random)


def millimetres(image: RgbdImage) -> Array:
    return np.nan_to_num(np.round(image.depth * 1e3)).astype(np.uint16)


def write_image(path: Path, pixels: Array) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), pixels if pixels.ndim == 2 else np.ascontiguousarray(pixels[:, :, ::-1]))
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """a: electrodes, b: none."""
    folder = tmp_path_factory.mktemp("images")
    for name, image in (("a", view(1)), ("b", view(2, target=False))):
        write_image(folder / f"{name}.png", image.color)
        write_image(folder / f"{name}.depth.png", millimetres(image))
        np.save(folder / f"{name}.npy", image.depth)
    info = {
        "image_width": camera.OAK_D.width,
        "image_height": camera.OAK_D.height,
        "camera_matrix": {"rows": 3, "cols": 3, "data": camera.OAK_D.matrix().ravel().tolist()},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"data": list(camera.OAK_D.distortion)},
    }
    (folder / "k.yaml").write_text(yaml.safe_dump(info))
    return folder


def detect(capsys: Capture, *words: object) -> tuple[int, dict[str, Any]]:
    return answer(capsys, "vision", "detect", *words)


def alone(capsys: Capture, *words: object) -> tuple[int, dict[str, Any]]:
    """Return the exit code, and the result of the only image."""
    code, found = detect(capsys, *words)
    (result,) = found["results"]
    return code, result


def one(files: Path, name: str = "a", depth: str = ".depth.png") -> tuple[object, ...]:
    return (files / f"{name}.png", "--depth", files / f"{name}{depth}", "--camera-info", files / "k.yaml")


def near(found: dict[str, Any], away: float = 0.3, roll: float = 0.1, x: float = 0.01) -> None:
    """Check that the result is within 5 standard deviations of the truth, and that these are small."""
    covariance = np.array(found["covariance"])
    off = np.array(found["position"]) - pose(away, roll, x)[:3, 3]
    assert off @ np.linalg.solve(covariance[:3, :3], off) < 25.0
    assert np.sqrt(np.diag(covariance))[:3].max() < 0.01 * away
    assert abs(found["roll"] - roll) < 0.01


@pytest.mark.parametrize("depth", [".depth.png", ".npy"])
def test_electrodes_are_found_at_their_pose(files: Path, capsys: Capture, depth: str) -> None:
    code, found = alone(capsys, *one(files, "b"))
    assert (code, set(found), found["found"]) == (1, KEYS, False)
    assert all(found[name] is None for name in KEYS - {"name", "found", "frame"})
    code, found = alone(capsys, *one(files, depth=depth))
    assert (code, set(found), found["found"]) == (0, KEYS, True)
    assert (found["frame"], found["source"]) == ("camera_color_optical_frame", "both")
    near(found)
    assert found["normal"] == pytest.approx([0.0, 0.0, -1.0], abs=0.05)
    assert found["range"] == pytest.approx(np.linalg.norm(found["position"]))
    assert 0.0 < found["confidence"] <= 1.0


def test_with_a_mount_the_pose_is_also_in_charger_base(files: Path, tmp_path: Path, capsys: Capture) -> None:
    """The camera looks along +z of charger_base: its x is −x there, its y is −y."""
    mount = tmp_path / "mount.yaml"
    numbers = {"position": [0.0, 0.1, -0.2], "orientation": [0.0, 0.0, 1.0, 0.0]}
    mount.write_text(yaml.safe_dump({"frame": "charger_base", **numbers}))
    code, found = alone(capsys, *one(files), "--mount", mount)
    x, y, z = found["position"]
    placed = found["charger_base"]
    assert (code, set(placed)) == (0, {"position", "roll", "normal", "covariance"})
    assert placed["position"] == pytest.approx([-x, 0.1 - y, z - 0.2])
    assert placed["roll"] == pytest.approx(found["roll"])
    assert placed["covariance"][0][0] > found["covariance"][0][0]


@pytest.mark.parametrize("depth", [False, True])
def test_without_depth_the_image_alone_is_used(files: Path, tmp_path: Path, capsys: Capture, depth: bool) -> None:
    empty = write_image(tmp_path / "empty.png", np.zeros((400, 640), dtype=np.uint16))
    words = (files / "a.png", "--camera-info", files / "k.yaml", *(("--depth", empty) if depth else ()))
    code, found = alone(capsys, *words)
    assert (code, found["source"]) == (0, "image")
    near(found)


def record(path: Path, *images: tuple[str, Array, int]) -> Path:
    """Write images (topic, pixels, stamp), and their intrinsics."""
    pytest.importorskip("mcap", reason="reads recordings with deltacharger[record]")
    from builtin_interfaces.msg import Time
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import Image

    from deltacharger_bringup.records.recording.mcap_recording import McapWriter, Topic
    from deltacharger_core.mcap_file import Raw
    from deltacharger_core.ros import qos
    from deltacharger_vision.ros.messages import camera_info_message

    messages: list[tuple[str, Any, int]] = [("/color/camera_info", camera_info_message(camera.OAK_D, Time()), 0)]
    for topic, pixels, stamp in images:
        encoding, step = "rgb8" if pixels.ndim == 3 else "16UC1", pixels.nbytes // len(pixels)
        message = Image(height=len(pixels), width=pixels.shape[1], encoding=encoding, step=step)
        message.data, message.header.frame_id = array("B", pixels.tobytes()), CAMERA_FRAME
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        messages.append((topic, message, stamp))
    topics = {topic: Topic(topic, type(message), qos.SENSOR) for topic, message, _ in messages}
    with McapWriter(path.open("wb"), topics) as writer:
        for number, (topic, message, stamp) in enumerate(messages):
            writer.add(Raw(topic, stamp + number, stamp, serialize_message(message)))
    return path


COLOR, DEPTH = "/color/image_raw", "/depth/image_raw"


def test_a_recording_is_matched_by_stamps(tmp_path: Path, capsys: Capture) -> None:
    """Depth is late and 5 ms off; one colour image has no depth, one depth image has another size."""
    views = [view(each, 0.25 + 0.02 * each) for each in range(4)]
    stamps = [10**9 + number * 33_000_000 for number in range(4)]
    depths = [(DEPTH, millimetres(views[number]), stamps[number] + 5_000_000) for number in (0, 2)]
    depths.append((DEPTH, millimetres(views[3])[:200], stamps[3]))
    colors = [(COLOR, image.color, stamp) for image, stamp in zip(views, stamps, strict=True)]
    code, found = detect(capsys, record(tmp_path / "rec.mcap", *colors, *depths), "--pictures", tmp_path)
    assert (code, found["found"], found["images"], found["broken"], found["left_out"]) == (0, 2, 3, 1, 1)
    results = {each["name"]: each for each in found["results"]}
    assert list(results) == ["1.000000000", "1.066000000", "1.099000000"]
    for name, number in (("1.000000000", 0), ("1.066000000", 2)):
        near(results[name], 0.25 + 0.02 * number)
        assert (results[name]["source"], (tmp_path / f"{name}.png").exists()) == ("both", True)
    assert "64" in results["1.099000000"]["error"]
