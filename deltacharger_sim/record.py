# SPDX-License-Identifier: Apache-2.0
"""Records of a world for tests and reports, never for docking."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.pads.pad_source import Pose


@dataclass
class Record:
    """True events; for tests and reports, never for docking.

    Attributes:
        energised_shorts: number of shorts of live electrodes.
        energised_unsafe: s that the electrodes were live with negative clearance.
        energised: s that the electrodes were live: with closed contactor, or without contactor on the target;
            current is not needed.
        parted_live: number of times that live electrodes left the target.
        unpowered_live: number of times that a servo lost its torque while the electrodes were live.
        broken_current: largest current interrupted by the contactor, or by the electrodes if there is none, A.
        contacts: dockings, without bounces.
        peak_force: largest normal force, including impacts within a step, N.
        peak_push: largest force on the target along z without the magnets', N: of servos and impacts.
        lifted_live: number of times that one bar of live electrodes carried nothing while the other pressed.
        bar_heat: largest heat in one bar's contact, W.
        energy: into the target at the electrodes, J.
        port_shorted: s that a bar bridged a live port, whatever the contactor did.
    """

    energised_shorts: int = 0
    energised_unsafe: float = 0.0
    energised: float = 0.0
    parted_live: int = 0
    unpowered_live: int = 0
    broken_current: float = 0.0
    contacts: int = 0
    peak_force: float = 0.0
    peak_push: float = 0.0
    lifted_live: int = 0
    bar_heat: float = 0.0
    energy: float = 0.0
    port_shorted: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the values by name."""
        return dataclasses.asdict(self)


@dataclass(frozen=True)
class Snapshot:
    """The truth at one instant, for tests and reports: m, rad, N, A, charger_base; `misalignment` in end_effector."""

    time: float
    position: Vector
    misalignment: Pose | None
    contact_force: float
    push: float
    charge_current: float
    contactor_closed: bool
    clearance: float
