# SPDX-License-Identifier: Apache-2.0
"""`deltacharger vision detect`: find electrodes in an image, a folder of images or a recording."""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from deltacharger_bringup.cli.arguments import between, file_to_write, folder_to_write
from deltacharger_bringup.cli.output import (
    DONE,
    FAILED,
    WRONG_INPUT,
    CommandError,
    Result,
    log_line,
    wrong_input,
)
from deltacharger_core import environment
from deltacharger_core.mcap_file import RecordingError, recordings_in
from deltacharger_vision.cameras.camera_info import load_camera_info
from deltacharger_vision.cameras.recording import CameraRecording, CameraTopics
from deltacharger_vision.detector.annotate import annotated
from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.errors import VisionError
from deltacharger_vision.image_files import (
    CAMERA_INFO,
    check_picture_name,
    images_in,
    read_rgbd,
    require_opencv,
    write_picture,
)
from deltacharger_vision.images import RgbdImage
from deltacharger_vision.mount import CAMERA_FRAME, FRAME, Mount
from deltacharger_vision.placed import Placed
from deltacharger_vision.terminal import Terminal

_ONE = ("depth", "picture")
_TOPICS = ("color_topic", "depth_topic", "info_topic")
_MANY = ("pictures", *_TOPICS)
_NAMED = 10  # broken images named on stderr; the JSON object names all


def add_detect(parser: argparse.ArgumentParser) -> None:
    """Add the options of `vision detect`."""
    parser.add_argument(
        "path",
        nargs="?",
        metavar="FOLDER|REC.mcap",
        help="images NAME.color.png and NAME.depth.png (or color/NAME.png and depth/NAME.png), or a recording",
    )
    one = parser.add_argument_group("one image")
    one.add_argument("--color", metavar="A.png", help="PNG or JPEG")
    one.add_argument("--depth", metavar="A.png|A.npy", help="aligned depth: 16-bit mm, or float m (default: none)")
    one.add_argument("--picture", metavar="OUT.png", help="copy of the image with the result drawn into it")
    many = parser.add_argument_group("a folder or a recording")
    many.add_argument("--pictures", metavar="DIR", help="folder for such a copy of every image")
    many.add_argument("--color-topic", default="", metavar="NAME", help="(topic ending in color/image_raw)")
    many.add_argument("--depth-topic", default="", metavar="NAME", help="(depth/image_raw of the same camera)")
    many.add_argument("--info-topic", default="", metavar="NAME", help="(camera_info beside the colour)")
    parser.add_argument(
        "--camera-info",
        metavar="K.yaml",
        help="intrinsics of the colour image (folder: its camera_info.yaml; recording: its own)",
    )
    parser.add_argument(
        "--depth-unit-mm",
        type=between(0.01, 10.0),
        default=1.0,
        metavar="MM",
        help="unit of 16-bit depth (default: 1, some cameras 0.1)",
    )
    parser.add_argument("--terminal", metavar="T.yaml", help="size of the bars (default: 70 × 10 mm, 7.4 mm apart)")
    parser.add_argument("--mount", metavar="MOUNT.yaml", help="also report the pose in charger_base")


class _Readable(Protocol):
    """An image that is read only when it is needed."""

    @property
    def name(self) -> str:
        """Name in the results."""

    def read(self, camera: Any, depth_unit: float) -> RgbdImage:
        """Return the image, or raise VisionError or OSError."""


@dataclass(frozen=True)
class _Images:
    """Images of one camera: `Intrinsics` or a CameraInfo; `images` may leave out some of the `count` recorded."""

    images: Iterable[_Readable]
    count: int
    camera: Any


def detect(options: argparse.Namespace) -> Result:
    """Find the electrodes in one image or in many."""
    _check_usage(options)
    with wrong_input(VisionError, RecordingError):
        require_opencv().setNumThreads(1)  # an image is too little work for several threads
        finder = _Finder(options)
        return _one(options, finder) if options.path is None else _many(options, finder)


def _check_usage(options: argparse.Namespace) -> None:
    if options.path is None and options.color is None:
        raise CommandError("give --color for one image, or a folder or a recording", WRONG_INPUT)
    if options.path is not None and options.color is not None:
        raise CommandError(f"give --color or {options.path}, not both", WRONG_INPUT)
    for name in _MANY if options.path is None else _ONE:
        if getattr(options, name):
            where = "a folder or a recording" if options.path is None else "one image, with --color"
            raise CommandError(f"{_flag(name)} is for {where}", WRONG_INPUT)


