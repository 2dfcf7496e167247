# SPDX-License-Identifier: Apache-2.0
"""Changes after training: differences of a simulated rig, its target or its sensor from the training."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_sim.pads.generator import measure
from deltacharger_sim.pads.sensor import Rig
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.parameters import TactileParameters

_OTHER = 100  # added to a rig's seed for another rig
_TILT = math.radians(0.06)


@dataclass(frozen=True)
class Shift:
    """One change.

    Attributes:
        name: in tables.
        parameters: of the changed rig.
        other: added to the rig's seed.
        rig: change of the rig.
        frames: change of frames (N, 2, 10, 10) N, NaN where dead.
    """

    name: str
    parameters: TactileParameters = dataclasses.field(default_factory=TactileParameters)
    other: int = 0
    rig: Callable[[Rig], Rig] = lambda rig: rig
    frames: Callable[[Array], Array] = lambda frames: frames


def changed(part: str, **values: Any) -> TactileParameters:
    """Return the default parameters with others in one part of them."""
    base = TactileParameters()
    return dataclasses.replace(base, **{part: dataclasses.replace(getattr(base, part), **values)})


def _weaker(share: float) -> TactileParameters:
    usual = TactileParameters().docking
    return changed("docking", magnet_force=share * usual.magnet_force, push_per_ampere=share * usual.push_per_ampere)


def _left_weaker(rig: Rig) -> Rig:
    return dataclasses.replace(rig, gain=rig.gain * np.array([0.8, 1.0])[:, None, None])


def _tilted(rig: Rig) -> Rig:
    return dataclasses.replace(rig, tilt=rig.tilt + np.array([0.0, _TILT]))


def _left_offset(frames: Array) -> Array:
    return np.asarray(np.clip(frames + np.array([0.3, 0.0])[:, None, None], 0.0, 9.0))


def _rows_silent(frames: Array) -> Array:
    silent = frames.copy()
    silent[:, 0, 4:6] = 0.0
    return silent


NONE = Shift("none")
SHIFTS = (
    NONE,
    Shift("3 dead taxels", changed("sensor", dead_taxels=3)),
    Shift("6 dead taxels", changed("sensor", dead_taxels=6)),
    Shift("left pad × 0.8", rig=_left_weaker),
    Shift("gain spread 25 %", changed("sensor", gain_spread=0.25)),
    Shift("docking offsets × 3", changed("sensor", docking_offset=0.15)),
    Shift("left pad + 0.3 N", frames=_left_offset),
    Shift("force − 20 %", _weaker(0.8)),
    Shift("constant tilt 0.06° about y", rig=_tilted),
    Shift("ridge 8 mm high", changed("contact", ridge_height=0.008)),
    Shift("crown radius 30 mm", changed("contact", crown_radius=0.03)),
    Shift("another sensor and rig", other=_OTHER),
    Shift("two rows of a pad read 0", frames=_rows_silent),
)
"""Shifts of the table; changes of a rig keep everything else that its seed decides."""


def dock_again(known: Dataset, shift: Shift, rig: int, seed: int, rows: Mask) -> Dataset:
    """Dock a (changed) rig at the commanded poses of a data set of the same rig.

    Args:
        known: of the rig, one row of each docking.
        shift: the change.
        rig: seed of the device.
        seed: of the dockings.
        rows: the data set's dockings to repeat.
    """
    pose = np.column_stack([known.horizontal, known.vertical, known.angle])[rows]
    changed = shift.rig(Rig.draw(shift.parameters, rig + shift.other))
    random = np.random.default_rng([0x5417, seed, rig])
    found = measure(shift.parameters, changed, pose, random, 1, 0.0)
    frames = np.stack([found["left"], found["right"]], axis=1).astype(float)
    frames = np.where(found["dead"], 0.0, shift.frames(frames))
    columns = {**found, "left": frames[:, 0].astype(np.float32), "right": frames[:, 1].astype(np.float32)}
    return Dataset(meta=known.meta, rig=np.full(len(pose), rig), subset=known.subset[rows], **columns)
