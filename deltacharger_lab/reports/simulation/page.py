# SPDX-License-Identifier: Apache-2.0
"""What the page of the simulation's report says of several runs together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from deltacharger_lab.reports.formats import fixed
from deltacharger_lab.reports.simulation.energy import PARTS
from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_lab.reports.simulation.stability import DIVERGED, FORCE_OFF, MODULE, PATH_OFF, PROVEN

Row = dict[str, Any]
__all__ = ["DIVERGED", "FORCE_OFF", "LIGHT", "MODULE", "PARTS", "PATH_OFF", "PROVEN"]


def is_calm(row: Row) -> bool:
    """Return whether a run neither diverged nor moves at its end."""
    return row["rms_mm"] is not None and row["speed"] is not None and row["speed"] < 1e-3


def settled(errors: Iterable[Row]) -> list[float]:
    """Return the forces (N) at which runs with friction came to rest, at steps up to 10 ms."""
    return [row["force_rubbing"] for row in errors if is_calm(row) and row["step"] <= 0.01 if row["force_rubbing"] > 0]


def grouped(rows: Iterable[Row], *keys: str) -> list[tuple[tuple[Any, ...], list[Row]]]:
    """Return rows with the same values of `keys` together, in the order of the first of them."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(found.items())


def ends(runs: Sequence[Row]) -> list[str]:
    """Return codes, and means over the dockings that charged: time (s), contact current (A), misalignment (mm)."""
    codes = ", ".join("charged" if run["code"] == "NONE" else run["code"] for run in runs)
    charged = [run for run in runs if run["code"] == "NONE"]
    columns = (("elapsed", 1), ("current", 3), ("rest_mm", 2))
    return [codes, *(fixed(_mean([run[key] for run in charged]), digits) for key, digits in columns)]


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def shorts(runs: Iterable[Row]) -> int:
    """Return how often wrong bars touched while energised."""
    return sum(run.get("shorts", 0) for run in runs)


def kept(row: Row) -> str:
    """Return whether an extreme scene kept its law."""
    return "kept" if row["ok"] else "BROKEN"
