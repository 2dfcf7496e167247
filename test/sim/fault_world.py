# SPDX-License-Identifier: Apache-2.0
"""A simulated world that remembers when the contactor and the servos' torque came and went, and what its servos pushed.

What is asked of a charger under a fault is read off here, from the devices' side of the wires, never from topics.
"""

from __future__ import annotations

from typing import NamedTuple

from deltacharger_scenes.scene import Simulation
from deltacharger_sim.charger.simulated_charger import SimulatedCharger
from deltacharger_sim.world import World
from deltacharger_tactile.source import ContactSource

CONTACTOR = 0


class Event(NamedTuple):
    """The contactor (0) or the torque of a servo (1 to 3) went on or off at `time` (s of the world).

    `live` tells whether the electrodes carried voltage at that instant.
    """

    time: float
    what: int
    on: bool
    live: bool


class RecordedWorld(World):
    """A world with a memory, built as a simulated charger builds its own.

    Attributes:
        events: all so far.
        turned: s of the world at which the goal of each servo changed last.
        stood: longest s for which the goal of a servo has stood still; reset it to 0 to look from then on.
    """

    def __init__(self, simulation: Simulation) -> None:
        source = ContactSource(None, simulation.rig_seed, simulation.seed)
        super().__init__(simulation.world, source, simulation.seed, simulation.geometry())
        self.events: list[Event] = []
        self.turned = [0.0, 0.0, 0.0]
        self.stood = 0.0
        self._closed = False

    @property
    def torque(self) -> tuple[bool, ...]:
        """Which servos have torque now."""
        return tuple(self._enabled)

    def command(self, index: int, enabled: bool, reference: float, current_limit: float, gain: float = 1.0) -> None:
        if enabled != self._enabled[index]:
            self.events.append(Event(self.time, index + 1, enabled, self.circuit.closed))
        if reference != self._reference[index]:
            self.stood = max(self.stood, self.time - self.turned[index])
            self.turned[index] = self.time
        super().command(index, enabled, reference, current_limit, gain)

    def step(self, dt: float | None = None) -> None:
        super().step(dt)
        closed = self.circuit.closed
        if closed != self._closed:
            self._closed = closed
            self.events.append(Event(self.time, CONTACTOR, closed, closed))

    def since(self, first: int, what: int, on: bool) -> list[Event]:
        """Return the events from number `first` on in which `what` went on or off."""
        return [event for event in self.events[first:] if event.what == what and event.on == on]


class RecordedCharger(SimulatedCharger):
    """A simulated charger before a world with a memory."""

    world: RecordedWorld

    @classmethod
    def build(cls, scene, namespace: str) -> RecordedCharger:  # type: ignore[no-untyped-def]
        charger = cls(scene.simulation, namespace=namespace)
        charger.world = RecordedWorld(scene.simulation)
        return charger
