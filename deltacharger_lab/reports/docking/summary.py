# SPDX-License-Identifier: Apache-2.0
"""What the dockings of a report say: rates with intervals, refusals by cause, safety with its bound, targets."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.machine import GRAVITY_STRENGTH
from deltacharger_lab.campaigns.docking import CRASHED
from deltacharger_lab.campaigns.summary import upper_bound, wilson
from deltacharger_lab.reports.targets import at_least, at_most, none

Array = NDArray[Any]
Columns = dict[str, Array]

BINS = (0.0, 2.0, 5.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 15.0, 20.0)  # degrees of |roll|
UPRIGHT = 7.0  # degrees up to which all are to be charged
NEAR = 0.0025  # m in each axis
BAND = (0.4, 0.5)  # A
PUSH_MOST, HOTTEST_MOST, MOVES_MOST = 25.0, 0.6, 3
_QUANTILES = (0.5, 0.95, 0.99, 1.0)
AXES = ("horizontal", "vertical", "angle")


def columns(results: dict[str, list[Any]]) -> Columns:
    """Return the results of a campaign as arrays, and |roll| in degrees besides as `degrees`."""
    found = {name: np.asarray(values) for name, values in results.items()}
    found["degrees"] = np.degrees(np.abs(found["place_roll"].astype(float)))
    return found


def joined(parts: list[Columns], names: tuple[str, ...]) -> Columns:
    """Return the named columns of several campaigns behind one another."""
    return {name: np.concatenate([part[name] for part in parts]) for name in names}


def summarise(rows: Columns) -> dict[str, Any]:
    """Return the figures of one campaign; NaN where there is nothing to count."""
    charged = rows["charged"].astype(bool)
    count = len(charged)
    near = charged & (np.abs(rows["final_horizontal"]) <= NEAR) & (np.abs(rows["final_vertical"]) <= NEAR)
    rest = rows["rest_current"][charged & np.isfinite(rows["rest_current"])]
    band = (rest >= BAND[0]) & (rest <= BAND[1])
    unsafe = rows["energised_unsafe"] > 0.0
    live = rows["energised"] > 0.0
    return {
        "n": count,
        "charged": rate(int(charged.sum()), count),
        "refused": refused(rows),
        "crashed": int(np.sum(rows["code_name"] == CRASHED)),
        "near": rate(int(near.sum()), int(charged.sum())),
        "in_band": rate(int(band.sum()), len(rest)),
        "live": int(live.sum()),
        "unsafe": {**rate(int(unsafe.sum()), count), "bound": upper_bound(int(unsafe.sum()), count)},
        "unsafe_s": float(np.nansum(rows["energised_unsafe"])),
        "shorts": int(np.sum(rows["shorts"])),
        "parted_live": int(np.sum(rows["parted_live"])),
        "ended": dict(Counter(str(name) for name in rows["ended"] if name)),
        "rest_current": quantiles(rest),
        "rest_push": quantiles(rows["rest_push"][charged]),
        "hottest": quantiles(rows["servo_current_hottest"][charged]),
        "push": quantiles(rows["servo_push"]),
        "strike": quantiles(rows["peak_push"]),
        "moves": quantiles(rows["moves"][charged]),
        "time": quantiles(rows["time"][charged]),
        "time_refused": quantiles(rows["time"][~charged]),
        "misalignment": quantiles(rows["final_misalignment"]),
        "bins": by_angle(rows),
    }


def rate(hits: int, count: int) -> dict[str, Any]:
    """Return a share with its 95 % interval (Wilson)."""
    return {"hits": hits, "n": count, "share": hits / count if count else math.nan, "interval": wilson(hits, count)}


def quantiles(values: Array) -> dict[str, float]:
    """Return median, 95 %, 99 % and the largest of what is finite."""
    known = values.astype(float)
    known = known[np.isfinite(known)]
    found = np.quantile(known, _QUANTILES) if len(known) else np.full(len(_QUANTILES), np.nan)
    return dict(zip(("median", "p95", "p99", "max"), map(float, found), strict=True))


def refused(rows: Columns) -> dict[str, int]:
    """Return how often each code ended a docking that did not charge, the most frequent first."""
    codes = Counter(str(name) for name in rows["code_name"] if name not in ("NONE", CRASHED))
    return dict(codes.most_common())


def by_angle(rows: Columns) -> list[dict[str, Any]]:
    """Return charged share and refusals of each bin of |roll| that has dockings."""
    found = []
    for low, high in itertools.pairwise(BINS):
        inside = (rows["degrees"] >= low) & ((rows["degrees"] < high) | (high == BINS[-1]) & (rows["degrees"] <= high))
        if inside.any():
            part = {name: values[inside] for name, values in rows.items()}
            charged = rate(int(part["charged"].sum()), len(part["charged"]))
            unsafe = int(np.sum(part["energised_unsafe"] > 0.0))
            found.append({"low": low, "high": high, **charged, "refused": refused(part), "unsafe": unsafe})
    return found


def by_drawn(rows: Columns) -> list[dict[str, Any]]:
    """Return how dockings went in the lower, middle and upper third of each range that was drawn from."""
    offset = 1000.0 * np.maximum(np.abs(rows["place_x"] - rows["goal_x"]), np.abs(rows["place_y"] - rows["goal_y"]))
    drawn = (
        ("servo stiffness, N·m/rad", rows["world.servo.stiffness"].astype(float), (2.5, 6.0, 12.0, 20.0)),
        ("contact stiffness, N/m", rows["world.contact.stiffness"].astype(float), (1e4, 1e5, 1e6, 1e7)),
        ("offset at contact, mm", offset, (0.0, 4.0, 7.0, 10.0)),
        ("gravity along the push", rows["gravity_z"] / GRAVITY_STRENGTH, (-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0)),
    )
    found = []
    for name, values, edges in drawn:
        for low, high in itertools.pairwise(edges):
            inside = (values >= low - 1e-9) & (values < high + (1e-9 if high == edges[-1] else 0.0))
            part = {key: column[inside] for key, column in rows.items()}
            found.append({"name": name, "range": f"{low:.2g} to {high:.2g}", **_briefly(part)})
    return found


def by_tilt(rows: Columns) -> list[dict[str, Any]]:
    """Return how dockings went by the tilt (degrees) of the faces about y."""
    tilt = np.degrees(np.abs(rows["world.target.tilt_y"].astype(float)))
    found = []
    for low, high in itertools.pairwise((0.0, 0.1, 0.25, 0.5, 0.75, 1.0)):
        part = {key: column[(tilt >= low) & (tilt < high)] for key, column in rows.items()}
        error = part["last_horizontal_error"].astype(float)
        known = error[np.isfinite(error)]
        rms = 1000.0 * float(np.sqrt(np.mean(known**2))) if len(known) else math.nan
        found.append({"low": low, "high": high, "error": rms, **_briefly(part)})
    return found


def _briefly(rows: Columns) -> dict[str, Any]:
    each = summarise(rows) if len(rows["number"]) else None
    if each is None:
        nothing = rate(0, 0)
        return {"n": 0, "charged": nothing, "near": nothing, "time": math.nan, "moves": math.nan, "hottest": math.nan}
    numbers = {"time": each["time"]["median"], "moves": each["moves"]["median"], "hottest": each["hottest"]["p99"]}
    return {"n": each["n"], "charged": each["charged"], "near": each["near"], **numbers}


def calibration(rows: Columns) -> dict[str, dict[str, float]]:
    """Return how errors of the first and the last estimate compare with their σ: rms, largest and share beyond 3."""
    found = {}
    for which in ("first", "last"):
        for axis in AXES:
            error, stddev = rows[f"{which}_{axis}_error"].astype(float), rows[f"{which}_{axis}_stddev"].astype(float)
            known = np.isfinite(error) & (stddev > 0.0)
            z = error[known] / stddev[known]
            found[f"{which}_{axis}"] = {
                "n": len(z),
                "rms": float(np.sqrt(np.mean(z * z))) if len(z) else math.nan,
                "max": float(np.max(np.abs(z), initial=0.0)) if len(z) else math.nan,
                "beyond_3": float(np.mean(np.abs(z) > 3.0)) if len(z) else math.nan,
                "error_rms": float(np.sqrt(np.mean(error[known] ** 2))) if len(z) else math.nan,
            }
    return found


def felt_clearance(rows: Columns, sigmas: float) -> Array:
    """Return the clearance (m) that docking believed in at its last estimate, less so many standard deviations."""
    from deltacharger_docking.parameters import DockingParameters

    known = DockingParameters()
    gap, half = known.electrode_half_gap, known.electrode_half_length
    angle, vertical = rows["felt_angle"].astype(float), rows["felt_vertical"].astype(float)
    slope = gap * np.abs(np.sin(angle)) + half * np.cos(angle)
    spread = np.hypot(slope * rows["last_angle_stddev"], rows["last_vertical_stddev"])
    clear = gap * (1.0 + np.cos(angle)) - half * np.abs(np.sin(angle)) - np.abs(vertical)
    return np.asarray(clear - sigmas * spread)


def targets(found: dict[str, dict[str, Any]], upright: dict[str, Any] | None) -> list[dict[str, Any]]:
    """Return name, what is wanted, what was measured, its unit and whether it is met, of every target.

    Args:
        found: summaries by the campaign's name; those that were not run are missing.
        upright: of all dockings with magnets and |roll| up to `UPRIGHT`.
    """

    def share(of: dict[str, Any] | None, key: str) -> float | None:
        return None if of is None else 100.0 * float(of[key]["share"])

    def largest(key: str) -> float | None:
        return max((each[key]["max"] for each in guarded), default=None)

    def unsafe(name: str) -> tuple[int | None, str]:
        hits = found[name]["unsafe"]["hits"] if name in found else None
        return hits, f"of {found.get(name, {}).get('n', 0)}"

    guarded = [found[name] for name in ("random", "upright", "edge", "soft") if name in found]
    shorts = sum(each["shorts"] for each in guarded) if guarded else None
    crashed = sum(each["crashed"] for each in found.values()) if found else None
    moves = found["random"]["moves"]["median"] if "random" in found else None
    return [
        at_least(f"charged, angle up to ±{UPRIGHT:g}°", share(upright, "charged"), 99.5, "%"),
        at_least("charged with both axes within 2.5 mm", _pooled(guarded, "near"), 99.0, "%"),
        none("energised without clearance, random scenes", *unsafe("random")),
        none("energised without clearance, scenes at 8–11°", *unsafe("edge")),
        none("shorts, guarded", shorts, f"of {sum(each['n'] for each in guarded)}"),
        at_least("contact current at rest in 0.4–0.5 A", _pooled(guarded, "in_band"), 99.0, "%"),
        at_most("largest push of the servos in contact", largest("push"), PUSH_MOST, "N"),
        at_most("hottest servo while charging, largest", largest("hottest"), HOTTEST_MOST, "A"),
        at_most("alignment moves, median", moves, MOVES_MOST, ""),
        none("dockings that crashed", crashed, f"of {sum(each['n'] for each in found.values())}"),
    ]


def _pooled(parts: list[dict[str, Any]], key: str) -> float | None:
    count = sum(part[key]["n"] for part in parts)
    return 100.0 * float(sum(part[key]["hits"] for part in parts)) / count if count else None
