# SPDX-License-Identifier: Apache-2.0
"""Errors of the simulation, except wrong parameters, which are ParameterErrors."""

from __future__ import annotations

from deltacharger_core.picklable import Picklable


class SimulationError(Picklable):
    """Base class of deltacharger_sim's own errors."""


class TargetFixed(SimulationError, RuntimeError):
    """The target of this model cannot move. Example: `World.move_target` of MuJoCo's world.

    Args:
        model: of the arm's motion.
    """

    def __init__(self, model: str) -> None:
        self.model = model
        super().__init__(
            f"the target cannot move while {model} moves the arm: use a World of the light model, or place the "
            "target by the parameters of a new world"
        )
