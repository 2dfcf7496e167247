# SPDX-License-Identifier: Apache-2.0
"""Names before 1.0.0 and what replaces each: the refusal of an old name states the new one."""

from __future__ import annotations

from types import MappingProxyType

RENAMED = MappingProxyType(
    {
        "contact_speed": "search_speed and press_speed",
        "landing_felt_sigmas": "aligned_risk_max",
        "landing_sigmas": "aligned_risk_max",
        "load_max": "pad_force_min",
        "redockings_max": "restarts_max",
        "response_told": "response_visible",
        "slept_max": "pause_max",
        "slip_taken_back": "slip_undo_share",
        "told": "assumed",
        "told_geometry": "assumed_geometry",
        "told_gravity": "assumed_gravity",
        "told_stiffness": "assumed_stiffness",
        "told_torque_constant": "assumed_torque_constant",
        "unmeasured": "assumed_stiffness",
    }
)
"""Parameters of docking_node, keys and names of campaigns before 1.0.0, and what replaces each."""
