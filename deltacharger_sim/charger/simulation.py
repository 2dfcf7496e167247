# SPDX-License-Identifier: Apache-2.0
"""What a scene says of the simulated charger."""

from __future__ import annotations

from dataclasses import dataclass, field

from deltacharger_core.bounded_file import given_path
from deltacharger_core.parameters import Bounded, choice, entries, number, words
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.geometry_file import load_geometry
from deltacharger_sim.charger.faults import Fault
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.world import World
from deltacharger_tactile.source import ContactSource


@dataclass(frozen=True)
class Simulation(Bounded):
    """The simulated charger that takes the hardware's place."""

    seed: int = number(0, 0, 2**31 - 1, "", "course of noise, jitter and faults")
    rig_seed: int = number(0, 0, 2**31 - 1, "", "which device: gains, offsets, dead taxels, ridges")
    servos: str = choice("adapter", ("adapter", "board"), "where they hang: on an adapter of their own, on the board")
    world: WorldParameters = field(default_factory=WorldParameters)
    faults: tuple[Fault, ...] = entries("what goes wrong with the emulated hardware, and when")
    geometry_file: str = words("", "YAML file with what the simulated arm's dimensions really are; empty = the usual")

    def geometry(self) -> DeltaGeometry:
        """Return the simulated arm's dimensions.

        Raises:
            OSError, ValueError: the file cannot be read, or is refused.
        """
        return load_geometry(given_path(self.geometry_file)) if self.geometry_file else DeltaGeometry()

    def build_world(self) -> World:
        """Return the world behind the ports, with the pads of its rig."""
        return World(self.world, ContactSource(None, self.rig_seed, self.seed), self.seed, self.geometry())
