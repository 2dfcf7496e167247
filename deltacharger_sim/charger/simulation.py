# SPDX-License-Identifier: Apache-2.0
"""A scene's settings of the simulated charger and its camera."""

from dataclasses import dataclass, field

import numpy as np

from deltacharger_core import files, machine, parameters
from deltacharger_core.parameters import choice, entries, flag, number, words
from deltacharger_kinematics.geometry import DeltaGeometry, load_geometry
from deltacharger_sim.charger.faults import Fault
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.world import World
from deltacharger_vision.mount import Mount, pose_numbers
from deltacharger_vision.terminal import turn


@dataclass(frozen=True)
class Simulation(parameters.Bounded):
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
        return load_geometry(files.given_path(self.geometry_file)) if self.geometry_file else DeltaGeometry()

    def build_world(self) -> World:
        """Return the world behind the ports, with its rig's pads."""
        return World(self.world, ContactSource(None, self.rig_seed, self.seed), self.seed, self.geometry())


@dataclass(frozen=True)
class SimulatedCameraNodeParameters(parameters.Bounded):
    """Poses of target and camera, and surroundings."""

    rate: float = number(10.0, 0.1, 120.0, "Hz", "images per second")
    seed: int = number(1, 0, 2**31 - 1, "", "surroundings, light, noise and the mount's error")
    mount: tuple[float, ...] = parameters.pose(
        pose_numbers(Mount.default().pose), "assumed pose of the camera in charger_base"
    )
    mount_error: float = number(0.0, 0.0, 20.0, "", "error of that pose, drawn per axis; 1 = 2 mm and 0.5 degrees rms")
    target: tuple[float, ...] = parameters.pose(
        (0.0, 0.0, machine.DOCK_DISTANCE, 0.0, 0.0, 0.0, 1.0), "electrodes in charger_base"
    )
    target_present: bool = flag(True, "false = no target")
    clutter: int = number(0, 0, 100, "", "boxes around the target")
    board: str = words("", "calibration board on the platform, such as apriltag:36h11:0 of 40 mm; empty = none")


def target_numbers(target: TargetParameters) -> list[float]:
    """Return the pose of a world's target as the camera's parameter."""
    place = np.eye(4)
    about_x, about_y = np.array([target.tilt_x, 0.0, 0.0]), np.array([0.0, target.tilt_y, 0.0])
    place[:3, :3] = turn(about_x) @ turn(about_y) @ turn(np.array([0.0, 0.0, target.roll]))
    place[:3, 3] = target.x, target.y, target.z
    return list(pose_numbers(place))
