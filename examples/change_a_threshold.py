# SPDX-License-Identifier: Apache-2.0
"""Change a threshold of docking and test each value on the same simulated dockings.

The targets are rolled by 8 to 11°, near the angle at which the electrodes would short. For each value of
`clearance_min` (m, the clearance that docking keeps between wrong electrodes) it prints how many dockings charged, how
long they took and the least clearance of those that charged. Set a value for a charger in its scene file:
`parameters: {docking_node: {clearance_min: 0.001}}`. All parameters and bounds: docs/parameters.md.

    python examples/change_a_threshold.py [clearance_min ...]
"""

from __future__ import annotations

import sys
from statistics import median

from deltacharger_core.parameters import ParameterError
from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.scene import parse_campaign_scene

DOCKINGS, SEED = 20, 7

for word in sys.argv[1:] or ["0.0003", "0.001", "0.002"]:
    try:
        scene = parse_campaign_scene({"based_on": "edge", "docking": {"clearance_min": float(word)}}, "example")
    except (ValueError, ParameterError) as error:
        sys.exit(f"clearance_min {word}: {error}")
    rows = [dock_once(scene, SEED, number) for number in range(DOCKINGS)]
    charged = [row for row in rows if row["charged"]]
    print(f"clearance_min {word} m: {len(charged)} of {DOCKINGS} charged", end="")
    if charged:
        least = 1000 * min(row["clearance"] for row in charged)
        print(f", median {median(row['time'] for row in charged):.1f} s, least clearance {least:.1f} mm", end="")
    print(f", live without clearance for {sum(row['energised_unsafe'] for row in rows):.1f} s")
