# SPDX-License-Identifier: Apache-2.0
"""Parameters that reduce a docking from 25 s to 5 s and forgive a busy computer, for laws that hold at any speed."""

from dataclasses import replace
from typing import Any

from deltacharger_bringup.scenes.scene import Scene, load_scene
from deltacharger_driver.parameters import REPLY_MARGIN

from .waiting import host

STEPS = {
    "standoff": 0.008,
    "search_speed": 0.05,
    "press_speed": 0.05,
    "travel_speed": 0.3,
    "charge_stable_time": 0.2,
    "overlap_loss_max": 0.006,
    "landing_limit": 0.006,
}
"""Parameters of docking_node."""
PATIENT_MARGIN = min(host(REPLY_MARGIN), 0.05)
"""Of servo_node; with a longer one, lost replies cost too much time."""
PATIENT: dict[str, dict[str, Any]] = {
    "docking_node": {
        "age_max": 1.0,
        "live_servo_age_max": min(host(0.2), 0.5),  # the default at night: the contactor opens in time
    },
    "servo_node": {"reply_margin": PATIENT_MARGIN},
    "misalignment_node": {"max_age": 1.0, "timeout": 2.5},
    "electrode_detector_node": {"image_age_max": 10.0},
}
"""Parameters of each node that judges ages: a busy computer is not a broken cable."""
QUICK = {
    "simulation": {"seed": 1, "rig_seed": 1},
    "parameters": {
        "docking_node": {**STEPS, **PATIENT["docking_node"]},
        **{node: PATIENT[node] for node in ("servo_node", "misalignment_node")},
    },
}
"""Content of a scene: five nodes on a simulated charger whose target is exactly at the given pose."""


def quick_simulation(name: str) -> Scene:
    """Return a packaged scene of the simulated charger, quick and patient."""
    packaged = load_scene(name)
    quick = {node: {**packaged.parameters.get(node, {}), **given} for node, given in PATIENT.items()}
    quick["docking_node"] = {**STEPS, **PATIENT["docking_node"]}
    return replace(packaged, parameters={**packaged.parameters, **quick})
