# SPDX-License-Identifier: Apache-2.0
"""A simulated world that records switching of contactor and torque, and the push of its servos.

It shows the devices' side of the wires; effects of faults are checked here, never on topics.
"""

from __future__ import annotations

from typing import NamedTuple

from deltacharger_bringup.scenes.scene import Simulation
from deltacharger_sim.charger.simulated_charger import SimulatedCharger
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.world import World

CONTACTOR = 0


class Event(NamedTuple):
    """The contactor (0) or the torque of a servo (1 to 3) went on or off at `time` (s of the world).

    `live` states whether the electrodes carried voltage at that instant.
    """

    time: float
    what: int
    on: bool
    live: bool


class RecordedWorld(World):
    """A world that records all `events`, built as a simulated charger builds its own."""

    def __init__(self, simulation: Simulation) -> None:
        source = ContactSource(None, simulation.rig_seed, simulation.seed)
        super().__init__(simulation.world, source, simulation.seed, simulation.geometry())
        self.events: list[Event] = []
        self._closed = False

    @property
    def torque(self) -> tuple[bool, ...]:
        """Servos that have torque now."""
        return tuple(self._enabled)

    def command(self, index: int, enabled: bool, reference: float, current_limit: float, *gains: float) -> None:
        if enabled != self._enabled[index]:
            self.events.append(Event(self.time, index + 1, enabled, self.circuit.closed))
        super().command(index, enabled, reference, current_limit, *gains)

    def step(self, dt: float | None = None) -> None:
        super().step(dt)
        closed = self.circuit.closed
        if closed != self._closed:
            self._closed = closed
            self.events.append(Event(self.time, CONTACTOR, closed, closed))

    def since(self, first: int, what: int, on: bool) -> list[Event]:
        """Return the events from number `first` on that switched `what` on or off."""
        return [event for event in self.events[first:] if event.what == what and event.on == on]


class RecordedCharger(SimulatedCharger):
    """A simulated charger with a recording world."""

    world: RecordedWorld

    @classmethod
    def build(cls, scene, namespace: str) -> RecordedCharger:  # type: ignore[no-untyped-def]
        charger = cls(scene.simulation, namespace=namespace)
        charger.world = RecordedWorld(scene.simulation)
        return charger
