# SPDX-License-Identifier: Apache-2.0
"""`deltacharger vision detect`: find electrodes in an image or a recording."""

import argparse
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_bringup.cli import arguments, output
from deltacharger_core import environment
from deltacharger_core.mcap_file import RecordingError, recordings_in
from deltacharger_vision import image_files, terminal
from deltacharger_vision.detector.detector import ElectrodeDetector, annotated
from deltacharger_vision.errors import VisionError
from deltacharger_vision.mount import CAMERA_FRAME, FRAME, Mount, Placed
from deltacharger_vision.ros.recording import CameraRecording, CameraTopics

_TOPICS = ("color_topic", "depth_topic")
_PLACED = ("position", "roll", "normal", "covariance")
_SEEN = (*_PLACED, "confidence", "range", "source")


def add_detect(parser: argparse.ArgumentParser) -> None:
    """Add the options of `vision detect`."""
    add = parser.add_argument
    text = "PNG or JPEG; recording, or a folder with one"
    add("path", metavar="IMAGE|REC.mcap", help=text)
    text = "of one image: aligned depth, 16-bit mm or float m (default: none)"
    add("--depth", metavar="A.png|A.npy", help=text)
    text = "intrinsics of the colour image (recording: its own)"
    add("--camera-info", metavar="K.yaml", help=text)
    add("--terminal", metavar="T.yaml", help="size of the bars (default: 70 × 10 mm, 7.4 mm apart)")
    add("--mount", metavar="MOUNT.yaml", help="also report the pose in charger_base")
    add("--pictures", metavar="DIR", help="folder for a copy of every image with the result drawn into it")
    add = parser.add_argument_group("of a recording").add_argument
    add("--color-topic", default="", metavar="NAME", help="(topic ending in color/image_raw)")
    add("--depth-topic", default="", metavar="NAME", help="(depth/image_raw of the same camera)")


@dataclass(frozen=True)
class _Images:
    """Images of one camera (`Intrinsics` or a CameraInfo): with a name and a method `read`; some may be left out."""

    images: Iterable[Any]
    count: int
    camera: Any


def detect(options: argparse.Namespace) -> output.Result:
    """Find the electrodes in one image or in many."""
    with output.wrong_input(VisionError, RecordingError):
        image_files.require_opencv().setNumThreads(1)  # an image is too little work for several threads
        pictures = None if options.pictures is None else arguments.folder_to_write("--pictures", options.pictures)
        source = _source(options, Path(options.path))
        results: list[dict[str, Any]] = []
        try:
            progress = output.Tenths()
            for result in _search(options, source, pictures):
                results.append(result)
                progress(len(results) / source.count, f"{len(results)} of {source.count} images")
        except RecordingError as error:  # images before the damage are still reported
            if not results:
                raise
            output.log_line(str(error))
    if not results:
        text = f"none of {source.count} images has a depth image of the same instant: record both with equal stamps"
        raise output.WrongInput(f"{options.path}: {text}")
    found, broken = (sum(bool(each.get(name)) for each in results) for name in ("found", "error"))
    left_out = source.count - len(results)  # without depth of the same instant, or behind damage
    total = {"found": found, "images": len(results), "broken": broken, "left_out": left_out}
    lines = [f"{each['name']}: {_text(each)}" for each in results]
    lines.append(f"electrodes found in {found} of {len(results)} images; {broken} broken, {left_out} left out")
    code = output.DONE if found else output.WRONG_INPUT if broken == len(results) else output.FAILED
    return output.Result("\n".join(lines), {"frame": CAMERA_FRAME, **total, "results": results}, code)


def _search(options: argparse.Namespace, source: _Images, pictures: Path | None) -> Iterator[dict[str, Any]]:
    """Yield the result of each image; a broken one of many has `error`."""
    detector = ElectrodeDetector(terminal.Terminal.load(options.terminal) if options.terminal else None)
    mount = Mount.load(options.mount) if options.mount else None
    for each in source.images:
        try:
            image = each.read(source.camera)
            found = detector.detect(image)
        except (VisionError, OSError) as error:
            if source.count == 1:
                raise
            yield {"name": each.name, "error": str(error)}
            continue
        if pictures is not None:
            image_files.write_picture(pictures / f"{each.name}.png", annotated(image, found))
        yield {"name": each.name, **_fields(found, mount)}


def _source(options: argparse.Namespace, path: Path) -> _Images:
    if recordings_in(path) or path.is_dir():
        if options.depth is not None:
            raise output.WrongInput("--depth is for one image")
        return _recorded(options, path)
    for name in filter(lambda name: getattr(options, name), _TOPICS):
        raise output.WrongInput(f"--{name.replace('_', '-')} is for a recording")
    if options.camera_info is None:
        raise output.WrongInput("one image needs --camera-info, its intrinsics")
    depth = None if options.depth is None else Path(options.depth)
    return _Images(
        [image_files.ImageFiles(path.stem, path, depth)], 1, image_files.load_camera_info(options.camera_info)
    )


def _recorded(options: argparse.Namespace, path: Path) -> _Images:
    """Return the images of a recording."""
    environment.prepare()
    from deltacharger_vision.ros.recording import recorded_images, recorded_info

    recording = CameraRecording(path, CameraTopics(options.color_topic, options.depth_topic))
    topics = recording.topics
    given = None if options.camera_info is None else image_files.load_camera_info(options.camera_info)
    camera = given or recorded_info(recording)
    if camera is None:
        raise output.WrongInput(f"{path} has no camera_info beside {topics.color}; give --camera-info")
    if not recording.images:
        raise output.WrongInput(f"{path}: {topics.color} holds no images; record again")
    if not topics.depth:
        output.log_line(f"{path} has no depth topic; using the colour images alone")
    return _Images(recorded_images(recording), recording.images, camera)


def _fields(found: terminal.Detection | None, mount: Mount | None) -> dict[str, Any]:
    """Return the result of one image, with a mount also in charger_base; NaN = unknown, None = no electrodes."""
    result = {"found": found is not None, "frame": CAMERA_FRAME, **_named(found, _SEEN)}
    if mount is not None:
        result[FRAME] = _named(None if found is None else mount.place(found), _PLACED)
    return result


def _named(found: terminal.Detection | Placed | None, names: Sequence[str]) -> dict[str, Any]:
    values = {name: getattr(found, name, None) for name in names}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def _text(result: Mapping[str, Any]) -> str:
    """Return a result as a line: the pose in charger_base if known, else in the camera's frame."""
    if "error" in result:
        return str(result["error"])
    if not result["found"]:
        return "no electrodes found"
    pose = result.get(FRAME, result)
    place = "  ".join(f"{axis} {1e3 * value:.2f}" for axis, value in zip("xyz", pose["position"], strict=True))
    spread = np.sqrt(np.diag(pose["covariance"]))
    errors = " ".join(f"{1e3 * value:.2f}" for value in spread[:3])
    roll = f"roll {math.degrees(pose['roll']):.2f}° (± {math.degrees(spread[5]):.2f})"
    source = "image and depth" if result["source"] == "both" else "the image alone"
    frame = FRAME if FRAME in result else CAMERA_FRAME
    return f"{place} mm (± {errors}), {roll} in {frame}, confidence {result['confidence']:.2f}, from {source}"
