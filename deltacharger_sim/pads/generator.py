# SPDX-License-Identifier: Apache-2.0
"""Data sets from the contact and sensor models: the paper's two protocols and a continuous, signed one.

A row is one docking (attempt): commanded pose, pose in contact (commanded plus jitter), and both pads averaged over
`frames` frames, tared, clipped at 0 as the board does, and thresholded.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import CONTACT_FORCE, FRAME_RATE
from deltacharger_sim.pads.sensor import Dockings, Rig, Sensor
from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.dataset import (
    ANGLE_CLASSES,
    ANGLE_LIMIT,
    POSITION_CLASSES,
    POSITION_LIMIT,
    SUBSET_ANGLE,
    SUBSET_CONTINUOUS,
    SUBSET_POSITION,
    VERSION,
    Dataset,
)
from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.parameters import SHAPE, PadDockingParameters, TactileParameters

SESSIONS = 5
_TARE_FRAMES = 60
_CHUNK = 512


def generate_paper(
    parameters: TactileParameters | None = None,
    rigs: Sequence[int] = (0,),
    seed: int = 0,
    frames: int = 1,
    threshold: float = CONTACT_FORCE,
    rows: int = 1,
) -> Dataset:
    """Generate the paper's protocol on each rig: 600 dockings by angle and 500 by position.

    Angle set: 0, 1, … 5° × 100 dockings. Start positions vary over ±20 mm in 4 mm steps; a tenth of that is assumed to
    remain. (The docked protocol records what they really leave.)
    Position set: 5 × 5 offsets × 20 dockings at zero angle.

    Args:
        parameters: family of rigs; None = the defaults.
        rigs: seeds of the devices.
        seed: seed of the dockings.
        frames: frames averaged per row; the paper has 1.
        threshold: lower readings are stored as 0, N.
        rows: consecutive rows per docking; the paper has 1.
    """
    random = np.random.default_rng([0x9A9E, seed])
    grid = np.array([(x, y) for x in POSITION_CLASSES for y in POSITION_CLASSES])
    poses, subset = [], np.repeat([SUBSET_ANGLE, SUBSET_POSITION], [100 * ANGLE_CLASSES, 20 * len(grid)])
    for _ in rigs:
        classes = np.repeat(np.arange(ANGLE_CLASSES), 100)
        start = 0.1 * 0.004 * random.integers(-5, 6, (len(classes), 2))
        by_angle = np.column_stack([start, np.radians(classes)])
        by_position = np.column_stack([np.repeat(grid, 20, axis=0), np.zeros(20 * len(grid))])
        poses.append(np.concatenate([by_angle, by_position]))
    return _generate("paper", parameters, rigs, poses, subset, seed, frames, threshold, rows)


def generate_continuous(
    parameters: TactileParameters | None = None,
    rigs: Sequence[int] = (0, 1, 2, 3, 4),
    count: int = 400,
    seed: int = 0,
    frames: int = 1,
    threshold: float = CONTACT_FORCE,
    position_limit: float = POSITION_LIMIT,
    angle_limit: float = ANGLE_LIMIT,
    rows: int = 1,
) -> Dataset:
    """Generate signed poses, uniform over ±position_limit and ±angle_limit.

    Args:
        parameters: family of rigs; None = the defaults.
        rigs: seeds of the devices.
        count: dockings per rig.
        seed: seed of the dockings.
        frames: frames averaged per row.
        threshold: lower readings are stored as 0, N.
        position_limit: largest |x| and |y|, m.
        angle_limit: largest |angle|, rad.
        rows: rows per docking.
    """
    random = np.random.default_rng([0xC047, seed])
    limit = np.array([position_limit, position_limit, angle_limit])
    poses = [random.uniform(-limit, limit, (count, 3)) for _ in rigs]
    subset = np.full(count, SUBSET_CONTINUOUS)
    return _generate("continuous", parameters, rigs, poses, subset, seed, frames, threshold, rows)


def contact_force(parameters: PadDockingParameters, offset: Array, current: Array, magnets: float = 1.0) -> Array:
    """Total contact force (N,), N: magnets, weaker with lateral offset (N, 2) m, plus the push of the servos."""
    squared = np.sum(offset * offset, axis=1) / parameters.magnet_width**2
    pull = parameters.magnet_force * magnets * np.maximum(parameters.magnet_floor, 1.0 / (1.0 + squared))
    return np.asarray(pull + parameters.push_per_ampere * current)


def _generate(
    protocol: str,
    parameters: TactileParameters | None,
    rigs: Sequence[int],
    poses: Sequence[Array],
    subset: NDArray[np.int64],
    seed: int,
    frames: int,
    threshold: float,
    rows: int = 1,
) -> Dataset:
    if not rigs or frames < 1 or rows < 1:
        raise DatasetError(protocol, f"{len(rigs)} rigs, {frames} frames, {rows} rows; each must be at least 1")
    chosen = parameters or TactileParameters()
    parts = []
    for index, (rig_seed, pose) in enumerate(zip(rigs, poses, strict=True)):
        rig = Rig.draw(chosen, rig_seed)
        random = np.random.default_rng([0xD0C, seed, rig_seed])
        part = measure(chosen, rig, pose, random, frames, threshold, rows=rows)
        part["attempt"] = part["attempt"] + len(pose) * index
        part["session"] = part["session"] + SESSIONS * index
        part["rig"] = np.full(len(pose) * rows, rig_seed)
        part["subset"] = np.repeat(subset, rows)
        parts.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    meta = {
        "version": VERSION,
        "protocol": protocol,
        "seed": seed,
        "rigs": list(rigs),
        "frames": frames,
        "rows": rows,
        "threshold": threshold,
        "parameters": json.loads(chosen.to_json()),
        "digest": chosen.digest(),
    }
    return Dataset(meta=meta, **joined)


def measure(
    parameters: TactileParameters,
    rig: Rig,
    pose: Array,
    random: np.random.Generator,
    frames: int,
    threshold: float,
    current: Array | None = None,
    rows: int = 1,
    lean: Array | None = None,
) -> dict[str, Any]:
    """Dock once at each commanded pose (N, 3) and record `rows` rows each; returns a Dataset's columns without subset.

    `lean` (N, 2), rad: tilt about x and y of the resting platform, relative to the target; None = level.
    """
    count = len(pose)
    dockings = Dockings.draw(parameters, random, count)
    docking = parameters.docking
    if current is None:
        current = random.uniform(docking.current_low, docking.current_high, count)
    actual = pose + dockings.jitter
    push = current * np.exp(docking.push_spread * random.standard_normal(count))
    force = contact_force(docking, actual[:, :2], push, rig.magnets)
    dwell = random.uniform(0.3, 3.0, count)
    tares = np.stack([_tare(parameters, rig, random) for _ in range(SESSIONS)])
    session = random.integers(0, SESSIONS, count)
    model = ContactModel(parameters.contact)
    readings = np.empty((count, rows, *SHAPE))
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        chosen = Dockings(*(getattr(dockings, item.name)[part] for item in dataclasses.fields(Dockings)))
        tilt = chosen.tilts(parameters, rig, actual[part])
        if lean is not None:
            tilt = tilt + lean[part]
        taxels = model.solve(actual[part], force[part], tilt, rig.waviness).taxels
        sensor = Sensor(parameters.sensor, rig, random, len(taxels))
        for row in range(rows):
            total = np.zeros(taxels.shape)
            for frame in range(row * frames, (row + 1) * frames):
                raw = sensor.read(taxels, chosen, dwell[part] + frame / FRAME_RATE, 1.0 / FRAME_RATE)
                total += np.maximum(raw - tares[session[part]], 0.0)
            readings[part, row] = total / frames
    raw_rows = readings.reshape(-1, *SHAPE)
    dead = np.isnan(raw_rows)
    cut = np.where(dead | (raw_rows < threshold), 0.0, raw_rows).astype(np.float32)
    by_docking: dict[str, NDArray[Any]] = {
        "tare": np.nan_to_num(tares[session]).astype(np.float32),
        "angle": pose[:, 2],
        "vertical": pose[:, 1],
        "horizontal": pose[:, 0],
        "contact_pose": actual,
        "attempt": np.arange(count),
        "session": session,
        "current": current,
        "force": force,
    }
    repeated = {name: np.repeat(column, rows, axis=0) for name, column in by_docking.items()}
    return {"left": cut[:, 0], "right": cut[:, 1], "dead": dead, **repeated}


def _tare(parameters: TactileParameters, rig: Rig, random: np.random.Generator) -> Array:
    sensor = Sensor(parameters.sensor, rig, random)
    frames = [sensor.read(None, None, 0.0, 1.0 / FRAME_RATE)[0] for _ in range(_TARE_FRAMES)]
    return np.asarray(np.mean(frames, axis=0))