class _Finder:
    """The detector and the mount of one call."""

    def __init__(self, options: argparse.Namespace) -> None:
        self._detector = ElectrodeDetector(Terminal.load(options.terminal) if options.terminal else None)
        self.mount = Mount.load(options.mount) if options.mount else None

    def find(self, image: RgbdImage) -> tuple[Detection | None, dict[str, Any]]:
        """Return the detection in an image, and its JSON-ready fields."""
        started = time.perf_counter()
        found = self._detector.detect(image)
        return found, _fields(found, self.mount, time.perf_counter() - started)


def _one(options: argparse.Namespace, finder: _Finder) -> Result:
    if options.camera_info is None:
        raise CommandError("--color needs --camera-info, the intrinsics of the image", WRONG_INPUT)
    picture = None if options.picture is None else file_to_write("--picture", options.picture)
    if picture is not None:
        check_picture_name(picture)
    depth = None if options.depth is None else Path(options.depth)
    intrinsics = load_camera_info(options.camera_info)
    image = read_rgbd(Path(options.color), depth, intrinsics, 1e-3 * options.depth_unit_mm)
    if depth is None:
        log_line("no --depth: using the colour image alone")
    elif not np.isfinite(image.depth).any():
        log_line(f"{depth}: all depth is unknown; using the colour image alone")
    found, fields = finder.find(image)
    if picture is not None:
        write_picture(picture, annotated(image, found))
    lines = ["no electrodes found"] if found is None else _lines(found, finder.mount)
    return Result("\n".join(lines), fields, FAILED if found is None else DONE)


def _many(options: argparse.Namespace, finder: _Finder) -> Result:
    pictures = None if options.pictures is None else folder_to_write("--pictures", options.pictures)
    path = Path(options.path)
    source = _recorded(options, path) if recordings_in(path) else _stored(options, path)
    results: list[dict[str, Any]] = []
    progress = _Progress(source.count)
    try:
        for each in source.images:
            try:
                image = each.read(source.camera, 1e-3 * options.depth_unit_mm)
                found, fields = finder.find(image)
            except (VisionError, OSError) as error:
                progress.broken(each.name, error)
                results.append({"name": each.name, "error": str(error)})
                continue
            if pictures is not None:
                write_picture(pictures / f"{each.name}.png", annotated(image, found))
            results.append({"name": each.name, **fields})
            progress.searched(found is not None)
    except RecordingError as error:  # images before the damage are still reported
        if not results:
            raise
        log_line(str(error))
    if not results:
        text = f"none of {source.count} images has a depth image of the same instant: record both with equal stamps"
        raise CommandError(f"{path}: {text}", WRONG_INPUT)
    return _report_many(results, source.count)


def _report_many(results: list[dict[str, Any]], count: int) -> Result:
    total = _summary(results, count)
    lines = [*(f"{each['name']}: {_short(each)}" for each in results), _total_line(total)]
    code = DONE if total["found"] else WRONG_INPUT if total["broken"] == total["images"] else FAILED
    return Result("\n".join(lines), {"frame": CAMERA_FRAME, **total, "results": results}, code)


def _stored(options: argparse.Namespace, folder: Path) -> _Images:
    """Return the images of a folder."""
    if folder.exists() and not folder.is_dir():
        raise CommandError(f"{folder}: give a folder or a recording (*.mcap), or --color", WRONG_INPUT)
    for name in _TOPICS:
        if getattr(options, name):
            raise CommandError(f"{_flag(name)} is for a recording", WRONG_INPUT)
    images = images_in(folder)
    info = folder / CAMERA_INFO if options.camera_info is None else Path(options.camera_info)
    if options.camera_info is None and not info.exists():
        raise CommandError(f"{folder} contains no {CAMERA_INFO}; put it there, or give --camera-info", WRONG_INPUT)
    alone = sum(each.depth is None for each in images)
    if alone:
        log_line(f"{alone} of {len(images)} images have no depth image")
    return _Images(images, len(images), load_camera_info(info))


def _recorded(options: argparse.Namespace, path: Path) -> _Images:
    """Return the images of a recording."""
    environment.prepare()
    from deltacharger_records.recording.rgbd_recording import recorded_images, recorded_info

    recording = CameraRecording(path, CameraTopics(options.color_topic, options.depth_topic, options.info_topic))
    topics = recording.topics
    given = None if options.camera_info is None else load_camera_info(options.camera_info)
    camera = given or recorded_info(recording)
    if camera is None:
        raise CommandError(f"{path} has no camera_info beside {topics.color}; give --camera-info", WRONG_INPUT)
    if not recording.images:
        raise CommandError(f"{path}: {topics.color} holds no images; record again", WRONG_INPUT)
    if not topics.depth:
        log_line(f"{path} has no depth topic; using the colour images alone")
    return _Images(recorded_images(recording), recording.images, camera)


