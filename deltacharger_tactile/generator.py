"""Data sets from the contact and sensor models: the paper's two protocols and a continuous, signed one.

A row is one docking (attempt): commanded pose, pose in contact (commanded plus jitter), and both pads averaged over
`frames` frames, tared, clipped at 0 as the board does, and thresholded.
"""

from __future__ import annotations

import dataclasses
import json
import math
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_tactile.contact import ContactModel
from deltacharger_tactile.errors import DatasetError
from deltacharger_tactile.parameters import (
    CONTACT_THRESHOLD,
    FRAME_RATE,
    DockingParameters,
    TactileParameters,
)
from deltacharger_tactile.sensor import SHAPE, Dockings, Rig, Sensor

Array = NDArray[np.float64]

SUBSET_CONTINUOUS, SUBSET_ANGLE, SUBSET_POSITION = -1, 0, 1
POSITION_LIMIT = 0.012
"""Largest |x| and |y| of the continuous protocol, m."""
ANGLE_LIMIT = math.radians(20.0)
"""Largest |angle| of the continuous protocol, rad."""
ANGLE_CLASSES = 6
POSITION_CLASSES = (-0.010, -0.005, 0.0, 0.005, 0.010)
SESSIONS = 5
_TARE_FRAMES = 60
_CHUNK = 512


@dataclass(frozen=True)
class Dataset:
    """N dockings; the arrays of the npz file, row-aligned.

    Attributes:
        left: (N, 10, 10) float32 N, tared and thresholded; a dead taxel is 0.
        right: the same for the pad at −x.
        tare: (N, 2, 10, 10) float32 N, what was subtracted.
        dead: (N, 2, 10, 10) taxels without a reading.
        angle: (N,) rad, commanded, signed.
        vertical: (N,) m, commanded.
        horizontal: (N,) m, commanded.
        contact_pose: (N, 3) m, m, rad: (horizontal, vertical, angle) in contact, jitter included.
        attempt: (N,) number of the docking, unique in the file.
        session: (N,) number of the session, unique in the file; one tare each.
        rig: (N,) seed of the device.
        subset: (N,) 0 angle set, 1 position set, −1 continuous.
        current: (N,) A, contact current.
        force: (N,) N, total contact force.
        meta: how the data came about: protocol, seed, frames, threshold, parameters and their digest.
    """

    left: NDArray[np.float32]
    right: NDArray[np.float32]
    tare: NDArray[np.float32]
    dead: NDArray[np.bool_]
    angle: Array
    vertical: Array
    horizontal: Array
    contact_pose: Array
    attempt: NDArray[np.int64]
    session: NDArray[np.int64]
    rig: NDArray[np.int64]
    subset: NDArray[np.int64]
    current: Array
    force: Array
    meta: dict[str, Any]

    def __len__(self) -> int:
        return len(self.left)

    def robot_frames(self) -> tuple[Array, Array]:
        """Return left, right (N, 10, 10) as the robot's messages carry them: NaN where dead."""
        left, right = self.left.astype(float), self.right.astype(float)
        left[self.dead[:, 0]] = np.nan
        right[self.dead[:, 1]] = np.nan
        return left, right

    def save(self, path: str | Path) -> None:
        """Write an npz file that loads without pickle; `meta` is a 0-d JSON string."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez_compressed(path, meta=np.array(json.dumps(self.meta, sort_keys=True)), **arrays)

    @staticmethod
    def load(path: str | Path) -> Dataset:
        """Read what `save` wrote.

        Raises:
            FileNotFoundError: there is no such file.
            DatasetError: it is no npz file, or an array is missing.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                missing = [name for name in (*_ARRAYS, "meta") if name not in file]
                if missing:
                    raise DatasetError(str(path), f"no array {', '.join(missing)}; generate the data set anew")
                return Dataset(meta=json.loads(str(file["meta"])), **{name: file[name] for name in _ARRAYS})
        except (zipfile.BadZipFile, EOFError, ValueError, TypeError) as error:
            if isinstance(error, DatasetError):
                raise
            raise DatasetError(str(path), "it is no data set in npz format; generate one") from error


_ARRAYS = tuple(item.name for item in dataclasses.fields(Dataset) if item.name != "meta")


