# SPDX-License-Identifier: Apache-2.0
"""Pull of the six magnets between the terminals."""

from __future__ import annotations

from deltacharger_sim.parameters import MagnetParameters


def pull(magnets: MagnetParameters, gap: float, offset: float) -> tuple[float, float]:
    """Return the pull (N, toward the target) and its stiffness −dF/dgap (N/m) at a `gap` and lateral `offset` (m)."""
    share = max(magnets.floor, 1.0 / (1.0 + (offset / magnets.width) ** 2))
    ratio = 1.0 + max(gap, 0.0) / magnets.range
    force = magnets.force * share / (ratio * ratio)
    return force, 2.0 * force / (ratio * magnets.range) if gap > 0.0 else 0.0
