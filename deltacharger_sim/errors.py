# SPDX-License-Identifier: Apache-2.0
"""What the simulation can fail with beside wrong parameters, which are ParameterErrors."""

from __future__ import annotations

from deltacharger_core.picklable import Picklable


class SimulationError(Picklable):
    """Root of every error of deltacharger_sim's own."""


class TargetFixed(SimulationError, RuntimeError):
    """The target of this model cannot move. Example: `World.move_target` of MuJoCo's world.

    Args:
        model: of the arm's motion.
    """

    def __init__(self, model: str) -> None:
        self.model = model
        super().__init__(
            f"the target cannot move while the arm is moved by {model}; use a World of the light model, or put the "
            "target elsewhere by the parameters of a new world"
        )
