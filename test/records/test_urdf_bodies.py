# SPDX-License-Identifier: Apache-2.0
"""The URDF's bodies, as the programs of others read them: they weigh what statics say, and none is inside another."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_core.arrays import Array
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.passive_joints import passive_joints
from deltacharger_kinematics.scalar import ScalarDelta

from .test_urdf import BAKED, UrdfTree

SPECKS = 2e-5  # kg, and N·m that they weigh


class MuJoCo:
    """What MuJoCo reads in a URDF: masses, what joints hold at rest (N·m, N), and pairs of links that touch."""

    def __init__(self, path: Path) -> None:
        self.mujoco: Any = pytest.importorskip("mujoco", reason="`pip install mujoco`")
        self.model: Any = self.mujoco.MjModel.from_xml_path(str(path))
        self.data: Any = self.mujoco.MjData(self.model)

    def moving(self) -> float:
        return float(self.model.body_mass.sum())  # what stands still belongs to the world, which has none

    def _forward(self, joints: Mapping[str, float]) -> None:
        for name, value in joints.items():
            self.data.qpos[self.model.joint(name).qposadr[0]] = value
        self.mujoco.mj_forward(self.model, self.data)

    def held(self, joints: Mapping[str, float], gravity: Array) -> dict[str, float]:
        self.model.opt.gravity[:] = gravity
        self._forward(joints)
        return {name: float(self.data.qfrc_bias[self.model.joint(name).dofadr[0]]) for name in joints}

    def touching(self, joints: Mapping[str, float]) -> set[tuple[str, str]]:
        self._forward(joints)
        bodies = (self.model.geom_bodyid[contact.geom] for contact in self.data.contact)
        return {(self.model.body(one).name, self.model.body(other).name) for one, other in bodies}


def joint_values(kinematics: ScalarDelta, angles: Array) -> dict[str, float]:
    """Return the value of every joint, at these arm angles."""
    values = passive_joints(kinematics, list(angles))
    right = {name.replace("left", "right"): value for name, value in values.items()}
    return values | right | {f"limb_{index}_arm_joint": float(angle) for index, angle in enumerate(angles)}


def poses(geometry: DeltaGeometry, counts: tuple[int, int, int]) -> Array:
    """Return home and a grid over the workspace (n, 3), m."""
    bounds = zip(geometry.workspace_min, geometry.workspace_max, counts, strict=True)
    grid = itertools.product(*(np.linspace(low, high, count) for low, high, count in bounds))
    return np.array([(0.0, 0.0, 0.0), *grid])


def touching(reader: MuJoCo, geometry: DeltaGeometry, points: Array) -> set[tuple[str, str]]:
    kinematics, angles = ScalarDelta(geometry), Delta(geometry).inverse(points).angles
    return set().union(*(reader.touching(joint_values(kinematics, each)) for each in angles))


def test_no_body_touches_another_in_the_workspace() -> None:
    assert touching(MuJoCo(BAKED), DeltaGeometry(), poses(DeltaGeometry(), (5, 5, 4))) == set()


def test_it_weighs_what_the_statics_say() -> None:
    geometry, gravity, step = DeltaGeometry(), np.array([1.5, -9.5, 2.0]), 1e-5
    read, kinematics = MuJoCo(BAKED), ScalarDelta(geometry)
    assert read.moving() == pytest.approx(geometry.platform_mass + 3 * geometry.rod_mass, abs=SPECKS)
    base = UrdfTree(BAKED.read_text(encoding="utf-8")).frames(joint_values(kinematics, np.zeros(3)))["charger_base"]
    for point in poses(geometry, (2, 2, 2)):
        angles = Delta(geometry).inverse(point).angles
        held = read.held(joint_values(kinematics, angles), base[:3, :3] @ gravity)
        torques = []
        for move in step * np.eye(3):  # of one arm, which moves every joint of the closed loops
            back, ahead = joint_values(kinematics, angles - move), joint_values(kinematics, angles + move)
            torques.append(sum(held[name] * (ahead[name] - back[name]) for name in held) / (2.0 * step))
        assert torques == pytest.approx(kinematics.holding_torque(*point, tuple(gravity)), abs=SPECKS)
