# SPDX-License-Identifier: Apache-2.0
"""Parameters of the tactile generator and of misalignment_node.

The generator's defaults describe a plausible device, not a measured one: the paper's data are not public. They are
stored with every data set and model made with them.
"""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field

from deltacharger_core import machine, parameters
from deltacharger_core.parameters import number, words

SHAPE = (machine.PADS, machine.ROWS, machine.COLUMNS)
"""Shape of both pads' readings."""
FRAMES = 12
"""Tactile frames averaged if a request states 0: a tenth of a second."""
FRAMES_MAX = 240
"""Most tactile frames averaged in one estimate: two seconds."""
ANGLE_CLASSES = 6
POSITION_CLASSES = (-0.010, -0.005, 0.0, 0.005, 0.010)
POSITION_LIMIT = 0.012
"""Largest |x| and |y| of the continuous protocol, m."""
ANGLE_LIMIT = math.radians(20.0)
"""Largest |angle| of the continuous protocol, rad."""
_DEGREE = math.pi / 180.0
LARGEST_HOLE = 0.006  # m, as high as the ridge


@dataclass(frozen=True)
class PadContactParameters:
    """Pads, ridge and elastomer."""

    pad_distance: float = machine.PAD_DISTANCE  # m, pad centre from the end effector's centre along x
    pad_side: float = 0.024  # m, side of the square pad (10 × 10 taxels)
    sub_samples: int = 3  # contact points per taxel and axis
    ridge_length: float = 0.046  # m, length of the target's insulated ridge, along its x
    ridge_height: float = 0.006  # m, height of the same ridge, along its y
    edge_radius: float = 0.0012  # m, rounding of the ridge's edges
    crown_radius: float = 0.060  # m, radius of the ridge's crown across its height
    hole: float = 0.0  # m, diameter of a round hole in the middle of each ridge; 0 = none
    waviness: float = 2e-5  # m, rms waviness along the ridge, drawn per rig
    stiffness: float = 0.9e9  # Pa/m, pressure per indentation of the elastomer
    hardening: float = 1.5e-3  # m, indentation at which the pressure is twice the linear one
    spread_depth: float = 1.2e-3  # m, depth of the taxels under the skin (Boussinesq)


@dataclass(frozen=True)
class PadDockingParameters:
    """Differences between rigs, between dockings at one commanded pose, and the total force."""

    tilt_per_x: float = 10.0 * _DEGREE  # rad/m, tilt about y per horizontal offset
    tilt_per_y: float = 7.0 * _DEGREE  # rad/m, tilt about x per vertical offset
    tilt_spread: float = 0.009 * _DEGREE  # rad, spread of both tilts, per docking
    tilt_bias: float = 0.003 * _DEGREE  # rad, spread of both tilts, per rig
    position_jitter: float = machine.DOCKING_JITTER  # m, standard deviation of x and y in contact, per docking
    angle_jitter: float = 0.19 * _DEGREE  # rad, standard deviation of the angle, per docking
    magnet_force: float = machine.MAGNET_FORCE  # N, all magnets together in contact at zero offset
    magnet_width: float = machine.MAGNET_WIDTH  # m, lateral offset that halves the magnets' pull
    magnet_floor: float = machine.MAGNET_FLOOR  # smallest fraction of the magnets' pull
    magnet_spread: float = 0.05  # relative standard deviation of the magnets, per rig
    push_per_ampere: float = 38.4  # N/A, push of the servos per contact current
    push_spread: float = 0.05  # lognormal spread of the push, per docking
    current_low: float = 0.40  # A, lower end of the contact current band (paper)
    current_high: float = 0.50  # A, upper end of the contact current band (paper)


@dataclass(frozen=True)
class SensorParameters:
    """The sensor's chain from force on a taxel to reading."""

    hysteresis: float = 0.04  # relative error of a whole pad, per docking
    creep: float = 0.03  # 1/decade, relative growth per decade of time in contact
    creep_time: float = 1.0  # s, time constant in the logarithm of the creep
    gain_spread: float = 0.15  # relative spread of the taxels' gains, per rig
    cross_talk: float = 0.02  # share of its row's and its column's mean that a taxel picks up
    fixed_offset: float = 0.12  # N, spread of the taxels' offsets, per rig
    docking_offset: float = 0.05  # N, spread of the taxels' offsets, drawn in each contact
    noise: float = 0.08  # N, noise floor of one sample
    noise_gain: float = 0.02  # noise of one sample relative to its force
    noise_memory: float = 0.3  # share of the noise variance that is AR(1)
    noise_time: float = 0.25  # s, correlation time of that share
    pedestal: float = 0.5  # N, reading of an unloaded taxel, so that offsets stay visible
    full_scale: float = 9.0  # N, largest force that the sensor reports (paper)
    bits: int = 10  # bit, resolution over pedestal plus full scale
    dead_taxels: int = 1  # taxels of a rig that read nothing (NaN)


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
class MisalignmentNodeParameters(parameters.Bounded):
    """Files and limits of misalignment_node."""

    model: str = words("", "Pose model (npz); empty = the packaged one.")
    calibration: str = words("", "Calibration of this rig's pads (YAML); empty = none.")
    classifiers: str = words("", "Packaged model of class probabilities instead of the pose model; empty = none.")
    rate: float = number(0.0, 0.0, 120.0, "Hz", "Rate of the topic misalignment, {unit}; 0 = off.")
    max_age: float = number(0.1, 0.01, 10.0, "s", "Largest age of the newest frame")
    timeout: float = number(1.0, 0.05, 30.0, "s", "Longest wait for frames beyond their duration at 120 Hz")