def generate_paper(parameters: TactileParameters | None = None, rigs: Sequence[int] = (0,), seed: int = 0) -> Dataset:
    """Generate the paper's protocol on each rig: 600 pairs by angle and 500 pairs by position, one frame each.

    Angle set: 0, 1, … 5° × 100 dockings; the start varies over ±20 mm in 4 mm steps, of which vision leaves a tenth.
    Position set: 5 × 5 offsets × 20 dockings at zero angle.

    Args:
        parameters: family of rigs; None = defaults.
        rigs: seeds of the devices.
        seed: seed of the dockings.
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
    return _generate("paper", parameters, rigs, poses, subset, seed, 1, CONTACT_THRESHOLD)


def generate_continuous(
    parameters: TactileParameters | None = None,
    rigs: Sequence[int] = (0, 1, 2, 3, 4),
    count: int = 400,
    seed: int = 0,
    frames: int = 1,
    threshold: float = CONTACT_THRESHOLD,
    position_limit: float = POSITION_LIMIT,
    angle_limit: float = ANGLE_LIMIT,
) -> Dataset:
    """Generate signed poses, uniform over ±position_limit and ±angle_limit.

    Args:
        parameters: family of rigs; None = defaults.
        rigs: seeds of the devices.
        count: dockings per rig.
        seed: seed of the dockings.
        frames: frames averaged per docking.
        threshold: readings below it are 0, N.
        position_limit: largest |x| and |y|, m.
        angle_limit: largest |angle|, rad.
    """
    random = np.random.default_rng([0xC047, seed])
    limit = np.array([position_limit, position_limit, angle_limit])
    poses = [random.uniform(-limit, limit, (count, 3)) for _ in rigs]
    subset = np.full(count, SUBSET_CONTINUOUS)
    return _generate("continuous", parameters, rigs, poses, subset, seed, frames, threshold)


def contact_force(parameters: DockingParameters, offset: Array, current: Array, magnets: float = 1.0) -> Array:
    """Total contact force (N,), N: magnets, weaker with the lateral offset (N, 2) m, plus the servos' push."""
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
) -> Dataset:
    if not rigs or frames < 1:
        raise DatasetError(protocol, f"{len(rigs)} rigs and {frames} frames; both must be at least 1")
    chosen = parameters or TactileParameters()
    parts = []
    for index, (rig_seed, pose) in enumerate(zip(rigs, poses, strict=True)):
        rig = Rig.draw(chosen, rig_seed)
        random = np.random.default_rng([0xD0C, seed, rig_seed])
        part = measure(chosen, rig, pose, random, frames, threshold)
        part["session"] = part["session"] + SESSIONS * index
        part["rig"] = np.full(len(pose), rig_seed)
        part["subset"] = subset
        parts.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    meta = {
        "version": 1,
        "protocol": protocol,
        "seed": seed,
        "rigs": list(rigs),
        "frames": frames,
        "threshold": threshold,
        "parameters": json.loads(chosen.to_json()),
        "digest": chosen.digest(),
    }
    return Dataset(attempt=np.arange(len(joined["left"])), meta=meta, **joined)


def measure(
    parameters: TactileParameters,
    rig: Rig,
    pose: Array,
    random: np.random.Generator,
    frames: int,
    threshold: float,
    current: Array | None = None,
) -> dict[str, Any]:
    """Dock once at each commanded pose (N, 3) and record it; the columns of a Dataset but those of the protocol."""
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
    session = np.sort(random.integers(0, SESSIONS, count))
    model = ContactModel(parameters.contact)
    felt = np.empty((count, *SHAPE))
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        rows = Dockings(*(getattr(dockings, item.name)[part] for item in dataclasses.fields(Dockings)))
        tilt = rows.tilts(parameters, rig, actual[part])
        taxels = model.solve(actual[part], force[part], tilt, rig.waviness).taxels
        sensor = Sensor(parameters.sensor, rig, random, len(taxels))
        total = np.zeros(taxels.shape)
        for frame in range(frames):
            raw = sensor.read(taxels, rows, dwell[part] + frame / FRAME_RATE, 1.0 / FRAME_RATE)
            total += np.maximum(raw - tares[session[part]], 0.0)
        felt[part] = total / frames
    dead = np.isnan(felt)
    felt = np.where(dead | (felt < threshold), 0.0, felt).astype(np.float32)
    return {
        "left": felt[:, 0],
        "right": felt[:, 1],
        "tare": np.nan_to_num(tares[session]).astype(np.float32),
        "dead": dead,
        "angle": pose[:, 2],
        "vertical": pose[:, 1],
        "horizontal": pose[:, 0],
        "contact_pose": actual,
        "session": session,
        "current": current,
        "force": force,
    }


def _tare(parameters: TactileParameters, rig: Rig, random: np.random.Generator) -> Array:
    sensor = Sensor(parameters.sensor, rig, random)
    frames = [sensor.read(None, None, 0.0, 1.0 / FRAME_RATE)[0] for _ in range(_TARE_FRAMES)]
    return np.asarray(np.mean(frames, axis=0))
