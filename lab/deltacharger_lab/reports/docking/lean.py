# SPDX-License-Identifier: Apache-2.0
"""Dockings at leaning faces: by campaign, over yaw and pitch, with targets and bounds."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from deltacharger_core.machine import PAD_DISTANCE, PAD_YAW_STIFFNESS
from deltacharger_docking.codes import Code
from deltacharger_lab.campaigns.docking import CRASHED
from deltacharger_lab.reports.docking import summary
from deltacharger_lab.reports.docking.summary import Array, Columns, Figures
from deltacharger_lab.reports.report import at_least, at_most, none

SCENES = (
    *("default", "upright", "rigid", "lean2", "lean5", "lean5_stiff", "edge_lean", "parked"),
    *("second", "second_upright", "lean2_second", "lean5_second", "rigid_exact", "lean2_exact", "lean5_exact"),
)
"""Campaigns of the table, if they were run."""
MAP = ("lean5", "lean5_stiff")
"""Campaigns shown over yaw and pitch."""
SOON = 20.0  # s in which a target that is not charged must be refused
MODEST = 3.0  # degrees of yaw and of pitch
MOST = 5.0  # degrees of either in `MAP`
PRESSED = 72.0  # N on the bars: magnets 3 mm beside their centre (54 N) and the push of the servos
COMPLIANCES = (0.01, 0.02, 0.03)  # rad/(N·m), of the platform
LIFTS = {3e4: ("5.7", "5.7"), 1e5: ("3.0", "3.8"), 3e5: ("1.3", "2.1"), 1e6: ("0.7", "1.5")}
"""Degrees of pitch from which a complete bar lifts, by its spring (N/m): at 0.01 and at 0.03 rad/(N·m).

From the light model at rest (docs/reports/simulation.md, frozen); 5.7° is the largest lean of a world."""


class LeanLimits(NamedTuple):
    """Targets of a campaign; None = no target. Those of `default` are in `summary`.

    Attributes:
        charged: % of all.
        aligned: % of the charged that docking calls aligned.
        near: % of the charged that rest within 2.5 mm along x.
        seconds: s to charging, median.
    """

    charged: float
    aligned: float | None
    near: float
    seconds: float


LIMITS = {
    "rigid": LeanLimits(98.0, None, 93.0, 14.0),
    "lean2": LeanLimits(96.0, 80.0, 90.0, 14.0),
    "lean5": LeanLimits(60.0, None, 88.0, 16.0),
}
BEYOND_MOST = 0.5  # % of those that are called aligned
MODEST_LEAST = 90.0  # % charged of `lean5` up to `MODEST`


def lean(rows: Columns) -> tuple[Array, Array]:
    """Return |yaw| and |pitch| of the target's faces against the platform, degrees."""
    zero = np.zeros(len(rows["charged"]))
    yaw, pitch, heading = (
        rows.get(name, zero).astype(float) for name in ("world.target.tilt_y", "world.target.tilt_x", "parked.heading")
    )
    return np.degrees(np.abs(yaw - heading)), np.degrees(np.abs(pitch))


def figures(rows: Columns) -> Figures:
    """Return the figures of one campaign: rates, s, refusals, forbidden events, error of the reported offset."""
    charged = rows["charged"].astype(bool)
    aligned = charged & rows["aligned"].astype(bool)
    x, seconds = np.abs(rows["final_horizontal"].astype(float)), rows["time"].astype(float)
    named = ~np.isin(rows["code_name"], (CRASHED, Code.INTERNAL.name))
    soon, count = ~charged & named & (seconds <= SOON), len(charged)
    codes = summary.refused(rows)
    yaw, pitch = lean(rows)
    modest = (yaw <= MODEST) & (pitch <= MODEST)
    return {
        "n": count,
        "charged": summary.rate(int(charged.sum()), count),
        "modest": summary.rate(int((charged & modest).sum()), int(modest.sum())),
        "aligned": summary.rate(int(aligned.sum()), int(charged.sum())),
        "beyond": summary.rate(int((x[aligned] > summary.OVERLAP_LOSS).sum()), int(aligned.sum())),
        "near": summary.rate(int((x[charged] <= summary.NEAR).sum()), int(charged.sum())),
        "time": summary.quantiles(seconds[charged]),
        "leaning": codes.pop(Code.LEANING.name, 0),
        "others": codes,
        "untouched": int((~charged & (rows["contacts"] == 0)).sum()),
        "soon": summary.rate(int(soon.sum()), int((~charged).sum())),
        "unsafe": int(np.sum(rows["energised_unsafe"] > 0.0)),
        "lifted": int(np.sum(rows["lifted_live"] > 0)),
        "shorts": int(np.sum(rows["shorts"])),
        "bar_heat": summary.quantiles(rows["bar_heat"]),
        "reported": reported_offset_errors(rows),
    }


