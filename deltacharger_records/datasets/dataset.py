# SPDX-License-Identifier: Apache-2.0
"""Recorded dockings, their common settings, and the data set made from them."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.version import package_version
from deltacharger_records.datasets.plan import SUBSETS, Part
from deltacharger_tactile.dataset import VERSION, Dataset

_AS_KEPT = ("angle", "vertical", "horizontal", "current")


@dataclass(frozen=True)
class Settings:
    """Values common to all rows of a file.

    Attributes:
        rig: number of the device.
        sensor: name of its pads.
        frames: averaged in each row.
        rows: of each docking.
        threshold: readings below it become 0, N.
        dwell_s: from rest in contact to the first frame, s.
        simulated: whether the charger was simulated; None = not known.
    """

    rig: int
    sensor: str
    frames: int
    rows: int
    threshold: float
    dwell_s: float
    simulated: bool | None = None


@dataclass(frozen=True)
class Docking:
    """One docking in the recording.

    Attributes:
        attempt: its number, unique in the file.
        session: number of the tare that its frames use, unique in the file.
        part: name of the part of the recording.
        number: index in the part's poses.
        horizontal, vertical, angle: commanded pose of the target in end_effector, m, m, rad.
        x, y: the same offsets by the arm's joints in contact, m.
        current: contact current, A.
        time: when it was measured, s since 1970.
        frames: (rows, 2, 10, 10) float32 N, left and right, tared, not thresholded; NaN where dead.
    """

    attempt: int
    session: int
    part: str
    number: int
    horizontal: float
    vertical: float
    angle: float
    x: float
    y: float
    current: float
    time: float
    frames: NDArray[np.float32]


def dataset(dockings: Sequence[Docking], parts: Mapping[str, Part], settings: Settings) -> Dataset:
    """Return the rows of all dockings, in their order.

    Board tare and total contact force are unknown: both are NaN. So is the angle in contact. x and y in contact come
    from the arm's joints: unlike the command, they include the offset that friction leaves.
    """
    rows = np.array([len(docking.frames) for docking in dockings])
    frames = np.concatenate([docking.frames for docking in dockings])
    dead = np.isnan(frames)
    frames = np.where(dead | (frames < settings.threshold), 0.0, frames).astype(np.float32)

    def column(values: Iterable[Any], kind: Any = float) -> NDArray[Any]:
        return np.repeat(np.array(list(values), dtype=kind), rows, axis=0)

    count = len(frames)
    return Dataset(
        left=frames[:, 0],
        right=frames[:, 1],
        tare=np.full(frames.shape, np.nan, dtype=np.float32),
        dead=dead,
        contact_pose=column((docking.x, docking.y, math.nan) for docking in dockings),
        attempt=column((docking.attempt for docking in dockings), np.int64),
        session=column((docking.session for docking in dockings), np.int64),
        rig=np.full(count, settings.rig, dtype=np.int64),
        subset=column((SUBSETS[parts[docking.part].set] for docking in dockings), np.int64),
        **{name: column(getattr(docking, name) for docking in dockings) for name in _AS_KEPT},
        force=np.full(count, np.nan),
        meta=_meta(dockings, parts, settings),
    )


def _meta(dockings: Sequence[Docking], parts: Mapping[str, Part], settings: Settings) -> dict[str, Any]:
    counts = Counter(docking.part for docking in dockings)
    times = [docking.time for docking in dockings]
    return {
        "version": VERSION,
        "protocol": "recorded",
        "recorded": True,
        **asdict(settings),
        "rigs": [settings.rig],
        "package": package_version(),
        "from": _date(min(times)),
        "to": _date(max(times)),
        "parts": [
            {
                **asdict(part),
                "name": name,
                "recorded": counts[name],
                "of": len(part.poses()),
                "sessions": sorted({docking.session for docking in dockings if docking.part == name}),
            }
            for name, part in parts.items()
        ],
    }


def _date(time: float) -> str:
    return datetime.fromtimestamp(time, timezone.utc).isoformat(timespec="seconds")
