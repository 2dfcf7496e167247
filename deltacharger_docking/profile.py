# SPDX-License-Identifier: Apache-2.0
"""The profile of a target: what its port and battery are like, and within which limits it may be charged."""

from __future__ import annotations

import re
from dataclasses import dataclass

from deltacharger_core.parameters import Bounded, ParameterError, choice, number, words

PORTS = ("live", "dead")


@dataclass(frozen=True)
class TargetProfile(Bounded):
    """What one kind of target allows; docs/targets.md says how to find it with a multimeter.

    Raises:
        ParameterError: a value is missing or outside its bounds, or two contradict each other.
    """

    empty_voltage: float = number(0.0, 1.0, 60.0, "V", "voltage at the port below which the target must not be charged")
    full_voltage: float = number(0.0, 1.0, 60.0, "V", "voltage at the port when the target is full; never exceeded")
    current: float = number(0.0, 0.1, 18.0, "A", "largest current into the port")
    end_current: float = number(0.0, 0.05, 18.0, "A", "current at full voltage below which the target is full")
    least_current: float = number(
        0.5, 0.05, 0.5, "A", "current that counts as charging; less for a battery that trickles"
    )
    port: str = choice(
        "live", PORTS, "live: the battery's voltage lies at the port; dead: it may not, until a charger's does"
    )
    start_time: float = number(3.0, 1.0, 60.0, "s", "time from closing until the target takes current, at most")
    gap_time: float = number(0.2, 0.1, 120.0, "s", "time without current that is tolerated")
    standing_load: float = number(0.0, 0.0, 300.0, "W", "what the target itself uses while it is charged")

    def __post_init__(self) -> None:
        super().__post_init__()
        for lower, upper in (
            ("empty_voltage", "full_voltage"),
            ("end_current", "current"),
            ("least_current", "current"),
        ):
            if not getattr(self, lower) < getattr(self, upper):
                raise ParameterError(lower, getattr(self, lower), f"{lower} must lie below {upper}")

    @property
    def standing_current(self) -> float:
        """A of the standing load at full voltage."""
        return self.standing_load / self.full_voltage

    @property
    def rest_current(self) -> float:
        """A at full voltage below which the target is full."""
        return self.end_current + self.standing_current


@dataclass(frozen=True)
class ProfileNames(Bounded):
    """Which targets the installation knows; the parameters of each have its name as prefix.

    Raises:
        ParameterError: a name is given twice, or cannot be part of a parameter's name.
    """

    target_profiles: tuple[str, ...] = words((), "names of the targets' profiles, the first is the default")

    def __post_init__(self) -> None:
        super().__post_init__()
        for index, name in enumerate(self.target_profiles):
            if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
                raise ParameterError("target_profiles", name, f"'{name}': give letters, digits and _, a letter first")
            if name in self.target_profiles[:index]:
                raise ParameterError("target_profiles", name, f"'{name}' is listed twice")
