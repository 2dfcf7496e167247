# SPDX-License-Identifier: Apache-2.0
"""A scene's settings of the simulated charger."""

from __future__ import annotations

from dataclasses import dataclass, field

from deltacharger_core.files import given_path
from deltacharger_core.parameters import Bounded, choice, entries, number, words
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_sim.charger.faults import Fault
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.world import World


@dataclass(frozen=True)
class Simulation(Bounded):
    """The simulated charger that replaces the hardware."""

    seed: int = number(0, 0, 2**31 - 1, "", "random numbers of noise, jitter and faults")
    rig_seed: int = number(0, 0, 2**31 - 1, "", "simulated device: gains, offsets, dead taxels, ridges")
    servos: str = choice("adapter", ("adapter", "board"), "their connection: a separate adapter, or the board")
    world: WorldParameters = field(default_factory=WorldParameters)
    faults: tuple[Fault, ...] = entries("faults of the emulated hardware, with their times")
    geometry_file: str = words("", "YAML file with the simulated arm's true dimensions; empty = the defaults")

    def geometry(self) -> DeltaGeometry:
        """Return the simulated arm's dimensions.

        Raises:
            OSError, ValueError: the file cannot be read, or is invalid.
        """
        return load_geometry(given_path(self.geometry_file)) if self.geometry_file else DeltaGeometry()

    def build_world(self) -> World:
        """Return the world behind the ports, with its rig's pads."""
        return World(self.world, ContactSource(None, self.rig_seed, self.seed), self.seed, self.geometry())
