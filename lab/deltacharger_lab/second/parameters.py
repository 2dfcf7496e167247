# SPDX-License-Identifier: Apache-2.0
"""Parameters of the second contact physics, each with its source; "assumed" if there is none.

Dimensions of pads, ridges and bars, magnets, the arm's push and its landing are properties of the product, defined
elsewhere. No number here was chosen by an estimator's results.
"""

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass, field

from deltacharger_core.parameters import Bounded, ParameterError, number
from deltacharger_tactile.parameters import PadContactParameters, PadDockingParameters

_DEGREE = math.pi / 180.0


@dataclass(frozen=True)
class FoundationParameters(Bounded):
    """The pad as a distributed foundation: an elastic skin over a shear layer, and the ridge's form errors."""

    sub_samples: int = number(6, 1, 20, "", "points per taxel along y; half as many along x")
    modulus: float = number(0.8e6, 1e5, 1e8, "Pa", "Young's modulus of the skin (silicone of Shore A 20–30, handbook)")
    thickness: float = number(2.0e-3, 2e-4, 1e-2, "m", "thickness of the skin (assumed)")
    confinement: float = number(
        2.0, 1.0, 10.0, "", "stiffening of a bonded strip, 1 + 2 S² (Gent and Lindley; S = 0.7 of a 6 mm ridge)"
    )
    base_stiffness: float = number(2.0e9, 1e8, 1e12, "Pa/m", "pressure per deflection of the layer below (assumed)")
    shear_length: float = number(
        1.0e-3, 1e-4, 5e-3, "m", "√(G/k) of that layer: distance over which its shear spreads load (Pasternak; assumed)"
    )
    bow: float = number(2e-5, 0.0, 2e-4, "m", "spread of a ridge's sagitta, per rig (moulded part of 46 mm; assumed)")
    skew: float = number(2e-5, 0.0, 2e-4, "m", "spread of the height between a ridge's ends, per rig (assumed)")

    @property
    def skin_stiffness(self) -> float:
        """Pressure per indentation of the skin at small indentation, Pa/m."""
        return self.confinement * self.modulus / self.thickness


@dataclass(frozen=True)
class BarParameters(Bounded):
    """The electrode bars as spring strips beside the pads; all numbers are for one full bar."""

    rate: float = number(
        1e4, 0.0, 1e6, "N/m", "stiffness of the springs behind a bar (contact springs of 2–20 N/mm; assumed)"
    )
    preload: float = number(2.0, 0.0, 20.0, "N", "force of the springs that hold a bar at its stop (assumed)")
    seat: float = number(2e-5, 1e-6, 1e-3, "m", "approach over which a bar takes its preload (assumed: roughness)")
    travel: float = number(1.5e-3, 1e-4, 1e-2, "m", "travel after which a bar is solid (assumed)")
    stop_stiffness: float = number(1e6, 1e4, 1e9, "N/m", "stiffness of a solid bar (assumed)")
    proud: float = number(-2e-4, -1e-3, 1e-3, "m", "distance of bars ahead of ridges; negative = behind (assumed)")


@dataclass(frozen=True)
class PlatformRestParameters(Bounded):
    """Resistance of the platform to tilting, and point of action of the force."""

    compliance: float = number(0.02, 1e-4, 0.1, "rad/(N·m)", "tilt per moment (0.01–0.03; assumed)")
    line_share: float = number(
        0.5, 0.0, 4.0, "", "share of the offset at which the force acts (assumed: middle of what overlaps)"
    )
    line_spread: float = number(0.1, 0.0, 0.5, "", "spread of that share, per rig (assumed)")
    lean_bias: float = number(0.015 * _DEGREE, 0.0, 2.0 * _DEGREE, "rad", "spread of both leans, per rig (assumed)")
    lean_spread: float = number(0.04 * _DEGREE, 0.0, 2.0 * _DEGREE, "rad", "spread of both, per docking (assumed)")


