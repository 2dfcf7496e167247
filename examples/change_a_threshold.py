# SPDX-License-Identifier: Apache-2.0
"""Change a threshold of docking and test each value on the same simulated dockings.

The targets are rolled by 8 to 11°, near the angle at which the electrodes would short, and up to 3 mm beside the goal.
For each value of `clearance_min` (m, the clearance that docking keeps between wrong electrodes) it prints how many
dockings charged, how long they took and the least clearance of those that charged. Set a value for a charger in its
scene file: `parameters: {docking_node: {clearance_min: 0.001}}`. All parameters and bounds: docs/parameters.md.

    python examples/change_a_threshold.py [clearance_min ...]
"""

import math
import random
import sys
from statistics import median

from deltacharger_core.parameters import ParameterError
from deltacharger_docking.parameters import DockingParameters
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

DOCKINGS = 20

for word in sys.argv[1:] or ["0.0003", "0.001", "0.002"]:
    try:
        parameters = DockingParameters(clearance_min=float(word))
    except (ValueError, ParameterError) as error:
        sys.exit(f"clearance_min {word}: {error}")
    times, least, unsafe = [], math.inf, 0.0
    for seed in range(DOCKINGS):
        drawn = random.Random(seed)
        x, y, roll = drawn.uniform(-0.003, 0.003), drawn.uniform(-0.003, 0.003), math.radians(drawn.uniform(8.0, 11.0))
        world = WorldParameters(target=TargetParameters(x=x, y=y, roll=roll))
        charger = VirtualCharger(world, parameters, seed, rig_seed=seed)
        outcome = charger.dock()
        unsafe += charger.world.record.energised_unsafe
        if outcome.success:
            times.append(outcome.elapsed)
            least = min(least, charger.world.snapshot().clearance)
    print(f"clearance_min {word} m: {len(times)} of {DOCKINGS} charged", end="")
    if times:
        print(f", median {median(times):.1f} s, least clearance {1000 * least:.1f} mm", end="")
    print(f", live without clearance for {unsafe:.1f} s")
