# SPDX-License-Identifier: Apache-2.0
"""MuJoCo with its users' settings, called "usual" in the report, compared with the world's own.

The world's MuJoCo gives contacts a stiffness at rest (`solref` negative) and switches off the guard that keeps time
constants at two steps or more (`refsafe`), so the stiffness is as requested at any step. A usual model keeps the
guard and MuJoCo's automatic reset, and gives positive time constants, here those of the same springs, critically
damped; if two steps are longer, the guard softens the contact instead of letting it diverge.
"""

from __future__ import annotations

import math
from typing import Any

from deltacharger_lab.mujoco.world import MujocoMechanics
from deltacharger_sim.world import World


def as_users_set_it(world: World) -> World:
    """Return the world with MuJoCo's usual settings."""
    mechanics = world.mechanics
    assert isinstance(mechanics, MujocoMechanics)
    import mujoco

    model: Any = mechanics.model
    for flag in (mujoco.mjtDisableBit.mjDSBL_REFSAFE, mujoco.mjtDisableBit.mjDSBL_AUTORESET):
        model.opt.disableflags &= ~int(flag)
    for rows in (model.pair_solref, model.jnt_solref):
        for row in rows:
            if row[0] < 0.0:
                row[:] = (1.0 / math.sqrt(-row[0]), 1.0)
    return world


def was_reset(world: World) -> bool:
    """Return whether MuJoCo met numbers that it could not continue with, and was reset."""
    data: Any = getattr(world.mechanics, "data", None)
    return data is not None and any(int(warning.number) for warning in data.warning)
