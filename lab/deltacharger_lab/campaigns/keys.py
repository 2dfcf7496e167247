# SPDX-License-Identifier: Apache-2.0
"""Every key of a campaign's scene: its own, and all of world, pads and docking."""

import functools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from deltacharger_core.parameters import Declaration, ParameterError, choice, declared, flag, number
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_lab.campaigns import disturbances, parts
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_tactile.parameters import LARGEST_HOLE


@dataclass(frozen=True)
class _Target:
    """Pose of the target when the camera looks."""

    x: float = number(
        0.0, -0.06, 0.06, "m", "place of the target when the camera looks, along x from (0, 0, 80 mm) of charger_base"
    )
    y: float = number(0.0, -0.06, 0.06, "m", "place of the target along y; +y is up")
    z: float = number(0.0, -0.04, 0.03, "m", "place of the target along z, away from the robot")
    roll: float = number(0.0, -0.6, 0.6, "rad", "turn of the target about z, from +x to +y")


@dataclass(frozen=True)
class _Shift:
    """Movement of the target between camera and contact."""

    x: float = number(0.0, -0.03, 0.03, "m", "movement of the target between camera and contact, along x")
    y: float = number(0.0, -0.03, 0.03, "m", "movement along y")
    z: float = number(0.0, -0.03, 0.03, "m", "movement along z")
    roll: float = number(0.0, -0.6, 0.6, "rad", "turn of the target between camera and contact, about z")
    limit: float | None = number(
        None,
        0.001,
        0.06,
        "m",
        "largest offset from goal to target along x and along y; larger errors of vision are drawn again",
    )
    beyond_zero: float | None = number(
        None,
        -0.2,
        0.2,
        "rad",
        "roll beyond the one without clearance at the vertical offset, either sign; replaces shift.roll",
    )


@dataclass(frozen=True)
class _Electrode:
    """Properties of the target's electrodes in contact with the pads."""

    hole: float = number(0.0, 0.0, LARGEST_HOLE, "m", "diameter of a round hole in the middle of each ridge; 0 = none")


@dataclass(frozen=True)
class _Camera:
    """Errors of the camera, drawn for each docking."""

    position_stddev: float = number(0.0, 0.0, 0.02, "m", "error of a detection, per axis")
    roll_stddev: float = number(0.0, 0.0, 0.2, "rad", "error of the detected roll")
    lean_stddev: float = number(
        0.0,
        0.0,
        0.2,
        "rad",
        "error of the detected yaw and pitch, to which the mount's is added; 0 = neither is reported",
    )


@dataclass(frozen=True)
class _HandEye:
    """Errors of the camera's assumed pose."""

    position_stddev: float = number(0.0, 0.0, 0.02, "m", "error of the camera's assumed place, per axis")
    rotation_stddev: float = number(
        0.0, 0.0, 0.1, "rad", "error of its assumed orientation, per axis; moves the target about the usual mount"
    )


@dataclass(frozen=True)
class _Gravity:
    """Orientation of the robot."""

    tilt: float = number(0.0, 0.0, math.pi, "rad", "tilt of the robot: angle between gravity and −y of charger_base")
    azimuth: float = number(0.0, -math.pi, math.pi, "rad", "direction of that tilt about −y; 0 = toward +z")
    anywhere: bool = flag(False, "true = gravity in any direction, all equally likely; replaces tilt and azimuth")
    known: bool = flag(False, "true = docking knows the tilt")


@dataclass(frozen=True)
class EstimatorErrors:
    """Errors added to every estimate of the misalignment."""

    position_stddev: float = number(
        0.0, 0.0, 0.01, "m", "noise added to each estimate along x and y, unknown to its standard deviations"
    )
    angle_stddev: float = number(0.0, 0.0, 0.2, "rad", "noise added to each estimate's angle")
    bias_horizontal: float = number(0.0, -0.01, 0.01, "m", "added to each estimate along x")
    bias_vertical: float = number(0.0, -0.01, 0.01, "m", "added to each estimate along y")
    bias_angle: float = number(0.0, -0.2, 0.2, "rad", "added to each estimate's angle")
    stddev_scale: float = number(1.0, 0.1, 10.0, "", "factor on each estimate's standard deviations")
    tail: float | None = number(
        None,
        2.1,
        1e6,
        "",
        "degrees of freedom of Student's t with the estimate's variance, in place of the pads' errors; 1e6 = normal",
    )
    paper: bool = flag(
        False, "true = estimates are classes of the paper's CNN (0–5°, steps of 5 mm) with standard deviations of 0"
    )
    model: str = choice(parts.PACKAGED, parts.POSE_MODELS, "pose model; 1N = for sensors that read nothing below 1 N")


