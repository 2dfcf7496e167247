# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's constraints as springs of a given stiffness.

MuJoCo regularises a constraint with R = (1 − d)/d · A (A its estimate of the bodies' inverse weight) and restores it
with solref = (−s, −b). Such a constraint is a spring of s/((1 − d) A) at rest, regardless of other forces. s is chosen
for the wanted stiffness, and b = 2√s. MuJoCo documentation, "Solver parameters".
"""

from __future__ import annotations

import math

IMPEDANCE = 0.9  # d of contacts and joint stops: share of the solver's motion that a constraint decides


def spring(stiffness: float, inverse: float) -> tuple[float, float]:
    """Return the solref that makes a constraint a spring of `stiffness` at rest, given its inverse weight."""
    s = stiffness * (1.0 - IMPEDANCE) * inverse
    return -s, -2.0 * math.sqrt(s)


def share_impedance(count: int) -> float:
    """Return the impedance of `count` equal constraints that together are as stiff as one with IMPEDANCE.

    In parallel, their R is one constraint's divided by `count`.
    """
    return 1.0 / (1.0 + count * (1.0 - IMPEDANCE) / IMPEDANCE)


def share(stiffness: float, inverse: float, count: int) -> tuple[float, float]:
    """Return the solref of each of `count` constraints that together act as the spring and damper of `spring`."""
    softer = (1.0 - share_impedance(count)) / (1.0 - IMPEDANCE) / count
    s, b = spring(stiffness, inverse)
    return s * softer, b * softer
