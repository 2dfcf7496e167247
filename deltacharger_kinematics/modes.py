# SPDX-License-Identifier: Apache-2.0
"""Selection of a solution: side of each knee (working mode), and side of the platform (assembly)."""

from __future__ import annotations

import itertools
from typing import Any

WorkingMode = tuple[int, int, int]

KNEE_OUT: WorkingMode = (-1, -1, -1)
"""All elbows outward; +1 turns a limb's elbow inward. The σ of the formulas."""

WORKING_MODES: tuple[WorkingMode, ...] = tuple(itertools.product((-1, 1), repeat=3))  # type: ignore[arg-type]
"""All eight solutions of the inverse kinematics, KNEE_OUT first."""

AHEAD = 1
"""Platform on the side of the elbows' plane to which (c₁ − c₀) × (c₂ − c₀) points: +z in the workspace."""

BEHIND = -1
"""The mirror assembly."""


def check_modes(working_mode: Any, assembly: Any) -> None:
    """Check working mode and assembly.

    Raises:
        ValueError: names the argument.
    """
    if working_mode not in WORKING_MODES:
        raise ValueError(f"working_mode is {working_mode!r}: give a tuple of three, each -1 (knee out) or +1 (knee in)")
    if assembly not in (AHEAD, BEHIND):
        raise ValueError(f"assembly is {assembly!r}: give +1 (ahead of the elbows) or -1 (behind)")
