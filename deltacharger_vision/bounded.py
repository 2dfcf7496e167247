# SPDX-License-Identifier: Apache-2.0
"""Frozen dataclasses whose every number declares its bounds, unit and source."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Any

from deltacharger_vision.errors import ParameterError


def value(default: Any, low: float, high: float, unit: str, doc: str) -> Any:
    """Return a dataclass field with bounds low…high in `unit`, described by `doc` (with its source)."""
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "doc": doc})


@dataclass(frozen=True)
class Bounded:
    """Checks every field made with `value`; an integer field takes whole numbers only.

    Raises:
        ParameterError: a value is not a number or out of bounds.
    """

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            if "low" not in item.metadata:
                continue
            found = getattr(self, item.name)
            low, high = item.metadata["low"], item.metadata["high"]
            allowed = int if isinstance(item.default, int) else int | float
            if isinstance(found, bool) or not isinstance(found, allowed) or not low <= found <= high:
                raise ParameterError(item.name, found, low, high, item.metadata["unit"])
