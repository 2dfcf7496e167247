# SPDX-License-Identifier: Apache-2.0
"""A random charger with a board on its platform, as numbers and images, for hand-eye tests with known truth."""

import dataclasses
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deltacharger_bringup.cli.camera_views import ViewsFolder, view_places
from deltacharger_kinematics import geometry, scalar
from deltacharger_vision import images, mount, terminal
from deltacharger_vision.hand_eye.board import Board, Sighting
from deltacharger_vision.hand_eye.fit import Beliefs, View
from deltacharger_vision.rendering import board_drawing, camera
from deltacharger_vision.rendering.scene import RenderedScene, charger_parts, shifted

ARM = scalar.ScalarDelta()
DOCK = np.array([0.0, 0.0, 0.080])
JOINTS, OFFSET, PLAY, PIXEL = math.radians(0.1), 0.0005, 0.0001, 0.05
"""Standard deviations of a usual charger: rad, m, m, px."""


class Rig:
    """One charger.

    Args:
        seed: of all random values.
        board: on the platform.
        joints, offset: standard deviations of the arm angles' errors (rad) and of the ruler (m).
        true_size: of the board, relative to the stated size.
        intrinsics: of the camera.
    """

    def __init__(
        self,
        seed: int,
        board: Board | None = None,
        joints: float = JOINTS,
        offset: float = OFFSET,
        true_size: float = 1.0,
        intrinsics: images.Intrinsics = camera.OAK_D,
    ) -> None:
        self.random = np.random.default_rng(seed)
        self.board, self.true_size, self.intrinsics = board or Board(), true_size, intrinsics
        self.mount = np.array(mount.Mount.default().pose)
        self.mount[:3, 3] += self.random.normal(scale=0.003, size=3)
        self.mount[:3, :3] = terminal.turn(self.random.normal(scale=0.02, size=3)) @ self.mount[:3, :3]
        self.place = board_drawing.bracket() @ shifted((0.0, 0.0, 0.005))
        self.place[:3, :3] = terminal.turn(self.random.normal(scale=0.05, size=3)) @ self.place[:3, :3]
        self.joints = self.random.normal(scale=joints, size=3)
        first, second, third = self.place[:3, 3] + self.random.normal(scale=offset, size=3)
        self.offset: geometry.Vector = (float(first), float(second), float(third))
        self.beliefs = Beliefs(self.offset, offset, joints)

    def stands(self) -> Iterator[tuple[geometry.Vector, geometry.Vector]]:
        """Yield places (m) with the angles (rad) that servo_node reports there."""
        radius = self.board.size / math.sqrt(2.0) + self.board.margin
        for place in view_places(
            geometry.DeltaGeometry(), 0.06, mount.Mount.default(), self.intrinsics, self.offset, radius
        ):
            yield place, ARM.inverse(*place)

    def platform(self, angles: geometry.Vector) -> geometry.Vector:
        """Return the platform's true position, m."""
        first, second, third = np.array(angles) + self.joints
        return ARM.forward(float(first), float(second), float(third))

    def views(self, count: int, pixel: float = PIXEL, arm: float = PLAY) -> list[View]:
        """Return views as numbers, with scatter of corners (px) and of positions (m)."""
        found = []
        for (place, angles), _ in zip(self.stands(), range(count), strict=False):
            true = np.array(self.platform(angles)) + self.random.normal(scale=arm, size=3)
            points = self.true_size * self.board.corners() @ self.place[:3, :3].T + self.place[:3, 3] + true
            pixels = images.project((points - self.mount[:3, 3]) @ self.mount[:3, :3], self.intrinsics)
            pixels += self.random.normal(scale=pixel, size=pixels.shape)
            slope = np.array(ARM.jacobian(*place)).reshape(3, 3)
            found.append(View(np.array(place), Sighting(self.board.corners(), pixels), slope))
        return found

    def image(self, angles: geometry.Vector, board: Board | None = None) -> np.ndarray:
        """Return an image (H, W, 3) RGB with board, platform and arms."""
        platform = self.platform(angles)
        pose = np.linalg.inv(self.mount) @ shifted(platform) @ self.place
        scene = board_drawing.with_board(RenderedScene(target=False), board or self.board, pose)
        parts = charger_parts(self.mount, platform, angles)
        scene = dataclasses.replace(scene, foreground=(*scene.foreground, *parts))
        before = np.linalg.inv(self.mount) @ shifted((0.0, 0.0, 0.3))
        return camera.SimulatedCamera(self.intrinsics).render(scene, before, self.random, color_only=True).color

    def write(self, folder: Path, count: int) -> Path:
        """Fill a folder of views and return it."""
        files = ViewsFolder(folder, self.intrinsics)
        for (_, angles), _ in zip(self.stands(), range(count), strict=False):
            files.add(self.image(angles), angles)
        return folder

    def error(self, found: mount.Mount) -> np.ndarray:
        """Return the error (6,) of a mount in the order of its covariance: m and rad."""
        turned = found.pose[:3, :3] @ self.mount[:3, :3].T
        rotation = 0.5 * np.array(
            [turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]]
        )
        return np.append(found.pose[:3, 3] - self.mount[:3, 3], rotation)

    def dock_error(self, found: mount.Mount) -> np.ndarray:
        """Return the error (3,) m of a point observed at the dock."""
        error = self.error(found)
        return error[:3] - terminal.cross_matrix(DOCK - found.pose[:3, 3]) @ error[3:]


def squared(error: np.ndarray, covariance: np.ndarray) -> float:
    """Return the squared error in units of its covariance."""
    return float(error @ np.linalg.solve(covariance, error))
