# SPDX-License-Identifier: Apache-2.0
"""Docking for its own sake: touch, hold still, let frames be taken, let go; again and again, never energised.

The steps of docking are those of docking_node, and so is what happens when something goes wrong: whatever ends a
session, the arm is taken back and its torque switched off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from deltacharger_docking.algorithm import locate
from deltacharger_docking.arm import lift_off, prepare, retract
from deltacharger_docking.codes import Busy, DockingError, ServoFailure, State, Unreachable
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Observation
from deltacharger_docking.press import approach, contact
from deltacharger_docking.script import NEXT, Script
from deltacharger_kinematics.geometry import Vector

_RUN_UP = 0.006  # m below the standoff from which it is approached along +z


class NotKept(DockingError):
    """A docking could not be written. Example: the disk is full."""


class ServoSilence(ServoFailure):
    """servo_state stopped, which may pass by itself. Example: the computer stood still."""

    retriable = True


@dataclass(frozen=True)
class Rested:
    """How one docking rested.

    Attributes:
        position: of the end effector by its joints (m, charger_base), averaged while frames were taken.
        current: contact current, A.
        commanded: where it was told to meet the target, m, charger_base.
    """

    position: Vector
    current: float
    commanded: Vector


class Keeper(Protocol):
    """Takes what is felt; its methods return at once."""

    def begin(self, number: int) -> None:
        """Docking `number` of the session (from 0) begins."""

    def listen(self) -> None:
        """The contact has rested: frames sampled from now on count."""

    def heard(self) -> bool:
        """Whether there are enough of them; DockingError where they are of no use."""

    def keep(self, touch: Rested) -> None:
        """The arm has let go: write what was felt."""

    def kept(self) -> bool:
        """Whether it is written; DockingError where it cannot be."""


class RecordingMachine(DockingMachine):
    """Runs sessions; between them it is as DockingMachine. Dock and undock are left to docking_node."""

    def check(self, commands: Sequence[Vector]) -> None:
        """Refuse places (m, charger_base) that the arm cannot reach, or not from before them.

        Raises:
            Unreachable: names the first; nothing was moved.
        """
        for x, y, z in commands:
            wrong = self._context.planner.reachable((x, y, self._before(z)), (x, y, z))
            if wrong:
                raise Unreachable(f"out of the arm's reach, {wrong}; put the target elsewhere and say where it stands")

    def start_session(
        self,
        commands: Sequence[Vector],
        dwell: float,
        holding: float,
        keeper: Keeper,
        observation: Observation,
        look: bool = False,
    ) -> None:
        """Begin to touch the target once at each of `commands`; `outcome` tells how it ended.

        Args:
            commands: where the end effector shall meet the target, m, charger_base; or from where it shall look for it.
            dwell: s from rest in contact to the first frame.
            holding: s that the frames take.
            keeper: takes what is felt.
            observation: the present one.
            look: whether each command is only the start: then the camera is asked, and what it sees is touched.

        Raises:
            Busy: a session runs.
        """
        if self.busy:
            raise Busy("a session is running; cancel it or wait for its end")
        self._start("", observation, lambda: self._session(commands, dwell, holding, keeper, look))
        self._desk.deadline = math.inf

    def _problem(self) -> DockingError | None:
        problem = super()._problem()
        silent = self._context.observation.servo_age > self.parameters.servo_age_max
        return ServoSilence(str(problem)) if silent and isinstance(problem, ServoFailure) else problem

    def _session(
        self, commands: Sequence[Vector], dwell: float, holding: float, keeper: Keeper, look: bool
    ) -> Script[None]:
        context = self._context
        yield from prepare(context)
        for number, command in enumerate(commands):
            keeper.begin(number)
            yield from self._go_before(command)
            place = command
            if look:
                place = (yield from locate(context)).position
                yield from self._go_before(place)
            yield from approach(context, place)
            yield from contact(context, place[2] + context.parameters.search_depth)
            yield from self._feel(place, dwell, holding, keeper)
            context.enter(State.IDLE, math.inf)
            while not keeper.kept():
                yield NEXT
        yield from retract(context, wanted=True)
        context.enter(State.IDLE, math.inf)
        self._desk.succeed("every docking was recorded")

    def _go_before(self, command: Vector) -> Script[None]:
        """Go sideways in free air, far enough from the target that the approach tares in a motion along +z."""
        context, parameters = self._context, self.parameters
        context.enter(State.ALIGN, parameters.align_timeout)
        x, y, z = command
        yield from context.move((x, y, self._before(z)), parameters.travel_speed, settle=False)

    def _before(self, z: float) -> float:
        return z - self.parameters.standoff - _RUN_UP

    def _feel(self, place: Vector, dwell: float, holding: float, keeper: Keeper) -> Script[None]:
        """Rest, let frames be taken, let go, and have it all kept."""
        context, parameters = self._context, self.parameters
        context.enter(State.MEASURE, dwell + 2.0 * holding + parameters.measure_timeout)
        yield from context.wait(dwell)
        keeper.listen()
        positions = [context.position]
        while not keeper.heard():
            yield NEXT
            positions.append(context.position)
        x, y, z = (float(value) for value in np.mean(positions, axis=0))
        touch = Rested((x, y, z), context.contact.value, place)
        context.enter(State.RETRACT, parameters.retract_timeout)
        yield from lift_off(context)
        keeper.keep(touch)
