# SPDX-License-Identifier: Apache-2.0
"""Tables of parameters without a node: the simulation's models and the keys of campaigns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from deltacharger_core.parameters import Declaration, declared
from deltacharger_docking.parameters import TargetProfile
from deltacharger_lab.campaigns.keys import FACTS, PARTS, known_keys
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.parameters import WorldParameters


def sections() -> str:
    """Return the tables of all models and of campaigns, as sections of Markdown."""
    second = [key for key in declared(SecondParameters) if not f"second.{key.name}".startswith(FACTS)]
    parts = tuple(f"{name}." for name in PARTS if name)
    campaigns = [key for name, key in known_keys().items() if not name.startswith(parts)]
    tables = {
        "Target profiles": declared(TargetProfile),
        "Simulated world": declared(WorldParameters),
        "Second contact physics": second,
        "Campaign scenes": campaigns,
    }
    return "\n".join(_table(title, keys) for title, keys in tables.items())


def _table(title: str, keys: Iterable[Declaration]) -> str:
    lines = [f"## {title}", "", "| key | default | allowed | unit | meaning |", "|---|---|---|---|---|"]
    for key in keys:
        default = "must be given" if key.problem(key.default) else text(key.default)
        lines.append(f"| {key.name} | {default} | {_allowed(key)} | {key.unit} | {key.text} |")
    return "\n".join([*lines, ""])


def _allowed(key: Declaration) -> str:
    if key.choices:
        return f"one of: {', '.join(key.choices)}"
    return "" if key.kind is bool else f"{key.low:.6g} … {key.high:.6g}"


def text(value: Any) -> str:
    """Return a default in the page's format."""
    if value is None:
        return "none"
    if isinstance(value, str):
        return value or "(empty)"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bool | int):
        return str(value).lower()
    return ", ".join(text(item) for item in value)
