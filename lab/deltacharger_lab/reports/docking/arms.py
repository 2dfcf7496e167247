# SPDX-License-Identifier: Apache-2.0
"""Dockings of arms with wrong assumed parameters, and of calibrated arms."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from deltacharger_core.machine import SERVO_STIFFNESS
from deltacharger_docking.codes import Code
from deltacharger_lab.reports.docking import summary
from deltacharger_lab.reports.docking.summary import Array, Columns, Figures
from deltacharger_lab.reports.report import at_least, at_most, none

STIFFNESS = ("assumed_stiffness", "assumed_stiffness_exact")
"""Campaigns in which docking assumes a quarter to four times the servos' true stiffness."""
SCENES = ("default", *STIFFNESS, "soft_servos", "assumed_torque_constant", "calibrated")
"""Campaigns of the table, if they were run."""
BINS = (2.0, 3.0, 6.0, 12.0, 25.0, 40.0)  # N·m/rad
CHARGED_LEAST, BAND_LEAST, SECONDS_MOST = 99.0, 99.0, 12.0  # %, % and s
PUSH_MOST = {"assumed_torque_constant": 25.0, "calibrated": 5.0}  # %, of 95 in 100


def figures(rows: Columns) -> Figures:
    """Return the figures of one campaign: charged, stuck, band, s, and errors of the reported push and stiffness."""
    charged = rows["charged"].astype(bool)
    total = summary.summarise(rows)
    true = stiffness(rows)
    return {
        **{name: total[name] for name in ("n", "charged", "in_band", "time", "refused")},
        "stuck": total["refused"].get(Code.STUCK.name, 0),
        "unsafe": total["unsafe"]["hits"],
        "shorts": total["shorts"],
        "push": _sizes((rows["reported_push"] / rows["true_push"] - 1.0)[charged]),
        "stiffness": _sizes((rows["assumed_stiffness"] / true - 1.0)[charged]),
        "bins": [
            {"low": low, "high": high, "charged": each["charged"], "time": each["time"], "n": each["n"]}
            for low, high, inside in summary.binned(rows, true, BINS)
            if len(inside["charged"])
            for each in (summary.summarise(inside),)
        ],
    }


def stiffness(rows: Columns) -> Array:
    """Return the true stiffness of the servos, N·m/rad."""
    zero = np.full(len(rows["charged"]), SERVO_STIFFNESS)
    return np.asarray(rows.get("world.servo.stiffness", zero), dtype=float)


def _sizes(errors: Array) -> dict[str, float]:
    """Return median, 95 % and the largest size of relative errors, in %."""
    sizes = 100.0 * np.abs(errors.astype(float))
    known = sizes[np.isfinite(sizes)]
    values = np.quantile(known, (0.5, 0.95, 1.0)) if len(known) else np.full(3, np.nan)
    return dict(zip(("median", "p95", "max"), map(float, values), strict=True))


def targets(found: dict[str, Figures]) -> Iterator[dict[str, Any]]:
    """Yield every target of arms with wrong assumed parameters.

    Args:
        found: figures by the campaign's name; those that were not run are missing.
    """

    def share(name: str, key: str) -> float | None:
        return 100.0 * float(found[name][key]["share"]) if name in found else None

    for name in STIFFNESS:
        each = found.get(name)
        yield at_least(f"charged, {name}", share(name, "charged"), CHARGED_LEAST, "%")
        yield none(f"STUCK, {name}", None if each is None else each["stuck"], f"of {each['n'] if each else 0}")
        yield at_least(f"contact current at rest in 0.4–0.5 A, {name}", share(name, "in_band"), BAND_LEAST, "%")
        median = None if each is None else each["time"]["median"]
        yield at_most(f"seconds to charging, {name}, median", median, SECONDS_MOST, "s")
    for name, most in PUSH_MOST.items():
        yield at_least(f"contact current at rest in 0.4–0.5 A, {name}", share(name, "in_band"), 100.0, "%")
        error = found[name]["push"]["p95"] if name in found else None
        yield at_most(f"error of the reported push, {name}, 95 % of dockings", error, most, "%")
