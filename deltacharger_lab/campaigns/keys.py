# SPDX-License-Identifier: Apache-2.0
"""Every key that the scene of a campaign may set: those of its own, and all of world, pads and docking."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

from deltacharger_core.parameters import Declaration, choice, declared, flag, like, number
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.disturbances import Nudge, Parked, Taxels
from deltacharger_lab.campaigns.pads import FIRST, PACKAGED, PADS, POSE_MODELS
from deltacharger_lab.campaigns.told import Told
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters
from deltacharger_tactile.second.parameters import SecondParameters


@dataclass(frozen=True)
class _Target:
    """Where the target stands, seen by the camera."""

    x: float = number(0.0, -0.06, 0.06, "m", "where the target stands, from (0, 0, 80 mm) of charger_base")
    y: float = number(0.0, -0.06, 0.06, "m", "the same along y, +y up")
    z: float = number(0.0, -0.04, 0.03, "m", "the same along z, away from the robot")
    roll: float = number(0.0, -0.6, 0.6, "rad", "about z, from +x to +y")


@dataclass(frozen=True)
class _Shift:
    """How the target stands elsewhere at contact than the camera saw it."""

    x: float = number(0.0, -0.03, 0.03, "m", "how far the target has moved at contact, unseen by the camera")
    y: float = number(0.0, -0.03, 0.03, "m", "the same along y")
    z: float = number(0.0, -0.03, 0.03, "m", "the same along z")
    roll: float = number(0.0, -0.6, 0.6, "rad", "the same about z")
    limit: float | None = number(
        None,
        0.001,
        0.06,
        "m",
        "largest offset from goal to target along x and along y; errors of vision beyond are redrawn",
    )
    beyond_zero: float | None = number(
        None, -0.2, 0.2, "rad", "roll of the target beyond that of no clearance at its vertical offset, either sign"
    )


@dataclass(frozen=True)
class _Electrode:
    """What the target's electrodes are like where the pads feel them."""

    hole: float = like(PadContactParameters, "hole")


@dataclass(frozen=True)
class _Camera:
    """Errors of the camera, drawn for each docking."""

    position_stddev: float = number(0.0, 0.0, 0.02, "m", "error of a detection, per axis, drawn for each docking")
    roll_stddev: float = number(0.0, 0.0, 0.2, "rad", "error of its roll")
    lean_stddev: float = number(0.0, 0.0, 0.2, "rad", "error of its yaw and of its pitch; 0 = it tells neither")


@dataclass(frozen=True)
class _HandEye:
    """Errors of where the camera is believed to be."""

    position_stddev: float = number(0.0, 0.0, 0.02, "m", "error of the camera's believed place, per axis")
    rotation_stddev: float = number(0.0, 0.0, 0.1, "rad", "error of its believed orientation, per axis")


@dataclass(frozen=True)
class _Gravity:
    """How the robot stands."""

    tilt: float = number(0.0, 0.0, math.pi, "rad", "of the robot: angle between gravity and −y of charger_base")
    azimuth: float = number(0.0, -math.pi, math.pi, "rad", "direction of that tilt about −y: 0 = toward +z")
    anywhere: bool = flag(False, "whether gravity points anywhere, each direction as likely")
    known: bool = flag(False, "whether docking is told the tilt")


@dataclass(frozen=True)
class EstimatorErrors:
    """What is wrong with every estimate of the misalignment besides what pads and model do."""

    position_stddev: float = number(0.0, 0.0, 0.01, "m", "noise added to each estimate along x and y")
    angle_stddev: float = number(0.0, 0.0, 0.2, "rad", "noise added to each estimate's angle")
    bias_horizontal: float = number(0.0, -0.01, 0.01, "m", "added to each estimate along x")
    bias_vertical: float = number(0.0, -0.01, 0.01, "m", "added to each estimate along y")
    bias_angle: float = number(0.0, -0.2, 0.2, "rad", "added to each estimate's angle")
    stddev_scale: float = number(1.0, 0.1, 10.0, "", "by which each estimate's standard deviations are multiplied")
    tail: float | None = number(
        None,
        2.1,
        1e6,
        "",
        "errors are Student's t of so many degrees, as wide as the standard deviations, not the pads' own",
    )
    paper: bool = flag(False, "whether estimates are the classes of the paper's CNN, taken as sure")
    model: str = choice(PACKAGED, POSE_MODELS, "pose model: packaged, or that for sensors that tell nothing below 1 N")


@dataclass(frozen=True)
class _Campaign:
    """The keys of a campaign's own."""

    target: _Target = field(default_factory=_Target)
    shift: _Shift = field(default_factory=_Shift)
    electrode: _Electrode = field(default_factory=_Electrode)
    camera: _Camera = field(default_factory=_Camera)
    hand_eye: _HandEye = field(default_factory=_HandEye)
    gravity: _Gravity = field(default_factory=_Gravity)
    estimator: EstimatorErrors = field(default_factory=EstimatorErrors)
    told: Told = field(default_factory=Told)
    taxels: Taxels = field(default_factory=Taxels)
    parked: Parked = field(default_factory=Parked)
    nudge: Nudge = field(default_factory=Nudge)
    pads: str = choice(FIRST, PADS, "contact physics of the pads: first, by which pose models were trained, or second")


TAKEN = {
    **{f"world.target.{axis}": f"give target.{axis} (seen) and shift.{axis} (unseen)" for axis in (*"xyz", "roll")},
    **{f"world.gravity_{axis}": "give gravity.tilt and gravity.azimuth" for axis in "xyz"},
    "tactile.contact.hole": "give electrode.hole",
    "world.step": "a campaign steps the world itself",
    "docking.servo_stiffness": "it follows world.servo.stiffness; to tell it wrongly give told.servo_stiffness",
    "docking.torque_constant": "it follows world.servo.torque_constant; to tell it wrongly give told.torque_constant",
    **{f"docking.gravity_{axis}": "give gravity.tilt and gravity.known, or told.gravity_tilt" for axis in "xyz"},
    "docking.approach": "give --approach",
}
"""Keys of the parts that a campaign sets itself, and what to write instead."""
DERIVED = {"gravity.anywhere": ("gravity.tilt", "gravity.azimuth"), "shift.beyond_zero": ("shift.roll",)}
"""Keys that draw others, which then are not given."""
_FACTS = ("second.dimensions.", "second.docking.")  # of the product, the same in both physics
_WORDS = ("pads", "estimator.model")  # the keys that are text


@functools.cache
def known_keys() -> dict[str, Declaration]:
    """Return every key by its dotted name."""
    parts = {
        "": _Campaign,
        "world": WorldParameters,
        "tactile": TactileParameters,
        "second": SecondParameters,
        "docking": DockingParameters,
    }
    keys = {key.name: key for section, part in parts.items() for key in declared(part, section)}
    numbers = {name for name, key in keys.items() if key.kind in (bool, int, float)}
    settable = numbers.union(_WORDS).difference(TAKEN)
    return {name: key for name, key in keys.items() if name in settable and not name.startswith(_FACTS)}
