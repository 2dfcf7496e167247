# SPDX-License-Identifier: Apache-2.0
"""The paper's protocol with few dockings, because each costs a third of a millisecond."""

import itertools
from collections.abc import Sequence

import numpy as np

from deltacharger_sim.pads import _generate
from deltacharger_tactile.dataset import SUBSET_ANGLE, SUBSET_POSITION, Dataset
from deltacharger_tactile.parameters import ANGLE_CLASSES, POSITION_CLASSES, TactileParameters


def small_paper(
    rigs: Sequence[int] = (301,),
    seed: int = 5,
    threshold: float = 1.0,
    parameters: TactileParameters | None = None,
    angles: int = 40,
    positions: int = 8,
) -> Dataset:
    """Dock `angles` times at each angle and `positions` times at each position."""
    starts = 4e-4 * np.random.default_rng(seed).integers(-5, 6, (angles * ANGLE_CLASSES, 2))
    turns = [(x, y, np.radians(row % ANGLE_CLASSES)) for row, (x, y) in enumerate(starts)]
    places = [(x, y, 0.0) for x, y in itertools.product(POSITION_CLASSES, repeat=2)] * positions
    subset = np.repeat([SUBSET_ANGLE, SUBSET_POSITION], [len(turns), len(places)])
    poses = [np.array([*turns, *places])] * len(rigs)
    return _generate("paper", parameters, rigs, poses, subset, seed, 1, threshold)
