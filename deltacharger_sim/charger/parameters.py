# SPDX-License-Identifier: Apache-2.0
"""The parameters of simulated_camera_node."""

from __future__ import annotations

from dataclasses import dataclass

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.parameters import Bounded, flag, number, pose, words
from deltacharger_vision.hand_eye.board import LARGEST, SMALLEST
from deltacharger_vision.mount import Mount, pose_numbers
from deltacharger_vision.rendering.camera import OAK_D


@dataclass(frozen=True)
class SimulatedCameraNodeParameters(Bounded):
    """Poses of target and camera, surroundings, and rendering."""

    rate: float = number(10.0, 0.1, 120.0, "Hz", "images per second")
    seed: int = number(1, 0, 2**31 - 1, "", "surroundings, light, noise and the mount's error")
    mount: tuple[float, ...] = pose(pose_numbers(Mount.default().pose), "assumed pose of the camera in charger_base")
    hand_eye_position_stddev: float = number(0.0, 0.0, 0.05, "m", "error of that position, drawn per axis")
    hand_eye_rotation_stddev: float = number(0.0, 0.0, 0.2, "rad", "error of that orientation, drawn per axis")
    target_present: bool = flag(True, "false = no target")
    target_x: float = number(0.0, -2.0, 2.0, "m", "electrodes along x of charger_base")
    target_y: float = number(0.0, -2.0, 2.0, "m", "electrodes along y of charger_base")
    target_z: float = number(DOCK_DISTANCE, -2.0, 2.0, "m", "electrodes along z of charger_base")
    target_roll: float = number(0.0, -1.6, 1.6, "rad", "of the electrodes about z")
    target_tilt_x: float = number(0.0, -1.6, 1.6, "rad", "of the electrodes about x")
    target_tilt_y: float = number(0.0, -1.6, 1.6, "rad", "of the electrodes about y")
    clutter: int = number(0, 0, 100, "", "boxes around the target")
    decoys: int = number(0, 0, 20, "", "objects around it that resemble electrodes")
    glare: float = number(-1.0, -1.0, 20.0, "", "highlight on the metal, 1 = full scale; negative = drawn by seed")
    width: int = number(OAK_D.width, 64, 4096, "px", "of the image")
    height: int = number(OAK_D.height, 40, 4096, "px", "of the image")
    board: str = words("", "calibration board on the platform, such as apriltag:36h11:0; empty = none")
    board_size: float = number(0.040, SMALLEST, LARGEST, "m", "side of the tag")
