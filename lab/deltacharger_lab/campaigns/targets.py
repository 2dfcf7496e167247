# SPDX-License-Identifier: Apache-2.0
"""Dockings that charge a target to its end, judged by the simulated battery: kinds of ports, foreign packs, gaps."""

import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from deltacharger_docking import observation, parameters
from deltacharger_sim.circuit import TARGET_KINDS
from deltacharger_sim.emulators.power import PortParameters, StageParameters
from deltacharger_sim.parameters import LITHIUM_7S, WorldParameters
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

LIMIT = 2400.0  # simulated s until charging must have ended
HEAT_MOST = 13.0  # W in one contact: 10 that docking allows; a clean contact, and growth that no dip has seen yet
GAPS_LAST = 600.0  # s of charging with gaps
_SHARE = 0.01  # of the full voltage, and of the energy
_OVER = 0.3  # V
_WRONG = ("VOLTAGE_OUT_OF_RANGE",)
_PACKS = {  # V, empty and full
    "lead_12V": (11.0, 14.4),
    "lithium_4S": (12.0, 16.8),
    "lithium_6S": (18.0, 25.2),
    "lead_24V": (22.0, 28.8),
    "iron_8S": (20.0, 29.2),
    "lithium_7S": (19.0, 29.4),
}

Values = Mapping[str, Any]

FULL, UNTOUCHED, ENDED = "full", "untouched", "ended"
_FILLING: Values = {"voltage": [22.0, 27.0], "capacity": [150.0, 250.0]}


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


ROWS = {name: TargetRow(**row) for name, row in TARGET_KINDS.items()}


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


COLUMNS: dict[str, tuple[type, str]] = {
    "behaviour": (str, "kind of the target; of a pair its pack and the profile's"),
    "charge_end": (str, "what ended charging, as docking says"),
    "charge_voltage": (float, "V of the target then, as docking says"),
    "battery": (float, "V of the target's battery without load then, truth"),
    "battery_full": (float, "V of it when the profile calls it full"),
    "energy_told": (float, "J into the target, as docking counts"),
    "energy": (float, "J, truth"),
    "port_shorted": (float, "s that a bar bridged the live port"),
    "ending": (str, "what the simulated battery shows: full; untouched by current; ended, not full"),
    "right": (bool, "whether that ending is right for this kind, with a true code and nothing overcharged"),
}
"""Result columns of a target, with type, unit and meaning."""


class TargetCase:
    """The target of one docking.

    Args:
        name: of its kind.
        row: what it is like, and the endings that are right.
        source: of what is drawn.
        stop_after: s of charging after which the goal ends; 0 = at the end of the charge.
    """

    def __init__(self, name: str, row: TargetRow, source: random.Random, stop_after: float = 0.0) -> None:
        self.name, self.row, self._stop_after = name, row, stop_after
        self.drawn: DrawnTarget = draw_target(row, source)
        self.profile = parameters.TargetProfile(**self.drawn.profile)

    def world(self, world: WorldParameters) -> WorldParameters:
        """Return a world with this target, stage and battery."""
        circuit = replace(world.circuit, **self.drawn.circuit)
        return replace(world, port=self.drawn.port, stage=self.drawn.stage, circuit=circuit)

    def goal(self, electrodes: observation.ElectrodePose) -> observation.DockGoal:
        """Return a goal that lasts until charging ends."""
        return observation.DockGoal(electrodes, hold=True, stop_after=self._stop_after)

    def judged(self, charger: VirtualCharger, outcome: observation.DockingOutcome) -> dict[str, Any]:
        """Return the columns about a docking that has ended."""
        record, battery = charger.world.record, charger.world.circuit.port.voltage
        heat = HEAT_MOST + self.profile.current**2 * self.drawn.port.film  # dirt before the ramp does not show
        was_live = record.energised > 0.0
        sound = not was_live or (battery <= self.profile.full_voltage + _OVER and record.bar_heat <= heat)
        ending = self._ending(outcome, battery, was_live)
        counted = abs(outcome.energy - record.energy) <= _SHARE * record.energy
        if self._stop_after:
            right = outcome.success and counted and sound
        else:
            right = ending in self.row.ends and (outcome.success or outcome.code.name in self.row.codes) and sound
        return {
            "behaviour": self.name,
            "charge_end": outcome.charge_end,
            "charge_voltage": outcome.charge_voltage,
            "battery": battery,
            "battery_full": self.drawn.full,
            "energy_told": outcome.energy,
            "energy": record.energy,
            "port_shorted": record.port_shorted,
            "ending": ending,
            "right": right,
        }

    def _ending(self, outcome: observation.DockingOutcome, battery: float, was_live: bool) -> str:
        if outcome.success and outcome.charge_end.startswith(FULL):
            is_full = abs(battery - self.drawn.full) <= _SHARE * self.drawn.full
            return FULL if is_full else f"told full at {battery:.2f} V"
        return ENDED if was_live else UNTOUCHED


def _kind(number: int, source: random.Random) -> TargetCase:
    """Return the next kind of target, with the profile that fits it."""
    name = list(ROWS)[number % len(ROWS)]
    return TargetCase(name, ROWS[name], source)


def _pair(_: int, source: random.Random) -> TargetCase:
    """Return a pack with the profile of another or the same kind; one whose voltage does not fit must be refused."""
    pack, profile = source.choice(list(_PACKS)), source.choice(list(_PACKS))
    (low, high), (empty, full) = _PACKS[pack], _PACKS[profile]
    voltage = source.uniform(low, high)
    fits = empty <= voltage <= full
    row = TargetRow(
        "a pack and a profile",
        {"voltage": voltage, "capacity": 20.0},
        profile={"empty_voltage": empty, "full_voltage": full},
        ends=(FULL, ENDED) if fits else (UNTOUCHED,),
        codes=("NO_CHARGE_CURRENT",) if fits else _WRONG,
    )
    return TargetCase(f"{pack} as {profile}", row, source)


def _gaps(_: int, source: random.Random) -> TargetCase:
    """Return a target whose current has gaps within the profile's limit for ten minutes."""
    longest = source.choice((0.02, 0.17, 5.0))
    port = {"gap_time": [0.001, longest], "gap_period": [0.05, 0.5 + 2.0 * longest], "capacity": 0.0}
    profile = {**LITHIUM_7S, "gap_time": max(0.2, 1.2 * longest)}
    return TargetCase(f"gaps up to {longest:g} s", TargetRow("gaps", port, profile=profile), source, GAPS_LAST)


CASES: dict[str, Callable[[int, random.Random], TargetCase]] = {"kinds": _kind, "pairs": _pair, "gaps": _gaps}
"""Makes the target of a docking by its number, by the scene's key `targets`."""


def nothing() -> dict[str, Any]:
    """Return the columns of a docking that crashed."""
    empty: dict[type, Any] = {float: float("nan"), str: "", bool: False}
    return {name: empty[kind] for name, (kind, _) in COLUMNS.items()}
