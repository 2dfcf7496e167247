# SPDX-License-Identifier: Apache-2.0
"""Recording a data set: its dockings, the session that makes them, and the file that grows by each.

A `Part` plans the dockings: the paper's two sets, reference dockings and signed poses. A `TouchSession` makes them,
never energised: touch, hold still, take frames, release. Steps and error handling are docking_node's. However a session
ends, the arm retracts and its torque is switched off. A `Journal` writes F.npz anew after each docking, completely or
not at all.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, environment, files, script
from deltacharger_docking import algorithm, codes, press, release, standoff
from deltacharger_docking.context import Context
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.release import RETRACT_TIMEOUT
from deltacharger_docking.touch import MEASURE_TIMEOUT
from deltacharger_kinematics.geometry import Vector
from deltacharger_tactile.dataset import SUBSET_ANGLE, SUBSET_CONTINUOUS, SUBSET_POSITION, VERSION, Dataset
from deltacharger_tactile.parameters import POSITION_CLASSES, POSITION_LIMIT

SETS = ("position", "angle", "reference", "sweep")
SUBSETS = dict(zip(SETS, (SUBSET_POSITION, SUBSET_ANGLE, SUBSET_CONTINUOUS, SUBSET_CONTINUOUS), strict=True))
REPEATS = {"position": 20, "angle": 100, "reference": 10, "sweep": 100}
"""Dockings at each offset (position), else in total (paper; reference and sweep are ours)."""
TILTED = {"angle": 5.0, "sweep": 20.0}
"""Sets with a turned target, and the largest angle, degrees."""
OFFSETS_MM = tuple(1e3 * value for value in POSITION_CLASSES)
_LEFT_BY_VISION = 0.1  # of the start's offset (assumed; the paper states only the starts)
_START_STEP, _START_STEPS = 0.004, 5  # m; the start varies by ±20 mm in steps of 4 mm (paper)
_RUN_UP = 0.006  # m before the standoff, where the run-up along +z starts
THRESHOLD = 0.25
"""Smaller forces (N) count as 0, as for the estimator."""
_ROWS = [item.name for item in fields(Dataset) if item.name != "meta"]


@dataclass(frozen=True)
class CommandedPose:
    """Desired pose of the target in end_effector: m, m, rad, signed as in Dataset."""

    horizontal: float
    vertical: float
    angle: float


@dataclass(frozen=True)
class Part:
    """What one command records, in the units of the command line.

    Attributes:
        set: one of SETS.
        angle_deg: of the target about +z of charger_base, from +x to +y.
        repeat: dockings at each offset of the position set, in total for other sets.
        seed: of order and offsets.
        x_mm, y_mm, z_mm: position of the target's electrodes in charger_base.
        offsets_mm: of the position set, along each axis.
    """

    set: str
    angle_deg: float
    repeat: int
    seed: int
    x_mm: float
    y_mm: float
    z_mm: float
    offsets_mm: tuple[float, ...] = OFFSETS_MM

    @property
    def name(self) -> str:
        """Unique name in a file: the set, and its angle if it has one."""
        return f"{self.set} {self.angle_deg:g}°" if self.set in TILTED else self.set

    @property
    def target(self) -> tuple[float, float, float]:
        """Position of the target's electrodes, m, charger_base."""
        return 1e-3 * self.x_mm, 1e-3 * self.y_mm, 1e-3 * self.z_mm

    def poses(self) -> list[CommandedPose]:
        """Return every docking's pose in the order of recording; equal arguments give equal poses.

        Each repetition of the position set has a new order of offsets, so that drift does not look like an offset.
        """
        angle, random = math.radians(self.angle_deg), self._random()
        if self.set == "position":
            grid = 1e-3 * np.array([(x, y) for x in self.offsets_mm for y in self.offsets_mm])
            offsets = np.concatenate([random.permutation(grid) for _ in range(self.repeat)])
        elif self.set == "angle":
            offsets = _LEFT_BY_VISION * self.starts()
        elif self.set == "reference":
            offsets = np.zeros((self.repeat, 2))
        else:
            offsets = random.uniform(-POSITION_LIMIT, POSITION_LIMIT, (self.repeat, 2))
        return [CommandedPose(float(x), float(y), angle) for x, y in offsets]

    def starts(self) -> arrays.Array:
        """Return (repeat, 2) m: the arm's start offset from the target in each docking of the angle set."""
        return np.asarray(_START_STEP * self._random().integers(-_START_STEPS, _START_STEPS + 1, (self.repeat, 2)))

    def _random(self) -> np.random.Generator:
        return np.random.default_rng([SETS.index(self.set), self.seed, round(1e3 * self.angle_deg) % 2**32])


