# SPDX-License-Identifier: Apache-2.0
"""Find faulty taxels of a rig from its dockings, and compare its tares.

Nothing here uses the contact model. A taxel is compared with its neighbours along the row, parallel to the ridge. The
commanded pose shows where the ridge cannot be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array, Mask
from deltacharger_core.machine import COLUMNS, CONTACT_FORCE, ROWS
from deltacharger_tactile.dataset import Dataset
from deltacharger_tactile.errors import SensorCalibrationError
from deltacharger_tactile.parameters import SHAPE, PadContactParameters

_DEAD_SHARE = 0.05  # of the dockings in which the board reported a taxel dead; the estimator handles single glitches
_EVENTS = 3  # dockings that must show it
_SILENT_SHARE = 0.8  # of the dockings that pressed its neighbours
_SILENT = 0.1  # of what the neighbours read
_AWAY = 0.010  # m from the ridge's line: half its height, its spread in the skin, three jitters, half a taxel
_LOUD = 0.5  # N without pressure: ten times what a contact leaves behind
_NOISY = 0.25  # N, scatter of a docking's reading without pressure; the model uses readings from here on
_DRIFT = 0.25  # N between sessions; chosen like _NOISY
_BASELINE = 0.5  # N from the other taxels' baseline


@dataclass(frozen=True)
class KnownDockings:
    """Dockings of one rig at known poses, one row each.

    Attributes:
        frames: (N, 2, 10, 10) N, tared; NaN where dead.
        pose: (N, 3) m, m, rad: (horizontal, vertical, angle) as commanded.
        truth: (N, 3) m, m, rad in contact; NaN if the data lack it.
        tares: (S, 2, 10, 10) N, baseline of each session; NaN = unknown.
        rig: number of the rig.
        threshold: readings below it were recorded as 0, N.
    """

    frames: Array
    pose: Array
    truth: Array
    tares: Array
    rig: int
    threshold: float

    def __len__(self) -> int:
        return len(self.frames)

    def part(self, rows: NDArray[np.int64]) -> KnownDockings:
        """Return the given rows."""
        return KnownDockings(self.frames[rows], self.pose[rows], self.truth[rows], self.tares, self.rig, self.threshold)


@dataclass(frozen=True)
class PadFaults:
    """(2, 10, 10) masks of faulty taxels.

    Attributes:
        reported: dead according to the board.
        silent: reads almost nothing while its neighbours along the row read much.
        loud: reads something without pressure, or never changes.
        noisy: scatters without pressure.
    """

    reported: Mask
    silent: Mask
    loud: Mask
    noisy: Mask

    @property
    def dead(self) -> Mask:
        """All faulty taxels."""
        return self.reported | self.silent | self.loud | self.noisy


@dataclass(frozen=True)
class Tares:
    """Comparison of the sessions' baselines; NaN if the data do not show it.

    Attributes:
        sessions: number of sessions.
        drift: (2, 10, 10) N, largest less smallest baseline of a taxel.
        drifted: (2, 10, 10) taxels whose baseline moved by more than the pose model tolerates.
        outlying: (2, 10, 10) taxels whose baseline is far from the other taxels'.
    """

    sessions: int
    drift: Array
    drifted: Mask
    outlying: Mask


def select(data: Dataset, rig: int | None = None) -> KnownDockings:
    """Select the dockings of one rig; rows of the same docking are averaged.

    Args:
        data: with commanded poses.
        rig: its number; None = the only one.

    Raises:
        SensorCalibrationError: no such rig, or several and none selected.
    """
    rigs = np.unique(data.rig).tolist()
    if rig is None and len(rigs) > 1:
        raise SensorCalibrationError("the data", f"they hold the rigs {_listed(rigs)}; pick one with --rig N")
    chosen = rigs[0] if rig is None else rig
    if chosen not in rigs:
        raise SensorCalibrationError(f"rig {chosen}", f"not in the data, which hold {_listed(rigs)}")
    rows = np.flatnonzero(data.rig == chosen)
    _, first, docking = np.unique(data.attempt[rows], return_index=True, return_inverse=True)
    readings = np.stack([data.left[rows], data.right[rows]], axis=1).astype(float)
    readings[data.dead[rows]] = np.nan
    frames = np.zeros((len(first), *SHAPE))
    np.add.at(frames, docking, readings)
    frames /= np.bincount(docking)[:, None, None, None]
    once = rows[first]
    _, opening = np.unique(data.session[once], return_index=True)
    return KnownDockings(
        frames=frames,
        pose=np.column_stack([data.horizontal, data.vertical, data.angle])[once],
        truth=data.contact_pose[once],
        tares=data.tare[once][opening].astype(float),
        rig=int(chosen),
        threshold=float(np.nan_to_num(data.threshold)),
    )


def _listed(rigs: list[int]) -> str:
    return ", ".join(map(str, rigs[:8])) + (" …" if len(rigs) > 8 else "")


def find(dockings: KnownDockings) -> PadFaults:
    """Check every taxel."""
    frames = dockings.frames
    dead = ~np.isfinite(frames)
    marked = dead.mean(axis=0) >= _DEAD_SHARE
    away = _away(dockings.pose) & ~dead
    enough = away.sum(axis=0) >= _EVENTS
    quiet = np.where(away, frames, np.nan)
    quiet[:, ~enough] = 0.0
    middle, upper = np.nanquantile(quiet, (0.5, 0.84), axis=0)
    loud = middle > _LOUD
    scatter = upper - middle  # one standard deviation: of readings cut off at 0, only the upper side shows
    live = np.where(dead, 0.0, frames)
    # A taxel stuck at one value after the tare; one stuck at 0 is silent.
    stuck = (np.ptp(live, axis=0) < 1e-6) & (live[0] > 0.0) & (len(frames) > 1)
    return PadFaults(
        marked, _silent(frames, dockings.threshold) & ~marked, (loud | stuck) & ~marked, (scatter > _NOISY) & ~marked
    )


def _silent(frames: Array, threshold: float) -> Mask:
    """Return taxels that read nothing while their two nearest neighbours in the row read much."""
    live = np.where(np.isfinite(frames), frames, 0.0)
    beside = np.empty_like(live)
    beside[..., 1:-1] = np.minimum(live[..., :-2], live[..., 2:])
    beside[..., 0] = np.minimum(live[..., 1], live[..., 2])
    beside[..., -1] = np.minimum(live[..., -2], live[..., -3])
    pressed = beside >= max(CONTACT_FORCE, 3.0 * threshold)
    nothing = pressed & (live < _SILENT * beside)
    count = pressed.sum(axis=0)
    return np.asarray((count >= _EVENTS) & (nothing.sum(axis=0) >= _SILENT_SHARE * count))


def _away(pose: Array) -> Mask:
    """Return (N, 2, 10, 10): taxels that the ridges cannot reach at the commanded poses (N, 3)."""
    contact = PadContactParameters()
    line = contact.pad_side * (0.5 - (np.arange(ROWS) + 0.5) / ROWS)
    v, u = np.meshgrid(line, line[:COLUMNS], indexing="ij")
    x = np.stack([u + contact.pad_distance, u - contact.pad_distance])
    horizontal, vertical, angle = (pose[:, axis, None, None, None] for axis in range(3))
    return np.asarray(np.abs(np.cos(angle) * (v - vertical) - np.sin(angle) * (x - horizontal)) > _AWAY)


def compare_tares(dockings: KnownDockings, dead: Mask) -> Tares:
    """Compare the sessions' baselines without the taxels in `dead`."""
    tares = np.where(dead, np.nan, dockings.tares)
    known = np.isfinite(tares).all(axis=0)
    drift = np.where(known, np.ptp(np.where(known, tares, 0.0), axis=0), np.nan)
    middle = np.median(tares[:, known]) if known.any() else np.nan
    outlying = known & (np.abs(np.where(known, tares, 0.0).mean(axis=0) - middle) > _BASELINE)
    return Tares(len(tares), drift, known & (np.nan_to_num(drift) > _DRIFT), outlying)
