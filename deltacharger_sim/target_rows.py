# SPDX-License-Identifier: Apache-2.0
"""Kinds of charging ports, from config/target_kinds.yaml: how they behave, the profile that fits, the right ending."""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from deltacharger_core import environment
from deltacharger_core.yaml_file import read_yaml
from deltacharger_driver.emulators.power import PortParameters, StageParameters

Values = Mapping[str, Any]

LITHIUM_7S: Values = {"empty_voltage": 19.0, "full_voltage": 29.4, "current": 10.0, "end_current": 0.5}
FULL, UNTOUCHED, ENDED = "full", "untouched", "ended"
_FILLING: Values = {"voltage": [22.0, 27.0], "capacity": [150.0, 250.0], "resistance": [0.1, 0.2]}


@dataclass(frozen=True)
class TargetRow:
    """One kind.

    Attributes:
        text: what is seen.
        port, stage, circuit, profile: values that differ from the usual ones; a pair is a range.
        ends: the endings that are right.
        codes: names of docking's codes of the endings that are not full.
    """

    text: str
    port: Values = field(default_factory=dict)
    stage: Values = field(default_factory=dict)
    circuit: Values = field(default_factory=dict)
    profile: Values = field(default_factory=dict)
    ends: tuple[str, ...] = (FULL,)
    codes: tuple[str, ...] = ()


@dataclass(frozen=True)
class DrawnTarget:
    """One target drawn from a row: values of `CircuitParameters` and of docking's `TargetProfile` as mappings."""

    port: PortParameters
    stage: StageParameters
    circuit: Values
    profile: Values

    @property
    def full(self) -> float:
        """V of the battery itself when the profile calls it full."""
        return float(self.profile["full_voltage"]) - self.port.diode


ROWS = {name: TargetRow(**row) for name, row in read_yaml(environment.config("target_kinds.yaml")[0]).items()}


def usual(values: Values) -> dict[str, Any]:
    """Return a row's values with the middle of each range."""
    return {name: sum(value) / 2.0 if isinstance(value, list) else value for name, value in values.items()}


def draw_target(row: TargetRow, source: random.Random) -> DrawnTarget:
    """Draw a target from a row."""

    def drawn(values: Values) -> dict[str, Any]:
        return {name: source.uniform(*value) if isinstance(value, list) else value for name, value in values.items()}

    return DrawnTarget(
        PortParameters(**drawn({**_FILLING, **row.port})),
        StageParameters(**drawn(row.stage)),
        drawn(row.circuit),
        {**LITHIUM_7S, **row.profile},
    )
