# SPDX-License-Identifier: Apache-2.0
"""Numbers with units, formatted for people."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

_UNITS: dict[str, tuple[float, str, int]] = {
    "Nms_per_rad": (1.0, "N·m·s/rad", 2),
    "Nm_per_rad": (1.0, "N·m/rad", 1),
    "Nm": (1.0, "N·m", 2),
    "m": (1e3, "mm", 1),
    "rad": (180.0 / math.pi, "°", 1),
    "A": (1.0, "A", 2),
    "N": (1.0, "N", 1),
    "s": (1.0, "s", 2),
    "V": (1.0, "V", 1),
    "J": (1.0, "J", 0),
    "ohm": (1.0, "Ω", 0),
}
_STDDEV = "_stddev"


def in_unit(value: float, unit: str, digits: int | None = None) -> str:
    """Return an SI value with its unit for people: 0.0059 m is '5.9 mm'; 'unknown' for NaN."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "infinite"
    scale, name, usual = _UNITS[unit]
    kept = usual if digits is None else digits
    text = f"{round(scale * value, kept) + 0.0:.{kept}f}".replace("-", "−")  # + 0.0: no minus before a zero
    return f"{text}{'' if name == '°' else ' '}{name}"


def numbers(values: Mapping[str, float]) -> str:
    """Return the numbers of a decision, each with name, unit and, if known, standard deviation."""
    parts = []
    for name, value in values.items():
        unit = next((each for each in _UNITS if name.endswith(f"_{each}")), "")
        base = name.removesuffix(f"_{unit}")
        if base.endswith(_STDDEV):
            continue
        if not unit:
            parts.append(f"{name.replace('_', ' ')} {value:.3g}")
            continue
        text = f"{_label(base)} {in_unit(value, unit)}"
        spread = values.get(f"{base}{_STDDEV}_{unit}")
        parts.append(text if spread is None else f"{text} ± {in_unit(spread, unit)}")
    return ", ".join(parts)


def _label(base: str) -> str:
    return re.sub(r" (\d) sigma$", r" at \1σ", base.replace("_", " "))
