# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tactile generator and of misalignment_node.

The generator's defaults describe a plausible device, not a measured one: the paper's data are not public. They are
stored with every data set and model made with them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field

from deltacharger_core.machine import (
    COLUMNS,
    DOCKING_JITTER,
    MAGNET_FLOOR,
    MAGNET_FORCE,
    MAGNET_WIDTH,
    PAD_DISTANCE,
    PADS,
    ROWS,
)
from deltacharger_core.parameters import Bounded, number, tunable, words

SHAPE = (PADS, ROWS, COLUMNS)
"""Shape of both pads' readings."""
FRAMES_MAX = 240
"""Most tactile frames averaged in one estimate: two seconds."""
_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class PadContactParameters(Bounded):
    """Pads, ridge and elastomer; lengths in m, tilts in rad. Raises ParameterError if a value is out of bounds."""

    pad_distance: float = number(PAD_DISTANCE, 0.02, 0.1, "m", "pad centre from the end effector's centre along x")
    pad_side: float = number(0.024, 0.01, 0.05, "m", "side of the square pad (10 × 10 taxels)")
    sub_samples: int = number(3, 1, 5, "", "contact points per taxel and axis")
    ridge_length: float = number(0.046, 0.01, 0.1, "m", "length of the target's insulated ridge, along its x")
    ridge_height: float = number(0.006, 0.003, 0.02, "m", "height of the same ridge, along its y")
    edge_radius: float = number(0.0012, 0.0001, 0.0015, "m", "rounding of the ridge's edges")
    crown_radius: float = number(0.060, 0.01, 10.0, "m", "radius of the ridge's crown across its height")
    hole: float = number(0.0, 0.0, 0.006, "m", "diameter of a round hole in the middle of each ridge; 0 = none")
    waviness: float = number(2e-5, 0.0, 2e-4, "m", "rms waviness along the ridge, drawn per rig")
    stiffness: float = number(0.9e9, 1e7, 1e11, "Pa/m", "pressure per indentation of the elastomer")
    hardening: float = number(1.5e-3, 1e-4, 1.0, "m", "indentation at which the pressure is twice the linear one")
    spread_depth: float = number(1.2e-3, 1e-4, 5e-3, "m", "depth of the taxels under the skin (Boussinesq)")


@dataclass(frozen=True)
class PadDockingParameters(Bounded):
    """Differences between rigs, between dockings at one commanded pose, and the total force."""

    tilt_per_x: float = number(10.0 * _DEGREE, 0.0, 60.0 * _DEGREE, "rad/m", "tilt about y per horizontal offset")
    tilt_per_y: float = number(7.0 * _DEGREE, 0.0, 60.0 * _DEGREE, "rad/m", "tilt about x per vertical offset")
    tilt_spread: float = number(0.009 * _DEGREE, 0.0, 1.0 * _DEGREE, "rad", "spread of both tilts, per docking")
    tilt_bias: float = number(0.003 * _DEGREE, 0.0, 1.0 * _DEGREE, "rad", "spread of both tilts, per rig")
    position_jitter: float = number(
        DOCKING_JITTER, 0.0, 5e-3, "m", "standard deviation of x and y in contact, per docking"
    )
    angle_jitter: float = number(
        0.19 * _DEGREE, 0.0, 2.0 * _DEGREE, "rad", "standard deviation of the angle, per docking"
    )
    magnet_force: float = number(MAGNET_FORCE, 0.0, 300.0, "N", "all magnets together in contact at zero offset")
    magnet_width: float = number(MAGNET_WIDTH, 1e-3, 1.0, "m", "lateral offset that halves the magnets' pull")
    magnet_floor: float = number(MAGNET_FLOOR, 0.0, 1.0, "", "smallest fraction of the magnets' pull")
    magnet_spread: float = number(0.05, 0.0, 0.3, "", "relative standard deviation of the magnets, per rig")
    push_per_ampere: float = number(38.4, 1.0, 200.0, "N/A", "push of the servos per contact current")
    push_spread: float = number(0.05, 0.0, 0.5, "", "lognormal spread of the push, per docking")
    current_low: float = number(0.40, 0.0, 3.0, "A", "lower end of the contact current band (paper)")
    current_high: float = number(0.50, 0.0, 3.0, "A", "upper end of the contact current band (paper)")


@dataclass(frozen=True)
class SensorParameters(Bounded):
    """The sensor's chain from force on a taxel to reading."""

    hysteresis: float = number(0.04, 0.0, 0.3, "", "relative error of a whole pad, per docking")
    creep: float = number(0.03, 0.0, 0.2, "1/decade", "relative growth per decade of time in contact")
    creep_time: float = number(1.0, 0.01, 100.0, "s", "time constant in the logarithm of the creep")
    gain_spread: float = number(0.15, 0.0, 0.5, "", "relative spread of the taxels' gains, per rig")
    cross_talk: float = number(0.02, 0.0, 0.2, "", "share of its row's and its column's mean that a taxel picks up")
    fixed_offset: float = number(0.12, 0.0, 0.4, "N", "spread of the taxels' offsets, per rig")
    docking_offset: float = number(0.05, 0.0, 0.4, "N", "spread of the taxels' offsets, drawn in each contact")
    noise: float = number(0.08, 0.0, 1.0, "N", "noise floor of one sample")
    noise_gain: float = number(0.02, 0.0, 0.2, "", "noise of one sample relative to its force")
    noise_memory: float = number(0.3, 0.0, 1.0, "", "share of the noise variance that is AR(1)")
    noise_time: float = number(0.25, 0.001, 100.0, "s", "correlation time of that share")
    pedestal: float = number(0.5, 0.0, 1.0, "N", "reading of an unloaded taxel, so that offsets stay visible")
    full_scale: float = number(9.0, 1.0, 20.0, "N", "largest force that the sensor reports (paper)")
    bits: int = number(10, 4, 16, "bit", "resolution over pedestal plus full scale")
    dead_taxels: int = number(1, 0, 20, "", "taxels of a rig that read nothing (NaN)")


@dataclass(frozen=True)
class TactileParameters:
    """All parameters of one family of rigs."""

    contact: PadContactParameters = field(default_factory=PadContactParameters)
    docking: PadDockingParameters = field(default_factory=PadDockingParameters)
    sensor: SensorParameters = field(default_factory=SensorParameters)

    def to_json(self) -> str:
        """Return every value as one JSON object with sorted keys."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def digest(self) -> str:
        """Return 16 hexadecimal digits that change when any value changes."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:16]


@dataclass(frozen=True)
class MisalignmentNodeParameters(Bounded):
    """Files, frames and limits of misalignment_node; only max_age is fixed while it runs."""

    model: str = words("", "Pose model (npz); empty = the packaged one.", tunable=True)
    calibration: str = words("", "Calibration of this rig's pads (YAML); empty = none.", tunable=True)
    classifiers: tuple[str, ...] = words(
        ("",),
        "Source of class probabilities instead of the pose model: the name of a packaged model, or files (npz), at "
        "most one per target; [''] = none.",
        tunable=True,
    )
    frames: int = tunable(12, 1, FRAMES_MAX, "", "Frames averaged if a request states 0.")
    rate: float = tunable(0.0, 0.0, 120.0, "Hz", "Rate of the topic misalignment, {unit}; 0 = off.")
    max_age: float = number(0.1, 0.01, 10.0, "s", "Largest age of the newest frame")
    timeout: float = tunable(1.0, 0.05, 30.0, "s", "Longest wait for frames beyond their duration at 120 Hz")
