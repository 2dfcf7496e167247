# SPDX-License-Identifier: Apache-2.0
"""Recorded dockings: a folder with one file per docking, written completely or not at all, and the data set from it.

F.recording is beside F.npz. Its recording.json describes the recording. Each docking-*.mcap holds one docking: its raw
messages and the inputs of its rows. F.npz is composed from these files and can be composed again at any time.
"""

from __future__ import annotations

import fcntl
import io
import json
import math
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import read_array
from deltacharger_core.environment import package_version
from deltacharger_core.files import (
    atomic_write,
    brief,
    make_folder,
    parse_json,
    read_text,
    remove_unfinished,
    write_text,
)
from deltacharger_core.mcap_file import McapFile, Raw, RecordingError
from deltacharger_records.datasets.session import SETS, SUBSETS, Part
from deltacharger_records.raw_topics import Topic
from deltacharger_records.recording.mcap_recording import McapWriter
from deltacharger_tactile.dataset import VERSION, Dataset

_AS_KEPT = ("angle", "vertical", "horizontal", "current")
_JOURNAL_VERSION = 1
_HEADER, _DRIVER = "recording.json", "driver"
_RECORD, _FRAMES = "docking", "frames.npy"


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


class Mismatch(RecordingError):
    """The request differs from the recording's content."""


class Journal:
    """The folder beside a data set; open in one process at a time.

    Args:
        out: of the data set, F.npz.

    Attributes:
        dockings: all recorded ones, by attempt.
        parts: those with dockings, by name, in the order of their beginning.
        settings: common to all dockings; None before the first one.

    Raises:
        Mismatch: another process has it open, or F.npz exists and was not made from a recording.
        RecordingError: a file in it is damaged, or mcap is not installed.
    """

    def __init__(self, out: Path) -> None:
        self.out = out
        self.folder = out.with_suffix(".recording")
        self.dockings: list[Docking] = []
        self.parts: dict[str, Part] = {}
        self.settings: Settings | None = None
        if out.exists() and not self.folder.is_dir():
            raise Mismatch(f"{out} exists without {self.folder.name}: give another --out")
        make_folder(self.folder)
        self._lock = os.open(self.folder, os.O_RDONLY)
        try:
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            remove_unfinished(self.folder)
            self._read()
        except BlockingIOError as error:
            os.close(self._lock)
            raise Mismatch(f"another process records into {self.folder}: stop it, or give another --out") from error
        except BaseException:
            os.close(self._lock)
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *exception: object) -> None:
        if not any(self.folder.iterdir()):
            self.folder.rmdir()
        os.close(self._lock)

    def check(self, part: Part, settings: Settings) -> None:
        """Refuse arguments that differ from the recording's first ones.

        Raises:
            Mismatch: names what differs.
        """
        pairs: list[tuple[Any, Any]] = [(self.settings, settings), (self.parts.get(part.name), part)]
        differing = [
            f"{_flag(item.name)} {_shown(getattr(held, item.name))} (not {_shown(asked)})"
            for held, wanted in pairs
            if held is not None
            for item in fields(wanted)
            if (asked := getattr(wanted, item.name)) != getattr(held, item.name) and asked is not None
        ]
        if differing:
            raise Mismatch(f"{self.folder} was recorded with {', '.join(differing)}: use these, or give another --out")

    def done(self, part: Part) -> set[int]:
        """Return the numbers of a part's recorded dockings."""
        return {docking.number for docking in self.dockings if docking.part == part.name}

    @property
    def next_attempt(self) -> int:
        """Number for the next docking."""
        return 1 + max((docking.attempt for docking in self.dockings), default=-1)

    @property
    def next_session(self) -> int:
        """Number for the next session."""
        return 1 + max((docking.session for docking in self.dockings), default=-1)

    def _begin(self, part: Part, settings: Settings) -> None:
        """Add the part and the settings to recording.json."""
        self.settings, self.parts[part.name] = settings, part
        content = {
            "version": _JOURNAL_VERSION,
            "settings": asdict(settings),
            "parts": [asdict(each) for each in self.parts.values()],
        }
        write_text(self.folder / _HEADER, json.dumps(content, indent=1))

    def store(
        self, docking: Docking, part: Part, settings: Settings, topics: Mapping[str, Topic], messages: Iterable[Raw]
    ) -> None:
        """Write a docking durably; it is on the disk when this returns.

        Args:
            docking: to write.
            part: that it belongs to.
            settings: as passed to `check`.
            topics: by their full names.
            messages: of the complete docking.

        Raises:
            OSError: the disk does not accept it; nothing of it is kept.
        """
        if part.name not in self.parts:
            self._begin(part, settings)
        with McapWriter(self.folder / f"docking-{docking.attempt:06}.mcap", topics) as writer:
            for message in messages:
                writer.add(message)
            values = {key: json.dumps(value) for key, value in vars(docking).items() if key != "frames"}
            writer.add_metadata(_RECORD, values)
            array = io.BytesIO()
            np.save(array, docking.frames, allow_pickle=False)
            writer.attach(_FRAMES, "application/x-npy", array.getvalue())
        self.dockings.append(docking)

    def compose(self) -> Dataset | None:
        """Write F.npz from all dockings and return its content; None without dockings."""
        if not self.dockings or self.settings is None:
            return None
        data = dataset(self.dockings, self.parts, self.settings)
        with atomic_write(self.out) as path:
            data.save(path)
        return data

    def driver(self) -> str:
        """Return the name of the node that drove the arm for this recording and did not finish; '' = none."""
        path = self.folder / _DRIVER
        return read_text(path) if path.is_file() else ""

    def set_driver(self, name: str) -> None:
        """Record which node drives the arm; '' = none."""
        path = self.folder / _DRIVER
        if not name:
            path.unlink(missing_ok=True)
            return
        write_text(path, name)

    def _read(self) -> None:
        path = self.folder / _HEADER
        if not os.path.lexists(path):
            return
        try:
            content = parse_json(read_text(path))
            if content["version"] != _JOURNAL_VERSION:
                raise RecordingError(f"{path} has version {content['version']}: give another --out")
            settings = Settings(**_plain(Settings, content["settings"]))
            parts = {part.name: part for part in (Part.from_dict(_plain(Part, each)) for each in content["parts"])}
            if not all(part.set in SETS for part in parts.values()):
                raise ValueError("a part has an unknown set")
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise RecordingError(f"{path} is damaged ({error}): restore it, or give another --out") from error
        for file in sorted(self.folder.glob("docking-*.mcap")):
            self.dockings.append(_docking(file))
        names = {docking.part for docking in self.dockings}
        if names - set(parts):
            raise RecordingError(f"{path} does not list {', '.join(sorted(names - set(parts)))}: restore it")
        self.parts = {name: part for name, part in parts.items() if name in names}
        self.settings = settings if self.parts else None


