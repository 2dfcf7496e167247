# SPDX-License-Identifier: Apache-2.0
"""Texts from and for people and other programs: their bounds, units of numbers.

Bounds of places and angles from people, files and other programs, and the question that other units deserve.
Everything is in metres and radians, but people measure in millimetres and degrees. A pose in these is a number like any
other, so it is refused by its size.
"""

import math
from collections.abc import Iterable

from deltacharger_core.files import brief

REQUEST_ID_MAX = 256
"""Maximum characters of a goal's request_id, which states, decisions, logs, records and file names repeat."""
MESSAGE_MAX = 1000
"""Maximum characters of another node's message that are repeated."""


def cut(text: str, most: int = MESSAGE_MAX) -> str:
    """Return a text; a longer one is cut and its length stated."""
    return text if len(text) <= most else f"{text[:most]}… ({len(text)} characters)"


def wrong_id(request_id: str) -> str:
    """Return the error in a goal's request_id; '' = none."""
    if len(request_id) <= REQUEST_ID_MAX:
        return ""
    return f"request_id has {len(request_id)} characters: give at most {REQUEST_ID_MAX}"


def titled(action: str, request_id: str) -> str:
    """Return a goal's name for logs: action and request_id, if any."""
    return f"{action} {request_id}" if request_id else action


def passage(title: str, before: str, after: str, lasted: float, *more: str) -> str:
    """Return a log line for the change of a goal's phase; `lasted`: s in the phase before (NaN = omitted)."""
    after = f"{after.lower()} after {lasted:.1f} s" if lasted == lasted else after.lower()
    return ", ".join((f"{title}: {before.lower()} → {after}", *more))


UNKNOWN = "unknown"


def quantity(value: float, form: str, unit: str) -> str:
    """Return a number with its unit; "unknown" for NaN, "no limit" for infinity.

    Args:
        value: in `unit`.
        form: number format, such as ".1f".
        unit: unit symbol.
    """
    if math.isnan(value):
        return UNKNOWN
    return "no limit" if math.isinf(value) else f"{value:{form}} {unit}"


def figure(value: float, unit: str, digits: int, width: int = 0) -> str:
    """Return a number with its unit; – for NaN."""
    text = "–" if value != value else f"{value:.{digits}f}"
    return f"{text:>{width}} {unit}".rstrip()


ON_ROBOT = 10.0
"""m along each axis from a robot's frame to a place on it or to what its camera sees: the longest vehicles that drive
themselves on a site have 15 m and their frame in the middle. In millimetres it is a place within 10 mm."""
ON_MAP = 1e4
"""m along each axis from a map's origin: no site on one map, such as an airport or a mine, is larger. In millimetres it
is a place within 10 m."""
IN_TOUCH = {"horizontal": (0.25, "m"), "vertical": (0.25, "m"), "angle": (0.25 * math.pi, "rad")}
"""Largest offsets and angle of charger and target in contact, and their units. From 37° on, the target's ridges lie
beside the pads; the packaged model, fed with noise, says 31° and 0.21 m at most."""
_OTHERS = {
    "m": ("millimetres? Give metres", 1e-3),
    "m/s": ("mm/s? Give m/s", 1e-3),
    "rad": ("degrees? Give radians", math.pi / 180.0),
}
_LEAST = 1.0  # of the other unit, that a person gives


def outside(value: float, low: float, high: float, unit: str) -> str:
    """Return the error of a value outside its inclusive bounds, with a question if it fits in another unit; '' = none.

    NaN is outside every bound.
    """
    if low <= value <= high:
        return ""
    other, factor = _OTHERS.get(unit, ("", math.nan))
    fits = abs(value) >= _LEAST and low <= factor * value <= high
    question = f"; is it in {other}" if fits else ""
    return f"{brief(value)} is outside {low:.10g} to {high:.10g} {unit}".rstrip() + question


def far(place: Iterable[float], most: float = ON_ROBOT) -> str:
    """Return the error of a place (m) that lies beyond `most` along an axis; '' = none."""
    return next((problem for value in place if (problem := outside(round(value, 3), -most, most, "m"))), "")


def untouchable(**pose: float) -> str:
    """Return the error of a pose in touch, by the names of `IN_TOUCH`; '' = none. NaN is unknown, which is none."""
    for name, value in pose.items():
        most, unit = IN_TOUCH[name]
        if not math.isnan(value) and (problem := outside(value, -most, most, unit)):
            return f"{name}: {problem}"
    return ""
