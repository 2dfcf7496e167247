# SPDX-License-Identifier: Apache-2.0
"""Results of the detector: JSON-ready, and as lines for people."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from deltacharger_vision.detector.detection import Detection
from deltacharger_vision.mount import CAMERA_FRAME, FRAME, Mount
from deltacharger_vision.placed import Placed

_PLACED = ("position", "roll", "normal", "covariance")
_SEEN = (*_PLACED, "confidence", "range", "source")


def fields(found: Detection | None, mount: Mount | None, seconds: float) -> dict[str, Any]:
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


def lines(found: Detection, mount: Mount | None) -> Iterator[str]:
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


def summary(results: Sequence[Mapping[str, Any]], expected: int) -> dict[str, Any]:
    """Return the number of images with electrodes, and the run times.

    Args:
        results: of each image: `name`, and `fields` or `error`.
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


def short(result: Mapping[str, Any]) -> str:
    """Return a result as a line: the pose in charger_base if known, else in the camera's frame."""
    if "error" in result:
        return str(result["error"])
    if not result["found"]:
        return "no electrodes found"
    x, y, z = (f"{1e3 * value:.1f}" for value in result.get(FRAME, result)["position"])
    roll = math.degrees(result.get(FRAME, result)["roll"])
    return f"x {x}  y {y}  z {z} mm, roll {roll:.2f}°, confidence {result['confidence']:.2f}"


def total_line(total: Mapping[str, Any]) -> str:
    """Return the summary as a line."""
    parts = [f"electrodes found in {total['found']} of {total['images']} images"]
    if total["broken"]:
        parts.append(f"{total['broken']} of them broken")
    if total["left_out"]:
        parts.append(f"{total['left_out']} more left out: no depth of the same instant, or behind damage")
    if total["detection_time"]["median"] is not None:
        parts.append(f"{1e3 * total['detection_time']['median']:.1f} ms per image")
    return "; ".join(parts)
