# SPDX-License-Identifier: Apache-2.0
"""Every key that the scene of a campaign may set: those of its own, and all of world, pads and docking."""

from __future__ import annotations

import dataclasses
import functools
import math
import typing
from typing import Any

from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.spread import Key
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile.parameters import TactileParameters

_OWN = {
    "target.x": Key(-0.06, 0.06, "m", "where the target stands, from (0, 0, 80 mm) of charger_base", 0.0),
    "target.y": Key(-0.06, 0.06, "m", "the same along y, +y up", 0.0),
    "target.z": Key(-0.04, 0.03, "m", "the same along z, away from the robot", 0.0),
    "target.roll": Key(-0.6, 0.6, "rad", "about z, from +x to +y", 0.0),
    "shift.x": Key(-0.03, 0.03, "m", "how far the target has moved at contact, unseen by the camera", 0.0),
    "shift.y": Key(-0.03, 0.03, "m", "the same along y", 0.0),
    "shift.z": Key(-0.03, 0.03, "m", "the same along z", 0.0),
    "shift.roll": Key(-0.6, 0.6, "rad", "the same about z", 0.0),
    "shift.limit": Key(
        0.001, 0.06, "m", "largest offset from goal to target along x and along y; errors of vision beyond are redrawn"
    ),
    "shift.beyond_zero": Key(
        -0.2, 0.2, "rad", "roll of the target beyond that of no clearance at its vertical offset, either sign"
    ),
    "camera.position_stddev": Key(0.0, 0.02, "m", "error of a detection, per axis, drawn for each docking", 0.0),
    "camera.roll_stddev": Key(0.0, 0.2, "rad", "error of its roll", 0.0),
    "hand_eye.position_stddev": Key(0.0, 0.02, "m", "error of the camera's believed place, per axis", 0.0),
    "hand_eye.rotation_stddev": Key(0.0, 0.1, "rad", "error of its believed orientation, per axis", 0.0),
    "gravity.tilt": Key(0.0, math.pi, "rad", "of the robot: angle between gravity and −y of charger_base", 0.0),
    "gravity.azimuth": Key(-math.pi, math.pi, "rad", "direction of that tilt about −y: 0 = toward +z", 0.0),
    "gravity.anywhere": Key(0.0, 1.0, "", "whether gravity points anywhere, each direction as likely", False, bool),
    "gravity.known": Key(0.0, 1.0, "", "whether docking is told the tilt", False, bool),
    "estimator.position_stddev": Key(0.0, 0.01, "m", "noise added to each estimate along x and y", 0.0),
    "estimator.angle_stddev": Key(0.0, 0.2, "rad", "noise added to each estimate's angle", 0.0),
    "estimator.bias_horizontal": Key(-0.01, 0.01, "m", "added to each estimate along x", 0.0),
    "estimator.bias_vertical": Key(-0.01, 0.01, "m", "added to each estimate along y", 0.0),
    "estimator.bias_angle": Key(-0.2, 0.2, "rad", "added to each estimate's angle", 0.0),
    "estimator.stddev_scale": Key(0.1, 10.0, "", "by which each estimate's standard deviations are multiplied", 1.0),
    "estimator.tail": Key(
        2.1, 1e6, "", "errors are Student's t of so many degrees, as wide as the standard deviations, not the pads' own"
    ),
    "estimator.paper": Key(
        0.0, 1.0, "", "whether estimates are the classes of the paper's CNN, taken as sure", False, bool
    ),
}
TAKEN = {
    "world.target.x": "give target.x (seen) and shift.x (unseen)",
    "world.target.y": "give target.y (seen) and shift.y (unseen)",
    "world.target.z": "give target.z (seen) and shift.z (unseen)",
    "world.target.roll": "give target.roll (seen) and shift.roll (unseen)",
    "world.gravity_x": "give gravity.tilt and gravity.azimuth",
    "world.gravity_y": "give gravity.tilt and gravity.azimuth",
    "world.gravity_z": "give gravity.tilt and gravity.azimuth",
    "world.step": "a campaign steps the world itself",
    "docking.servo_stiffness": "it follows world.servo.stiffness",
    "docking.gravity_x": "give gravity.tilt and gravity.known",
    "docking.gravity_y": "give gravity.tilt and gravity.known",
    "docking.gravity_z": "give gravity.tilt and gravity.known",
    "docking.approach": "give --approach",
}
"""Keys of the parts that a campaign sets itself, and what to write instead."""
DERIVED = {"gravity.anywhere": ("gravity.tilt", "gravity.azimuth"), "shift.beyond_zero": ("shift.roll",)}
"""Keys that draw others, which then are not given."""


@functools.cache
def known_keys() -> dict[str, Key]:
    """Return every key with its bounds, by its dotted name."""
    keys = dict(_OWN)
    for section, part in (("world", WorldParameters), ("tactile", TactileParameters), ("docking", DockingParameters)):
        keys |= {name: key for name, key in _of_part(section, part).items() if name not in TAKEN}
    return keys


def _of_part(path: str, cls: Any) -> dict[str, Key]:
    hints = typing.get_type_hints(cls)
    keys: dict[str, Key] = {}
    for item in dataclasses.fields(cls):
        name, hint, about = f"{path}.{item.name}", hints[item.name], item.metadata
        if dataclasses.is_dataclass(hint):
            keys |= _of_part(name, hint)
        elif hint is bool:
            keys[name] = Key(0.0, 1.0, "", about.get("doc", about.get("description", "")), None, bool)
        elif hint in (int, float) and "low" in about:
            doc = about.get("doc", about.get("description", ""))
            keys[name] = Key(about["low"], about["high"], about.get("unit", ""), doc, None, hint)
    return keys
