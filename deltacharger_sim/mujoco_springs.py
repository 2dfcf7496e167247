# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's constraints as springs of a given stiffness.

A constraint that MuJoCo regularises with R = (1 − d)/d · A (A its estimate of the bodies' inverse weight) and pulls
back with solref = (−s, −b) is a spring of s/((1 − d) A) at rest, whatever else acts; s is chosen so that this is the
wanted stiffness, and b = 2√s. MuJoCo documentation, "Solver parameters".
"""

from __future__ import annotations

import math

IMPEDANCE = 0.9  # d of contacts and joint stops: how much of the solver's motion a constraint decides


def spring(stiffness: float, inverse: float) -> tuple[float, float]:
    """Return the solref of a constraint that is a spring of `stiffness` at rest, given its inverse weight."""
    s = stiffness * (1.0 - IMPEDANCE) * inverse
    return -s, -2.0 * math.sqrt(s)


def share_impedance(count: int) -> float:
    """Return the impedance of `count` equal constraints that together are as stiff as one of IMPEDANCE.

    In parallel, the R of all is that of one divided by `count`.
    """
    return 1.0 / (1.0 + count * (1.0 - IMPEDANCE) / IMPEDANCE)


def share(stiffness: float, inverse: float, count: int) -> tuple[float, float]:
    """Return the solref of each of `count` constraints that together are the spring and damper of `spring`."""
    softer = (1.0 - share_impedance(count)) / (1.0 - IMPEDANCE) / count
    s, b = spring(stiffness, inverse)
    return s * softer, b * softer
