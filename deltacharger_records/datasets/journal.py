# SPDX-License-Identifier: Apache-2.0
"""A data set that grows docking by docking: F.npz is written anew after each, completely or not at all."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.environment import package_version
from deltacharger_core.files import atomic_write
from deltacharger_records.datasets.session import SUBSETS, CommandedPose, Part
from deltacharger_tactile.dataset import VERSION, Dataset

THRESHOLD = 0.25
"""Smaller forces (N) count as 0, as for the estimator."""
_ROWS = [item.name for item in fields(Dataset) if item.name != "meta"]


@dataclass(frozen=True)
class Settings:
    """Values common to all rows of a file.

    Attributes:
        rig: number of the device.
        frames: averaged in each row.
        simulated: whether the charger was simulated; None = not known.
    """

    rig: int
    frames: int
    simulated: bool | None = None


@dataclass(frozen=True)
class Docking:
    """One docking.

    Attributes:
        number: index in its part's poses.
        session: number of the tare that its frames use, unique in the file.
        pose: commanded pose of the target in end_effector.
        x, y: the same offsets by the arm's joints in contact, m.
        current: contact current, A.
        pads: (2, 10, 10) float32 N, left and right, tared, not thresholded; NaN where dead.
    """

    number: int
    session: int
    pose: CommandedPose
    x: float
    y: float
    current: float
    pads: NDArray[np.float32]


class Mismatch(RuntimeError):
    """The request differs from the file's content."""


class Journal:
    """The data set in a file: one row for each docking.

    Args:
        out: of the data set, F.npz.

    Attributes:
        data: its rows; None before the first docking.
        settings: common to all dockings; None before the first one.

    Raises:
        Mismatch: the file was not recorded by this class.
        DatasetError: it is damaged.
    """

    def __init__(self, out: Path) -> None:
        self.out = out
        self.data = Dataset.load(out) if out.exists() else None
        self.settings: Settings | None = None
        self._parts: dict[str, dict[str, Any]] = {}  # arguments and recorded numbers, in the order of their beginning
        if self.data is None:
            return
        try:
            self.settings = Settings(**{item.name: self.data.meta[item.name] for item in fields(Settings)})
            self._parts = {str(each["name"]): dict(each) for each in self.data.meta["parts"]}
            if not all(isinstance(number, int) for each in self._parts.values() for number in each["numbers"]):
                raise ValueError
        except (KeyError, TypeError, ValueError) as error:
            raise Mismatch(f"{out} was not recorded by this command: give another --out") from error

    @property
    def dockings(self) -> int:
        """Number of recorded dockings."""
        return sum(len(each["numbers"]) for each in self._parts.values())

    @property
    def next_session(self) -> int:
        """Number for the next session."""
        return 0 if self.data is None else 1 + int(self.data.session.max())

    def parts(self) -> dict[str, tuple[int, int]]:
        """Return the number of recorded dockings and of all, of each part by its name."""
        return {name: (len(each["numbers"]), each["of"]) for name, each in self._parts.items()}

    def check(self, part: Part, settings: Settings) -> None:
        """Refuse arguments that differ from the first ones.

        Raises:
            Mismatch: names what differs.
        """
        pairs = [({} if self.settings is None else asdict(self.settings), asdict(settings))]
        pairs.append((self._parts.get(part.name, {}), asdict(part)))
        differing = [
            f"{_flag(name)} {_shown(held[name])} (not {_shown(asked)})"
            for held, wanted in pairs
            for name, asked in wanted.items()
            if name in held and asked is not None and _shown(held[name]) != _shown(asked)
        ]
        if differing:
            raise Mismatch(f"{self.out} was recorded with {', '.join(differing)}: use these, or give another --out")

    def done(self, part: Part) -> set[int]:
        """Return the numbers of a part's recorded dockings."""
        return set(self._parts.get(part.name, {}).get("numbers", ()))

    def add_docking(self, docking: Docking, part: Part, settings: Settings) -> None:
        """Add a docking; it is on the disk when this returns.

        Args:
            docking: to add.
            part: that it belongs to.
            settings: as passed to `check`.

        Raises:
            OSError: the disk does not accept it; the file stays as it was.
        """
        name, poses = part.name, len(part.poses())
        parts = {**self._parts, name: {**asdict(part), "name": name, "of": poses, "numbers": sorted(self.done(part))}}
        parts[name]["numbers"] += [docking.number]
        rows = _row(docking, part, settings, 0 if self.data is None else 1 + int(self.data.attempt.max()))
        if self.data is not None:
            rows = {each: np.concatenate([getattr(self.data, each), rows[each]]) for each in _ROWS}
        data = Dataset(**rows, meta=self._meta(parts, settings))
        with atomic_write(self.out) as path:
            data.save(path)
        self.data, self.settings, self._parts = data, settings, parts

    def _meta(self, parts: Mapping[str, dict[str, Any]], settings: Settings) -> dict[str, Any]:
        now = datetime.now(timezone.utc).isoformat(timespec="seconds")
        return {
            "version": VERSION,
            "protocol": "recorded",
            "recorded": True,
            **asdict(settings),
            "threshold": THRESHOLD,
            "rigs": [settings.rig],
            "package": package_version(),
            "from": now if self.data is None else self.data.meta["from"],
            "to": now,
            "parts": list(parts.values()),
        }


def _row(docking: Docking, part: Part, settings: Settings, attempt: int) -> dict[str, NDArray[Any]]:
    """Return the row of a docking.

    Board tare and total contact force are unknown: both are NaN. So is the angle in contact. x and y in contact come
    from the arm's joints: unlike the command, they include the offset that friction leaves.
    """
    pads = docking.pads[None]
    dead = np.isnan(pads)
    pads = np.where(dead | (pads < THRESHOLD), 0.0, pads).astype(np.float32)
    values = {"attempt": attempt, "session": docking.session, "rig": settings.rig, "subset": SUBSETS[part.set]}
    known = {**asdict(docking.pose), "current": docking.current, "force": math.nan}
    return {
        "left": pads[:, 0],
        "right": pads[:, 1],
        "tare": np.full(pads.shape, np.nan, dtype=np.float32),
        "dead": dead,
        "contact_pose": np.array([(docking.x, docking.y, math.nan)]),
        **{name: np.array([value], dtype=np.int64) for name, value in values.items()},
        **{name: np.array([value], dtype=np.float64) for name, value in known.items()},
    }


def _flag(name: str) -> str:
    return "a charger that is" if name == "simulated" else f"--{name.replace('_', '-')}"


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "simulated" if value else "real"
    return " ".join(f"{each:g}" for each in value) if isinstance(value, list | tuple) else str(value)
