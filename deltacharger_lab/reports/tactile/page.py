# SPDX-License-Identifier: Apache-2.0
"""What the page of the tactile report asks for: names, and which models are best and slowest."""

from __future__ import annotations

from typing import Any

from deltacharger_lab.reports.tactile.ceiling import CEILING
from deltacharger_lab.reports.tactile.plan import TARGETS, kind, title
from deltacharger_lab.reports.tactile.splits import BY_FRAME, ROWS, SPLITS

__all__ = ["BY_FRAME", "CEILING", "ROWS", "SPLITS", "TARGETS", "title"]


def best(figures: dict[str, Any]) -> str:
    """Return the shallow model that tells the angle best; '' without any."""
    shallow: list[str] = [name for name in figures["models"] if kind(name) == "shallow"]
    return max(shallow, key=lambda name: figures["accuracy"][name]["angle"]["mean"], default="")


def slowest(figures: dict[str, Any]) -> str:
    """Return the model of the paper that takes longest to tell the angle."""
    paper: list[str] = [name for name in figures["models"] if kind(name) != "physical"]
    return max(paper, key=lambda name: figures["times"][name]["angle"]["median_ms"])