@dataclass(frozen=True)
class SheetParameters(Bounded):
    """From pressure to readings. "Data sheet": class figures of thin resistive sensors (FlexiForce A201)."""

    hysteresis: float = number(0.045, 0.0, 0.2, "", "widest loop over full scale (data sheet: < 4.5 %)")
    sheet_spread: float = number(0.3, 0.0, 0.9, "", "relative spread of hysteresis and creep, per sheet (assumed)")
    creep: float = number(0.05, 0.0, 0.2, "1/decade", "growth under a constant force (data sheet: < 5 % per decade)")
    residual: float = number(0.3, 0.0, 1.0, "", "share of the creep that shifts the zero until it recovers (assumed)")
    linearity: float = number(0.015, 0.0, 0.1, "", "spread of the bend over full scale, per sheet (±3 % as two σ)")
    repeatability: float = number(0.0125, 0.0, 0.1, "", "spread of a pad's gain, per contact (±2.5 % as two σ)")
    gain_spread: float = number(0.12, 0.0, 0.5, "", "relative spread of the taxels' gains, per rig (assumed)")
    edge_loss: float = number(0.15, 0.0, 0.8, "", "sensitivity that the outer ring of taxels lacks (assumed)")
    neighbour: float = number(0.04, 0.0, 0.2, "", "share that each of four neighbours picks up (cover sheet; assumed)")
    matrix: float = number(
        0.015, 0.0, 0.1, "", "share of its row's and its column's mean that a taxel picks up (assumed)"
    )
    dead_band: float = number(1.0, 0.0, 5.0, "N", "force below which a taxel reads 0 (paper: 1–9 N)")
    dead_band_spread: float = number(0.1, 0.0, 1.0, "N", "spread of the dead band, per taxel; cut at two σ (assumed)")
    fixed_offset: float = number(0.1, 0.0, 0.4, "N", "spread of the taxels' offsets, per rig (assumed)")
    gain_drift: float = number(
        0.03, 0.0, 0.3, "", "spread of a pad's gain when warm (0.36 %/K of that class; 8 K assumed)"
    )
    offset_drift: float = number(0.06, 0.0, 1.0, "N", "spread of a taxel's offset after warming up (assumed)")
    drift_time: float = number(600.0, 1.0, 1e5, "s", "time constant of warming up (assumed)")
    noise: float = number(0.02, 0.0, 0.5, "N", "noise of one sample of an unloaded taxel (assumed: two codes)")
    noise_gain: float = number(0.015, 0.0, 0.2, "", "noise of one sample relative to its force (assumed)")
    pedestal: float = number(0.5, 0.0, 2.0, "N", "reading of an unloaded taxel; the board's")
    full_scale: float = number(9.0, 1.0, 50.0, "N", "largest force that is reported (paper)")
    bits: int = number(10, 4, 16, "bit", "resolution over pedestal plus full scale; the board's")
    dead_taxels: int = number(1, 0, 20, "", "taxels of a rig that read nothing (NaN); as in the first physics")


@dataclass(frozen=True)
class SecondParameters(Bounded):
    """All parameters of one family of rigs of the second physics.

    Attributes:
        dimensions: only those of pads and ridges are used.
        docking: only jitter, magnets, push and current are used.
        foundation: the pads.
        bars: the bars.
        platform: its support.
        sheet: the sensor.
    """

    dimensions: PadContactParameters = field(default_factory=PadContactParameters)
    docking: PadDockingParameters = field(default_factory=PadDockingParameters)
    foundation: FoundationParameters = field(default_factory=FoundationParameters)
    bars: BarParameters = field(default_factory=BarParameters)
    platform: PlatformRestParameters = field(default_factory=PlatformRestParameters)
    sheet: SheetParameters = field(default_factory=SheetParameters)

    def __post_init__(self) -> None:
        """Refuse contradictory values; the error names the key to change."""
        foundation, bars, sheet = self.foundation, self.bars, self.sheet
        if foundation.base_stiffness < 0.5 * foundation.skin_stiffness:
            limit = f"half of the skin's {foundation.skin_stiffness:.3g} Pa/m: it would yield in place of the skin"
            _refuse("foundation.base_stiffness", foundation.base_stiffness, f"is below {limit}; increase it")
        if bars.seat >= bars.travel:
            _refuse("bars.seat", bars.seat, f"is not below bars.travel, {bars.travel:g} m, after which a bar is solid")
        if bars.stop_stiffness < bars.rate:
            _refuse("bars.stop_stiffness", bars.stop_stiffness, f"is softer than bars.rate, {bars.rate:g} N/m")
        if sheet.dead_band and sheet.dead_band <= 2.0 * sheet.dead_band_spread:
            limit = f"half of sheet.dead_band, {sheet.dead_band:g} N"
            _refuse("sheet.dead_band_spread", sheet.dead_band_spread, f"is not below {limit}; some taxels lack one")
        if sheet.dead_band + 2.0 * sheet.dead_band_spread >= sheet.full_scale:
            _refuse("sheet.dead_band", sheet.dead_band, f"leaves nothing of the full scale, {sheet.full_scale:g} N")
        if sheet.edge_loss + 4.0 * sheet.neighbour >= 1.0:
            _refuse("sheet.neighbour", sheet.neighbour, "times four, with sheet.edge_loss, leaves a taxel nothing")

    def to_json(self) -> str:
        """Return every value as one JSON object with sorted keys."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def digest(self) -> str:
        """Return 16 hexadecimal digits that change when any value changes."""
        return hashlib.sha256(self.to_json().encode()).hexdigest()[:16]


def _refuse(key: str, value: float, problem: str) -> None:
    raise ParameterError(key, value, f"{value:g} {problem}")