class _Progress:
    """Print progress on stderr, at most at every tenth, and the names of broken images."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._seen = self._found = self._broken = self._tenth = 0

    def searched(self, found: bool) -> None:
        """Count a searched image."""
        self._found += found
        self._count_one()

    def broken(self, name: str, error: Exception) -> None:
        """Count a broken image and name it."""
        self._broken += 1
        if self._broken <= _NAMED:
            log_line(f"{name}: {error}")
        elif self._broken == _NAMED + 1:
            log_line("more images are broken; --json names all")
        self._count_one()

    def _count_one(self) -> None:
        self._seen += 1
        tenth = 10 * self._seen // self._count
        if tenth > self._tenth:
            self._tenth = tenth
            log_line(f"{10 * tenth:3} %  {self._seen} of {self._count} images, electrodes in {self._found}")


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


_PLACED = ("position", "roll", "normal", "covariance")
_SEEN = (*_PLACED, "confidence", "range", "source")


def _fields(found: Detection | None, mount: Mount | None, seconds: float) -> dict[str, Any]:
    """Return the result of one image; NaN = unknown, None = absent.

    Args:
        found: None = no electrodes.
        mount: adds the pose in charger_base.
        seconds: run time of the detector.
    """
    result = {"found": found is not None, "frame": CAMERA_FRAME, **_named(found, _SEEN)}
    if mount is not None:
        result[FRAME] = _named(None if found is None else mount.place(found), _PLACED)
    return {**result, "detection_time": seconds}


def _named(found: Detection | Placed | None, names: Sequence[str]) -> dict[str, Any]:
    values = {name: getattr(found, name, None) for name in names}
    return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in values.items()}


def _lines(found: Detection, mount: Mount | None) -> Iterator[str]:
    """Yield a detection as lines for people."""
    yield _pose(CAMERA_FRAME, found)
    if mount is not None:
        yield _pose(FRAME, mount.place(found))
    source = "image and depth" if found.source == "both" else "the image alone"
    yield f"range {1e3 * found.range:.1f} mm, confidence {found.confidence:.2f}, from {source}"


def _pose(frame: str, found: Detection | Placed) -> str:
    place = "  ".join(f"{axis} {1e3 * value:.2f}" for axis, value in zip("xyz", found.position, strict=True))
    spread = np.sqrt(np.diag(found.covariance))
    errors = " ".join(f"{1e3 * value:.2f}" for value in spread[:3])
    return f"{frame}: {place} mm (± {errors}), roll {math.degrees(found.roll):.2f}° (± {math.degrees(spread[5]):.2f})"


def _summary(results: Sequence[Mapping[str, Any]], expected: int) -> dict[str, Any]:
    """Return the number of images with electrodes, and the run times.

    Args:
        results: of each image: `name`, and `_fields` or `error`.
        expected: number of images; those left out have no depth of the same instant, or lie behind damage.
    """
    times = [each["detection_time"] for each in results if "error" not in each]
    return {
        "found": sum(bool(each.get("found")) for each in results),
        "images": len(results),
        "broken": len(results) - len(times),
        "left_out": expected - len(results),
        "detection_time": {
            "median": statistics.median(times) if times else None,
            "p95": float(np.percentile(times, 95.0)) if times else None,
        },
    }


def _short(result: Mapping[str, Any]) -> str:
    """Return a result as a line: the pose in charger_base if known, else in the camera's frame."""
    if "error" in result:
        return str(result["error"])
    if not result["found"]:
        return "no electrodes found"
    x, y, z = (f"{1e3 * value:.1f}" for value in result.get(FRAME, result)["position"])
    roll = math.degrees(result.get(FRAME, result)["roll"])
    return f"x {x}  y {y}  z {z} mm, roll {roll:.2f}°, confidence {result['confidence']:.2f}"


def _total_line(total: Mapping[str, Any]) -> str:
    """Return the summary as a line."""
    parts = [f"electrodes found in {total['found']} of {total['images']} images"]
    if total["broken"]:
        parts.append(f"{total['broken']} of them broken")
    if total["left_out"]:
        parts.append(f"{total['left_out']} more left out: no depth of the same instant, or behind damage")
    if total["detection_time"]["median"] is not None:
        parts.append(f"{1e3 * total['detection_time']['median']:.1f} ms per image")
    return "; ".join(parts)