@dataclass(frozen=True)
class _Campaign:
    """A campaign's own keys."""

    target: _Target = field(default_factory=_Target)
    shift: _Shift = field(default_factory=_Shift)
    electrode: _Electrode = field(default_factory=_Electrode)
    camera: _Camera = field(default_factory=_Camera)
    hand_eye: _HandEye = field(default_factory=_HandEye)
    gravity: _Gravity = field(default_factory=_Gravity)
    estimator: EstimatorErrors = field(default_factory=EstimatorErrors)
    assumed: parts.Assumed = field(default_factory=parts.Assumed)
    taxels: disturbances.Taxels = field(default_factory=disturbances.Taxels)
    parked: disturbances.Parked = field(default_factory=disturbances.Parked)
    nudge: disturbances.Nudge = field(default_factory=disturbances.Nudge)
    published: bool = flag(False, "true = dock by the paper's algorithm as printed; give estimator.paper too")
    hostile: bool = flag(False, "true = one or two drawn faults act on each docking, which the world judges")
    targets: str = choice(
        "",
        ("", "kinds", "pairs", "gaps"),
        "charge targets to their end: kinds of ports in turn, packs with any profile, gaps in the current",
    )
    pads: str = choice(parts.FIRST, parts.PADS, "contact physics of the pads; first = as the pose models were trained")


TAKEN = {
    **{
        f"world.target.{axis}": f"give target.{axis} (where the camera sees it) and shift.{axis} (its move after that)"
        for axis in (*"xyz", "roll")
    },
    **{f"world.gravity_{axis}": "give gravity.tilt and gravity.azimuth" for axis in "xyz"},
    "docking.servo_stiffness": "it follows world.servo.stiffness; for a wrong value give assumed.servo_stiffness",
    "docking.torque_constant": "it follows world.servo.torque_constant; for a wrong value give assumed.torque_constant",
    "docking.gravity": "give gravity.tilt and gravity.known, or assumed.gravity_tilt",
}
"""Keys of world and docking that a campaign sets itself, with the keys to give instead."""
DERIVED = {"gravity.anywhere": ("gravity.tilt", "gravity.azimuth"), "shift.beyond_zero": ("shift.roll",)}
"""Keys that draw others, which must not be given then."""
FACTS = ("second.dimensions.", "second.docking.")
"""Prefixes of keys that are fixed properties of the product, equal in both physics."""
PARTS = {
    "": _Campaign,
    "world": WorldParameters,
    "second": SecondParameters,
    "docking": DockingParameters,
    "profile": TargetProfile,
}
"""Parameter classes by the section of a campaign's scene; '' = the campaign's own keys."""
_WORDS = ("pads", "targets", "estimator.model")  # keys with text values


@functools.cache
def known_keys() -> dict[str, Declaration]:
    """Return every key by its dotted name."""
    keys = {key.name: key for section, part in PARTS.items() for key in declared(part, section)}
    numbers = {name for name, key in keys.items() if key.kind in (bool, int, float)}
    settable = numbers.union(_WORDS).difference(TAKEN)
    return {name: key for name, key in keys.items() if name in settable and not name.startswith(FACTS)}


_SIGMAS = 3.0  # of a normal distribution, taken as its ends
_TILT = {key.name: key for key in declared(TargetParameters)}["tilt_y"]

_DEAD_BAND = "second.sheet.dead_band"  # 0 = none
_LITTLE = 1e-6  # N of a dead band drawn from 0 on
_BOUNDED_ABOVE = (
    ("foundation.confinement", "foundation.modulus"),
    ("bars.seat",),
    ("bars.rate",),
    ("sheet.dead_band_spread",),
    ("sheet.dead_band", "sheet.dead_band_spread"),
    ("sheet.edge_loss", "sheet.neighbour"),
)
"""Keys that each rule of SecondParameters bounds from above. It bounds its other keys from below, so one corner of
the ranges breaks it first."""

