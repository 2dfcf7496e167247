# SPDX-License-Identifier: Apache-2.0
"""Recording a data set: its dockings, and the session that makes them.

A `Part` plans the dockings: the paper's two sets, reference dockings and signed poses. A `TouchSession` makes them,
never energised: touch, hold still, take frames, release. Steps and error handling are docking_node's. However a session
ends, the arm retracts and its torque is switched off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.script import NEXT, Script
from deltacharger_docking.algorithm import locate, prepare
from deltacharger_docking.codes import DockingError, Rejected, State, Unreachable
from deltacharger_docking.context import Context
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.press import ALIGN_TIMEOUT, contact
from deltacharger_docking.release import RETRACT_TIMEOUT, lift_off, retract
from deltacharger_docking.standoff import approach
from deltacharger_docking.touch import MEASURE_TIMEOUT
from deltacharger_kinematics.geometry import Vector
from deltacharger_tactile.dataset import SUBSET_ANGLE, SUBSET_CONTINUOUS, SUBSET_POSITION
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

    def starts(self) -> Array:
        """Return (repeat, 2) m: the arm's start offset from the target in each docking of the angle set."""
        return np.asarray(_START_STEP * self._random().integers(-_START_STEPS, _START_STEPS + 1, (self.repeat, 2)))

    def _random(self) -> np.random.Generator:
        return np.random.default_rng([SETS.index(self.set), self.seed, round(1e3 * self.angle_deg) % 2**32])


class NotKept(DockingError):
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

    def begin(self, number: int) -> None:
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
        raise Rejected(
            "docking_node has power: none, so every touch of a recording would be live: disconnect the electrodes from "
            "the battery, and start docking_node with power: board for the recording"
        )
    for x, y, z in commands:
        wrong = machine.planner.reach_problem((x, y, _before(machine.parameters, z)), (x, y, z))
        if wrong:
            raise Unreachable(f"out of the arm's reach, {wrong}: move the target and give its new position")


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

    def run(self, context: Context) -> Script[str]:
        """Make the dockings of the session.

        Raises:
            DockingError: as in a docking.
        """
        yield from prepare(context)
        for number, command in enumerate(self.commands):
            self.keeper.begin(number)
            yield from _go_before(context, command)
            place = command
            if self.look:
                place = (yield from locate(context)).position
                yield from _go_before(context, place)
            yield from approach(context, place)
            yield from contact(context, place[2] + context.parameters.search_depth)
            yield from self._record(context, place)
            context.enter(State.IDLE, math.inf)
            while not self.keeper.kept():
                yield NEXT
        yield from retract(context, wanted=True)
        return "every docking was recorded"

    def _record(self, context: Context, place: Vector) -> Script[None]:
        """Rest, take frames, release, and wait until all is stored."""
        _parameters, keeper = context.parameters, self.keeper
        context.enter(State.MEASURE, self.dwell + 2.0 * self.holding + MEASURE_TIMEOUT)
        yield from context.wait(self.dwell)
        keeper.start_frames()
        positions = [context.position]
        while not keeper.has_frames():
            yield NEXT
            positions.append(context.position)
        x, y, z = (float(value) for value in np.mean(positions, axis=0))
        touch = Rested((x, y, z), context.contact.value, place)
        context.enter(State.RETRACT, RETRACT_TIMEOUT)
        yield from lift_off(context)
        keeper.keep(touch)


def _go_before(context: Context, command: Vector) -> Script[None]:
    """Move sideways in free air, before the standoff, so that the approach tares in a motion along +z."""
    parameters = context.parameters
    context.enter(State.ALIGN, ALIGN_TIMEOUT)
    x, y, z = command
    yield from context.move((x, y, _before(parameters, z)), parameters.travel_speed, settle=False)


def _before(parameters: DockingParameters, z: float) -> float:
    return z - parameters.standoff - _RUN_UP
