# SPDX-License-Identifier: Apache-2.0
"""What simulated_camera_node can be told, as parameters, and what becomes of it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from rclpy.node import Node

from deltacharger_core.machine import DOCK_DISTANCE
from deltacharger_core.parameters import declared
from deltacharger_ros import node_support
from deltacharger_vision.errors import VisionError
from deltacharger_vision.hand_eye.board import LARGEST, SMALLEST, Board, parse_board
from deltacharger_vision.mount import Mount, quaternion
from deltacharger_vision.poses import Array, turn
from deltacharger_vision.rendering.board_drawing import bracket
from deltacharger_vision.rendering.camera import OAK_D, SimulatedCamera
from deltacharger_vision.rendering.mujoco_camera import MujocoCamera
from deltacharger_vision.rendering.parameters import CameraParameters
from deltacharger_vision.rendering.scene import Scene
from deltacharger_vision.rendering.scene_drawing import draw_scene

Camera = SimulatedCamera | MujocoCamera


def declare_mount(node: Node, random: np.random.Generator) -> Array:
    """Declare how the camera is mounted and return charger_base_T_camera (4, 4), its drawn error included."""
    usual = Mount.default().pose
    seven = node_support.declare(
        node,
        "mount",
        [float(value) for value in (*usual[:3, 3], *quaternion(usual[:3, :3]))],
        "where the camera is believed to be in charger_base: x, y, z in m, then the quaternion x, y, z, w",
    )
    position = node_support.declare(
        node, "hand_eye_position_stddev", 0.0, "by how much the camera sits elsewhere, drawn per axis (m)", 0.0, 0.05
    )
    rotation = node_support.declare(
        node, "hand_eye_rotation_stddev", 0.0, "by how much it looks elsewhere, drawn per axis (rad)", 0.0, 0.2
    )
    try:
        pose = Mount.from_numbers(seven).pose
    except VisionError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error
    pose[:3, :3] = turn(rotation * random.normal(size=3)) @ pose[:3, :3]
    pose[:3, 3] += position * random.normal(size=3)
    return pose


def declare_target(node: Node) -> Array:
    """Declare where the electrodes are and return charger_base_T_terminal (4, 4)."""
    place = [
        node_support.declare(node, f"target_{axis}", default, f"electrodes along {axis} of charger_base (m)", -2.0, 2.0)
        for axis, default in (("x", 0.0), ("y", 0.0), ("z", DOCK_DISTANCE))
    ]
    roll, about_x, about_y = (
        node_support.declare(node, f"target_{name}", 0.0, f"of the electrodes about {axis} (rad)", -1.6, 1.6)
        for name, axis in (("roll", "z"), ("tilt_x", "x"), ("tilt_y", "y"))
    )
    pose = np.eye(4)
    pose[:3, :3] = (
        turn(np.array([about_x, 0.0, 0.0])) @ turn(np.array([0.0, about_y, 0.0])) @ turn(np.array([0, 0, roll]))
    )
    pose[:3, 3] = place
    return pose


def declare_scene(node: Node, random: np.random.Generator) -> Scene:
    """Declare what else is in the picture and return it."""
    present = node_support.declare(node, "target_present", True, "whether there is a target")
    clutter = node_support.declare(node, "clutter", 0, "boxes around the target", 0, 100)
    decoys = node_support.declare(node, "decoys", 0, "things around it that resemble electrodes", 0, 20)
    glare = node_support.declare(
        node, "glare", -1.0, "highlight on the metal, 1 = full scale; negative = drawn by seed", -1.0, 20.0
    )
    scene = draw_scene(random, clutter=clutter, decoys=decoys, target=present)
    if glare < 0.0:
        return scene
    return dataclasses.replace(scene, parameters=dataclasses.replace(scene.parameters, highlight=glare))


def declare_camera(node: Node) -> Callable[[], Camera]:
    """Declare size, defects and renderer of the image and return what makes its camera."""
    width = node_support.declare(node, "width", OAK_D.width, "of the image (px)", 64, 4096)
    height = node_support.declare(node, "height", OAK_D.height, "of the image (px)", 40, 4096)
    renderer = node_support.declare(
        node,
        "renderer",
        "numpy",
        "numpy: a ray-caster that needs nothing else; mujoco: OpenGL with shadows, deltacharger[sim]",
        choices=("numpy", "mujoco"),
    )
    names = ("exposure", "defocus", "motion_x", "disparity_noise", "hole_metal", "hole_glare", "hole_matte")
    defects = {
        each.name: node_support.declare(node, each.name, each.default, each.description(), each.low, each.high)
        for each in declared(CameraParameters)
        if each.name in names
    }
    kind = MujocoCamera if renderer == "mujoco" else SimulatedCamera
    return lambda: kind(OAK_D.scaled(width, height), CameraParameters(**defects))


def try_out(node: Node, make: Callable[[], Camera]) -> None:
    """Make the camera once, so that what is wrong with it stops the node at its start."""
    try:
        camera = make()
    except VisionError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error
    if isinstance(camera, MujocoCamera):
        camera.close()


def declare_board(node: Node) -> tuple[Board, Array] | None:
    """Declare the calibration board on the platform; return it and end_effector_T_board (4, 4), or None."""
    name = node_support.declare(
        node,
        "board",
        "",
        "calibration board on the platform, such as apriltag:36h11:0 or charuco:4x4_50:5x4; empty = none",
    )
    size = node_support.declare(node, "board_size", 0.040, "side of the tag or of a square (m)", SMALLEST, LARGEST)
    marker = node_support.declare(node, "board_marker", 0.0, "side of a marker (m); 0 = three quarters", 0.0, LARGEST)
    usual = bracket()
    seven = node_support.declare(
        node,
        "board_pose",
        [float(value) for value in (*usual[:3, 3], *quaternion(usual[:3, :3]))],
        "of the board in end_effector: x, y, z in m, then the quaternion x, y, z, w",
    )
    if not name:
        return None
    try:
        return parse_board(name, size, marker or None), Mount.from_numbers(seven).pose
    except VisionError as error:
        raise node_support.StartupError(f"{node.get_name()}: {error}") from error