def reported_offset_errors(rows: Columns) -> Figures:
    """Return the errors of the offset along the bars that charged dockings reported at their outcome."""
    error = (rows["estimated_horizontal"] - rows["final_horizontal"]).astype(float)
    stddev = rows["estimated_horizontal_stddev"].astype(float)
    known = rows["charged"].astype(bool) & np.isfinite(error) & (stddev > 0.0)
    z = error[known] / stddev[known]
    size = {"n": len(z), "rms": math.nan, "max": math.nan, "error": math.nan, "stddev": math.nan}
    if len(z):
        rms = (float(np.sqrt(np.mean(values**2))) for values in (z, error[known], stddev[known]))
        size |= dict(zip(("rms", "error", "stddev"), rms, strict=True)) | {"max": float(np.abs(z).max())}
    return size


def by_lean(rows: Columns) -> list[list[Figures]]:
    """Return charged share and refusals by integer degrees: for each |yaw| a list with an entry for each |pitch|."""
    yaw, pitch = lean(rows)
    cells = []
    for low in range(int(MOST)):
        cells.append([_cell(rows, _degree(yaw, low) & _degree(pitch, each)) for each in range(int(MOST))])
    return cells


def _degree(values: Array, low: int) -> Array:
    return np.asarray(np.minimum(np.floor(values), MOST - 1.0) == low)


def _cell(rows: Columns, chosen: Array) -> Figures:
    inside = summary.part(rows, chosen)
    names = Counter(str(name) for name in inside["code_name"] if name != "NONE")
    hits, count = int(inside["charged"].sum()), len(inside["charged"])
    return {"share": hits / count if count else math.nan, "n": count, "refused": dict(names.most_common())}


def empty_yaws() -> list[tuple[float, float]]:
    """Return for each compliance (rad/(N·m)) the yaw (°) from which one pad is empty: N s (c + 1/κ)."""
    return [(each, math.degrees(PRESSED * PAD_DISTANCE * (each + 1.0 / PAD_YAW_STIFFNESS))) for each in COMPLIANCES]


def targets(found: dict[str, Figures]) -> Iterator[dict[str, Any]]:
    """Yield every target of leaning faces.

    Args:
        found: figures by the campaign's name; those that were not run are missing.
    """

    def share(name: str, key: str) -> float | None:
        return 100.0 * float(found[name][key]["share"]) if name in found else None

    for name, limits in LIMITS.items():
        yield at_least(f"charged, {name}", share(name, "charged"), limits.charged, "%")
        if limits.aligned is not None:
            yield at_least(f"called aligned of the charged, {name}", share(name, "aligned"), limits.aligned, "%")
        yield at_most(
            f"beyond {1e3 * summary.OVERLAP_LOSS:g} mm along the bars of what is called aligned, {name}",
            share(name, "beyond"),
            BEYOND_MOST,
            "%",
        )
        yield at_least(f"at rest within 2.5 mm along x, {name}", share(name, "near"), limits.near, "%")
        median = found[name]["time"]["median"] if name in found else None
        yield at_most(f"seconds to charging, {name}, median", median, limits.seconds, "s")
    yield at_least(f"charged, lean5, yaw and pitch up to {MODEST:g}°", share("lean5", "modest"), MODEST_LEAST, "%")
    yield at_least(
        f"refused by name within {SOON:g} s of what is not charged, lean5", share("lean5", "soon"), 100.0, "%"
    )
    for name in ("lean5", "edge_lean"):
        unsafe = found[name]["unsafe"] if name in found else None
        yield none(f"energised without clearance, {name}", unsafe, f"of {found.get(name, {}).get('n', 0)}")
    for key, what in (("lifted", "live with a lifted bar"), ("shorts", "shorts")):
        count = sum(each[key] for each in found.values()) if found else None
        yield none(f"{what}, campaigns of leaning faces", count, f"of {sum(each['n'] for each in found.values())}")
