# SPDX-License-Identifier: Apache-2.0
"""A world moved by MuJoCo: the optional reference for the light model, with the same parameters.

`mujoco_world(...)` is a World: circuit, jitter, record and readings are the light model's; only the motion differs.
"""

from __future__ import annotations

import functools
import logging
import math
from typing import Any

from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, Vector
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.mujoco import model as mujoco_model
from deltacharger_lab.mujoco.lean import MujocoLean
from deltacharger_records.view.shapes import rod_angles
from deltacharger_sim.motion import Motion
from deltacharger_sim.parameters import MagnetParameters, WorldParameters
from deltacharger_sim.tilt import tilts
from deltacharger_sim.world import TactileSource, World

STEP = 0.001  # s; with `discrete`, the settled force is as accurate as at a tenth of it

_LOG = logging.getLogger(__name__)
_DEAD = 1e-12  # N·m, torque range of an unpowered servo; MuJoCo needs a range


class MujocoMechanics(Motion):
    """Motion by MuJoCo; NaN once MuJoCo has diverged.

    Args:
        parameters: of the world.
        geometry: of the delta.
        start: of the platform, m, charger_base.
        step: of MuJoCo, s; a world's step consists of several.
        integrator: one of `mujoco_model.integrators()`; "" = the best of them.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ParameterError: the reference does not support a parameter.
        ValueError: the integrator is unknown.
    """

    def __init__(
        self,
        parameters: WorldParameters,
        geometry: DeltaGeometry,
        start: Vector,
        step: float = STEP,
        integrator: str = "",
    ) -> None:
        super().__init__(parameters, start)
        self._mujoco = mujoco_model.load()
        # Otherwise MuJoCo writes a file to the current folder when it diverges.
        self._mujoco.set_mju_user_warning(_LOG.warning)
        self._step = step
        self.model: Any = mujoco_model.build(parameters, geometry, step, integrator or mujoco_model.integrators()[0])
        self.data: Any = self._mujoco.MjData(self.model)
        names = [f"arm{index}" for index in range(LIMB_COUNT)]
        self._arms = [int(self.model.joint(name).qposadr[0]) for name in names]
        self._axes = [int(self.model.joint(axis).qposadr[0]) for axis in "xyz"]
        self._leaning = MujocoLean(self.model, parameters) if tilts(parameters) and parameters.target.present else None
        self._begin(geometry, start)
        self._read()

    def _begin(self, geometry: DeltaGeometry, start: Vector) -> None:
        """Place arms, rods and platform so that the loops are closed."""
        angles = ScalarDelta(geometry).inverse(*start)
        if math.isnan(angles[0]):
            raise ValueError(f"start {start!r} is out of the arm's reach: give a point in its workspace (m)")
        for index, angle in enumerate(angles):
            pitch, swing = rod_angles(geometry, index, start, angle)
            for name, value in (("arm", angle), ("pitch", pitch), ("swing", swing)):
                self.data.joint(f"{name}{index}").qpos[0] = value
        for axis, value in zip(self._axes, start, strict=True):
            self.data.qpos[axis] = value

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s, rounded to whole steps of MuJoCo; arguments as of `Motion.step`."""
        inputs = (enabled, reference, limit)
        if inputs != self._inputs:
            self._inputs = inputs
            self._command(enabled, reference, limit)
        data, model, present = self.data, self.model, self._parameters.target.present
        if self._leaning is not None:
            self._leaning.lie(self.position, x, y)
        magnets, applied, (along_x, along_y, along_z) = self._parameters.magnets, data.qfrc_applied, self._axes
        centre_x, centre_y = self.position[0] + x, self.position[1] + y
        for _ in range(max(1, round(dt / self._step))):
            if present:
                side_x, side_y = centre_x - float(data.qpos[along_x]), centre_y - float(data.qpos[along_y])
                gap, offset = self._target_z - float(data.qpos[along_z]), math.hypot(side_x, side_y)
                self.magnet_force, aligning = pull(magnets, gap, offset), side_pull(magnets, gap, offset)
                applied[along_x], applied[along_y], applied[along_z] = (
                    aligning * side_x,
                    aligning * side_y,
                    self.magnet_force,
                )
            if self._leaning is not None:
                self._leaning.turn_back(data)
            self._mujoco.mj_step(model, data)
        self._read()

    def _command(self, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector) -> None:
        servo, model = self._parameters.servo, self.model
        for index, (on, goal, bound, gain, braking) in enumerate(
            zip(enabled, reference, limit, self.gains, self.brakes, strict=True)
        ):
            k, d = servo.stiffness * gain, servo.damping * braking
            most = min(bound * servo.torque_constant, servo.stall_torque) if on else 0.0
            model.actuator_forcerange[index] = (-max(most, _DEAD), max(most, _DEAD))
            model.actuator_gainprm[index, 0] = k if on else 0.0
            model.actuator_biasprm[index, 1:3] = (-k, -d) if on else (0.0, 0.0)
            model.dof_frictionloss[self._arms[index]] = servo.friction if on else servo.unpowered_friction
            self.data.ctrl[index] = goal

    def _read(self) -> None:
        data = self.data
        place, speed, force = data.qpos.tolist(), data.qvel.tolist(), data.actuator_force.tolist()
        x, y, z = self._axes
        first, second, third = self._arms
        self.position = (place[x], place[y], place[z])
        self.velocity = (speed[x], speed[y], speed[z])
        self.angles = (place[first], place[second], place[third])
        self.rates = (speed[first], speed[second], speed[third])
        self._drive(force[0], force[1], force[2])
        if self._leaning is not None:
            self.contact_force, self.tilt, self._bars = self._leaning.read(data)
        else:
            rows = [int(row) for row in data.contact.efc_address] if data.ncon else []
            self.contact_force = float(sum(data.efc_force[row] for row in rows if row >= 0))
        self.peak_force = self.contact_force


def mujoco_world(
    parameters: WorldParameters,
    tactile: TactileSource | None = None,
    seed: int = 0,
    geometry: DeltaGeometry | None = None,
    step: float = STEP,
    integrator: str = "",
) -> World:
    """Return a World moved by MuJoCo in steps of `step` s; arguments as of World and MujocoMechanics.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ParameterError: the reference does not support a parameter.
        ValueError: the integrator is unknown.
    """

    moved = functools.partial(MujocoMechanics, step=step, integrator=integrator)
    return World(parameters, tactile, seed, geometry, mechanics=moved)


def pull(magnets: MagnetParameters, gap: float, offset: float) -> float:
    """Return the pull (N, toward the target) at a `gap` and lateral `offset` (m)."""
    share = max(magnets.floor, 1.0 / (1.0 + (offset / magnets.width) ** 2))
    ratio = 1.0 + max(gap, 0.0) / magnets.range
    return magnets.force * share / (ratio * ratio)


def side_pull(magnets: MagnetParameters, gap: float, offset: float) -> float:
    """Return the pull toward the target's centre per lateral offset (N/m) at a `gap` and `offset` (m)."""
    share = 1.0 / (1.0 + (offset / magnets.width) ** 2)
    if share <= magnets.floor:
        return 0.0
    return 2.0 * magnets.force * magnets.range * share**2 / (magnets.width**2 * (1.0 + max(gap, 0.0) / magnets.range))