def _flag(name: str) -> str:
    return "a charger that is" if name == "simulated" else f"--{name.replace('_', '-')}"


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "simulated" if value else "real"
    return " ".join(f"{each:g}" for each in value) if isinstance(value, tuple) else str(value)


def _plain(kind: Any, values: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the fields of a class from JSON values; ValueError if one has another type."""
    allowed: dict[str, tuple[type, ...]] = {"int": (int,), "float": (int, float), "str": (str,)}
    for item in fields(kind):
        value, types = values.get(item.name), allowed.get(str(item.type))
        if types and item.name in values and (not isinstance(value, types) or isinstance(value, bool)):
            raise ValueError(f"{item.name} is {brief(value)}")
    return values


def _docking(path: Path) -> Docking:
    """Read one docking.

    Raises:
        RecordingError: it is damaged.
    """
    file = McapFile(path)
    try:
        if file.damage:
            raise ValueError(file.damage)
        values = {key: parse_json(text) for key, text in file.metadata_named(_RECORD)[0].items()}
        content = file.attachment(_FRAMES)
        frames = read_array(io.BytesIO(content), len(content))
        if frames.ndim != 4 or frames.shape[1:] != (2, 10, 10) or frames.dtype.kind != "f" or np.isinf(frames).any():
            raise ValueError(f"frames of shape {frames.shape}, {frames.dtype}")
        return Docking(frames=frames, **_plain(Docking, values))
    except (ValueError, LookupError, TypeError) as error:
        raise RecordingError(f"{path} holds no docking ({error}): remove it to record this docking again") from error


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