class NotKept(codes.DockingError):
    """A docking could not be written. Example: the disk is full."""


@dataclass(frozen=True)
class Rested:
    """The contact of one docking at rest.

    Attributes:
        position: of the end effector by its joints (m, charger_base), averaged over the frames.
        current: contact current, A.
        commanded: where it was to meet the target, m, charger_base.
    """

    position: Vector
    current: float
    commanded: Vector


class Keeper(Protocol):
    """Stores the measurements; its methods return at once."""

    def begin_docking(self, number: int) -> None:
        """Docking `number` of the session (from 0) begins."""

    def start_frames(self) -> None:
        """The contact is at rest: frames sampled from now on count."""

    def has_frames(self) -> bool:
        """Whether there are enough frames; DockingError if they are unusable."""

    def keep(self, touch: Rested) -> None:
        """The arm has released the target: write the measurements."""

    def kept(self) -> bool:
        """Whether they are written; DockingError if that failed."""


def check_places(machine: DockingMachine, commands: Sequence[Vector]) -> None:
    """Refuse commands (m, charger_base) if the arm cannot reach them, or cannot move to them from in front.

    Raises:
        Rejected: electrodes connected to the battery: each touch would be live.
        Unreachable: names the first such command; nothing was moved.
    """
    if machine.parameters.always_live:
        raise codes.Rejected(
            "docking_node has power: none, so every touch of a recording would be live: disconnect the electrodes from "
            "the battery, and start docking_node with power: board for the recording"
        )
    for x, y, z in commands:
        wrong = machine.planner.reach_problem((x, y, _before(machine.parameters, z)), (x, y, z))
        if wrong:
            raise codes.Unreachable(f"out of the arm's reach, {wrong}: move the target and give its new position")


@dataclass(frozen=True)
class TouchSession:
    """Touches the target once at each of several places; a docking machine runs it by `start(session.run, …)`.

    Attributes:
        commands: where the end effector meets the target, m, charger_base; with `look`, where it starts.
        dwell: s from rest in contact to the first frame.
        holding: s of taking frames.
        keeper: stores the measurements.
        look: whether each command is only the start: then the camera locates the target to touch.
    """

    commands: Sequence[Vector]
    dwell: float
    holding: float
    keeper: Keeper
    look: bool = False

    def run(self, context: Context) -> script.Script[str]:
        """Make the dockings of the session.

        Raises:
            DockingError: as in a docking.
        """
        yield from algorithm.prepare(context)
        for number, command in enumerate(self.commands):
            self.keeper.begin_docking(number)
            yield from _go_before(context, command)
            place = command
            if self.look:
                place = (yield from algorithm.locate(context)).position
                yield from _go_before(context, place)
            yield from standoff.approach(context, place)
            yield from press.contact(context, place[2] + context.parameters.search_depth)
            yield from self._record(context, place)
            context.enter(codes.State.IDLE, math.inf)
            while not self.keeper.kept():
                yield script.NEXT
        yield from release.retract(context, wanted=True)
        return "every docking was recorded"

    def _record(self, context: Context, place: Vector) -> script.Script[None]:
        """Rest, take frames, release, and wait until all is stored."""
        _parameters, keeper = context.parameters, self.keeper
        context.enter(codes.State.MEASURE, self.dwell + 2.0 * self.holding + MEASURE_TIMEOUT)
        yield from context.wait(self.dwell)
        keeper.start_frames()
        positions = [context.position]
        while not keeper.has_frames():
            yield script.NEXT
            positions.append(context.position)
        x, y, z = (float(value) for value in np.mean(positions, axis=0))
        touch = Rested((x, y, z), context.contact.value, place)
        context.enter(codes.State.RETRACT, RETRACT_TIMEOUT)
        yield from release.lift_off(context)
        keeper.keep(touch)


def _go_before(context: Context, command: Vector) -> script.Script[None]:
    """Move sideways in free air, before the standoff, so that the approach tares in a motion along +z."""
    parameters = context.parameters
    context.enter(codes.State.ALIGN, press.ALIGN_TIMEOUT)
    x, y, z = command
    yield from context.move((x, y, _before(parameters, z)), parameters.travel_speed, settle=False)


def _before(parameters: DockingParameters, z: float) -> float:
    return z - parameters.standoff - _RUN_UP


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
        with files.atomic_write(self.out) as path:
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
            "package": environment.package_version(),
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
