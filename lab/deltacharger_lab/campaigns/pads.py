# SPDX-License-Identifier: Apache-2.0
"""The pads and the pose model of a campaign's dockings, by their names in its scene."""

from __future__ import annotations

import functools
from typing import Any

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.pads.pad_source import PadSource
from deltacharger_sim.pads.source import ContactSource
from deltacharger_tactile import PoseEstimator, default_model
from deltacharger_tactile.parameters import TactileParameters

FIRST, SECOND = "first", "second"
PADS = (FIRST, SECOND)
PACKAGED, FROM_ONE_NEWTON = "packaged", "1N"
POSE_MODELS = (PACKAGED, FROM_ONE_NEWTON)


def make_pads(
    pads: str, tactile: TactileParameters, second: SecondParameters | None, rig_seed: int, seed: int
) -> PadSource[Any]:
    """Return the pads of a docking.

    Args:
        pads: contact physics, one of `PADS`.
        tactile: family of rigs of the first physics.
        second: family of rigs of the second one; None = its defaults.
        rig_seed: seed of the device.
        seed: of noise and jitter.
    """
    if pads == SECOND:
        from deltacharger_lab.second.source import SecondSource

        return SecondSource(second, rig_seed, seed)
    return ContactSource(tactile, rig_seed, seed)


@functools.cache
def pose_model_from_one_newton() -> PoseEstimator:
    """Return the packaged pose model for sensors that read nothing below 1 N, read once per process."""
    return default_model(CONTACT_FORCE)
