# SPDX-License-Identifier: Apache-2.0
"""The status of each solved point."""

from __future__ import annotations

from enum import IntFlag


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
