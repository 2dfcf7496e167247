# SPDX-License-Identifier: Apache-2.0
"""Solutions: the status of each point, the side of each knee (working mode) and of the platform (assembly)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from enum import IntFlag
from typing import Any

from deltacharger_core.texts import Picklable


class Status(IntFlag):
    """Bit mask per point; 0 is OK. The two .srv files define the same constants.

    With INVALID_INPUT, UNREACHABLE_*, INDETERMINATE, NOT_ASSEMBLABLE and DEGENERATE the result is NaN; with all others
    it is usable.
    """

    OK = 0
    INVALID_INPUT = 1
    UNREACHABLE_FAR = 2
    UNREACHABLE_NEAR = 4
    UNREACHABLE_LATERAL = 8
    NOT_ASSEMBLABLE = 16
    DEGENERATE = 32
    INDETERMINATE = 64
    WRONG_ASSEMBLY = 128
    NEAR_TYPE_1 = 256
    NEAR_TYPE_2 = 512
    JOINT_LIMIT = 1024
    SWING_LIMIT = 2048
    OUTSIDE_WORKSPACE = 4096
    LIMB_0 = 65536
    LIMB_1 = 131072
    LIMB_2 = 262144


UNREACHABLE = Status.UNREACHABLE_FAR | Status.UNREACHABLE_NEAR | Status.UNREACHABLE_LATERAL
NO_ANSWER = UNREACHABLE | Status.INVALID_INPUT | Status.INDETERMINATE | Status.NOT_ASSEMBLABLE | Status.DEGENERATE

NEAR_TYPE_1 = 0.02  # of the arm length: lever |b| below which a limb counts as nearly stretched or folded
NEAR_TYPE_2 = 0.02  # |det| of the unit rod vectors below which the platform counts as nearly unconstrained
COLLINEAR = 1e-12  # of rod or elbow distance: height of the elbows' triangle below which they count as collinear


class KinematicsError(Picklable, ValueError):
    """A strict solve found points whose status is not OK.

    Attributes:
        indices: flat indices of these points.
        statuses: their status, in the same order.
    """

    def __init__(self, indices: Sequence[int], statuses: Sequence[Status]) -> None:
        self.indices = list(indices)
        self.statuses = list(statuses)
        shown = ", ".join(
            f"point {index}: {status.name or repr(status)}"
            for index, status in list(zip(self.indices, self.statuses, strict=True))[:5]
        )
        more = f" and {len(self.indices) - 5} more" if len(self.indices) > 5 else ""
        super().__init__(f"{shown}{more}; move the points inside the workspace or solve with strict=False")


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
