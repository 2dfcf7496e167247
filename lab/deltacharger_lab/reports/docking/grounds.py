# SPDX-License-Identifier: Apache-2.0
"""Basis of the docking report: the seeds of its rules, and the headline figures in other worlds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

CHOSEN = (5, 19)
"""Seeds on which most of docking's rules and constants were chosen; comments beside the others name theirs."""


class OtherWorld(NamedTuple):
    """A campaign to compare with the one of a headline."""

    name: str
    about: str


WORLDS = (
    OtherWorld("default", "the headline's conditions"),
    OtherWorld("strike", "every tick and frame computed"),
    OtherWorld("real_arm", "an arm as others measured theirs"),
    OtherWorld("worn_arm", "the same arm, worn"),
    OtherWorld("yielding", "robots that give way"),
    OtherWorld("random", "everything at once"),
    OtherWorld("second", "contact physics that no estimator has seen"),
    OtherWorld("second_1N", "the same, by the pose model for sensors from 1 N on"),
    OtherWorld("second_sensitive", "that physics, sheets that read forces from 0.25 N on"),
    OtherWorld("random_second", "`random` on that physics"),
    OtherWorld("assumed_stiffness", "assumed servo stiffness wrong by up to a factor of 4"),
    OtherWorld("assumed_stiffness_exact", "the same, every tick and frame computed"),
    OtherWorld("assumed_torque_constant", "assumed torque constant wrong by 20 %"),
    OtherWorld("assumed_gravity", "assumed gravity wrong by up to 10°"),
    OtherWorld("assumed_geometry", "assumed geometry of the arm wrong"),
    OtherWorld("high_row", "a row of taxels reads high after the tare"),
    OtherWorld("parked", "the robot stands askew by up to 5°"),
    OtherWorld("nudged", "the target is moved while it charges"),
    OtherWorld("rigid", "the platform does not yield"),
    OtherWorld("lean2", "the target's faces yawed by up to 2°"),
    OtherWorld("lean5", "yawed and pitched by up to 5° each, springs of 3e4 and 1e5 N/m"),
    OtherWorld("lean5_stiff", "the same, springs of 3e5 N/m"),
    OtherWorld("second_upright", "`upright` on the contact physics that no estimator has seen"),
    OtherWorld("lean2_second", "`lean2` on that physics"),
    OtherWorld("lean5_second", "`lean5` on that physics"),
)
"""The campaigns of the table "What the headlines rest on", if they were run."""


def worlds(parts: Mapping[str, Mapping[str, Any]]) -> Iterator[tuple[OtherWorld, Mapping[str, Any]]]:
    """Yield each campaign that was run, with its summary."""
    for world in WORLDS:
        if world.name in parts:
            yield world, parts[world.name]
