# SPDX-License-Identifier: Apache-2.0
"""What simulated_camera_node can be told, as parameters, and what becomes of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from rclpy.node import Node

from deltacharger_ros import node_support
from deltacharger_sim.charger.parameters import ImageParameters, SimulatedCameraNodeParameters
from deltacharger_vision.errors import VisionError
from deltacharger_vision.hand_eye.board import Board, parse_board
from deltacharger_vision.mount import Mount
from deltacharger_vision.poses import Array, turn
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.mujoco_camera import MujocoCamera
from deltacharger_vision.rendering.parameters import CameraParameters
from deltacharger_vision.rendering.scene import RenderedScene
from deltacharger_vision.rendering.scene_drawing import draw_scene

Camera = SimulatedCamera | MujocoCamera


def mounted(given: SimulatedCameraNodeParameters, random: np.random.Generator) -> Array:
    """Return charger_base_T_camera (4, 4), its drawn error included.

    Raises:
        VisionError: the mount is no pose.
    """
    pose = Mount.from_numbers(given.mount).pose
    pose[:3, :3] = turn(given.hand_eye_rotation_stddev * random.normal(size=3)) @ pose[:3, :3]
    pose[:3, 3] += given.hand_eye_position_stddev * random.normal(size=3)
    return pose


def target_pose(given: SimulatedCameraNodeParameters) -> Array:
    """Return charger_base_T_terminal (4, 4)."""
    pose = np.eye(4)
    about_x, about_y = np.array([given.target_tilt_x, 0.0, 0.0]), np.array([0.0, given.target_tilt_y, 0.0])
    pose[:3, :3] = turn(about_x) @ turn(about_y) @ turn(np.array([0.0, 0.0, given.target_roll]))
    pose[:3, 3] = given.target_x, given.target_y, given.target_z
    return pose


def scene(given: SimulatedCameraNodeParameters, random: np.random.Generator) -> RenderedScene:
    """Return what else is in the picture."""
    drawn = draw_scene(random, clutter=given.clutter, decoys=given.decoys, target=given.target_present)
    if given.glare < 0.0:
        return drawn
    return dataclasses.replace(drawn, parameters=dataclasses.replace(drawn.parameters, highlight=given.glare))


def camera_maker(given: SimulatedCameraNodeParameters, defects: ImageParameters) -> Callable[[], Camera]:
    """Return what makes the camera, in the thread that renders."""
    kind = MujocoCamera if given.renderer == "mujoco" else SimulatedCamera
    return lambda: kind(OAK_D.scaled(given.width, given.height), CameraParameters(**dataclasses.asdict(defects)))


def try_out(node: Node, make: Callable[[], Camera]) -> None:
    """Make the camera once, so that what is wrong with it stops the node at its start."""
    try:
        camera = make()
    except VisionError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error
    if isinstance(camera, MujocoCamera):
        camera.close()


def board(given: SimulatedCameraNodeParameters) -> tuple[Board, Array] | None:
    """Return the calibration board on the platform and end_effector_T_board (4, 4), or None.

    Raises:
        VisionError: there is no such board, or its pose is none.
    """
    if not given.board:
        return None
    found = parse_board(given.board, given.board_size, given.board_marker or None)
    return found, Mount.from_numbers(given.board_pose).pose