_Ends = Mapping[str, tuple[parts.Value, parts.Value]]  # of each key
_Problem = tuple[str, parts.Value, str]  # key, value and problem


def refuse_contradictions(spreads: Mapping[str, parts.Spread], dockings: Sequence[Mapping[str, parts.Value]]) -> None:
    """Refuse the first key without effect or in contradiction with another.

    Args:
        spreads: of the drawn keys.
        dockings: listed values, which take precedence.

    Raises:
        ParameterError: names the key.
    """
    drawn = {name: _ends_of(spread) for name, spread in spreads.items()}
    for values in dockings or ({},):
        ends = {**drawn, **{name: (value, value) for name, value in values.items()}}
        for problem in (*_assumptions(ends), *_disturbed(ends), *_pads(ends)):
            raise ParameterError(*problem)


def _ends_of(spread: parts.Spread) -> tuple[parts.Value, parts.Value]:
    low, high = spread.ends
    if spread.shape == "normal":
        mean, reach = float(spread.numbers[0]), _SIGMAS * float(spread.numbers[1])
        low, high = max(mean - reach, spread.key.low), min(mean + reach, spread.key.high)
    if spread.key.name == _DEAD_BAND and low == 0.0 != high:
        low = min(float(each) for each in spread.numbers if each) if spread.shape == "choose" else _LITTLE
    return low, high


def _is_nothing(ends: _Ends, *names: str) -> bool:
    return all(ends.get(name, (0.0, 0.0)) == (0.0, 0.0) for name in names)


def _numbers(ends: _Ends, name: str, default: float) -> tuple[float, float]:
    low, high = ends.get(name, (default, default))
    return float(low), float(high)


def _assumptions(ends: _Ends) -> Iterator[_Problem]:
    if "assumed.gravity_tilt" in ends and False in ends.get("gravity.known", ()):
        yield "gravity.known", False, "contradicts assumed.gravity_tilt, which sets known gravity; remove one of them"
    if "assumed.gravity_azimuth" in ends and _is_nothing(ends, "assumed.gravity_tilt"):
        value = ends["assumed.gravity_azimuth"][0]
        yield "assumed.gravity_azimuth", value, "has no effect if assumed.gravity_tilt is 0; remove one"


def _disturbed(ends: _Ends) -> Iterator[_Problem]:
    if "nudge.after" in ends and _is_nothing(ends, "nudge.x", "nudge.y", "nudge.roll"):
        yield "nudge.after", ends["nudge.after"][0], "has no effect without nudge.x, nudge.y or nudge.roll"
    heading, tilt = _numbers(ends, "parked.heading", 0.0), _numbers(ends, "world.target.tilt_y", 0.0)
    least, most = tilt[0] - heading[1], tilt[1] - heading[0]
    if not _TILT.low <= least <= most <= _TILT.high:
        yield (
            "parked.heading",
            max(heading, key=abs),
            f"makes faces tilted by {least:g} to {most:g} rad with world.target.tilt_y; "
            f"allowed are {_TILT.low:g} to {_TILT.high:g} rad",
        )


def _pads(ends: _Ends) -> Iterator[_Problem]:
    if parts.SECOND not in ends.get("pads", ()):
        for name in ends:
            if name.startswith("second."):
                yield name, ends[name][0], "has no effect if pads is first; add pads: second"
    second = {name: pair for name, pair in ends.items() if name.startswith("second.")}
    for above in _BOUNDED_ABOVE if second else ():
        parts.second_family({name: pair[name.removeprefix("second.") in above] for name, pair in second.items()})
    if ends.get("pads") == (parts.SECOND, parts.SECOND):
        for name in ends:
            if name.startswith("electrode."):
                yield name, ends[name][0], "has no effect if pads is second, which has its own family; remove one"
    if "estimator.model" in ends and ends.get("estimator.paper") == (True, True):
        yield "estimator.model", ends["estimator.model"][0], "has no effect if estimator.paper is true; remove one"
