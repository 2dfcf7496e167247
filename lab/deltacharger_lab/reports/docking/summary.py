# SPDX-License-Identifier: Apache-2.0
"""Summary of a report's dockings: rates with intervals, refusals by cause, safety with its bound, targets."""

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.machine import GRAVITY_STRENGTH
from deltacharger_lab.campaigns.docking import CRASHED
from deltacharger_lab.campaigns.summary import quantiles as finite_quantiles, upper_bound, wilson
from deltacharger_lab.reports import formats, report

Array = NDArray[Any]
Columns = dict[str, Array]
Figures = dict[str, Any]

BINS = (0.0, 2.0, 5.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 15.0, 20.0)  # degrees of |roll|
UPRIGHT = 7.0  # degrees up to which all must be charged
NEAR = 0.0025  # m in each axis; docking's landing_limit
OVERLAP_LOSS = 0.004  # m along the bars; docking's overlap_loss_max
HOLDS = 25.0  # N at which brakes may slip without losing a docking
BAND = (0.4, 0.5)  # A
PUSH_MOST, HOTTEST_MOST = 25.0, 0.6
STRIKE_MOST = {"max": 120.0}
"""N, what exact dockings of `default` gave while simulated servos braked by back-EMF."""
SECONDS_MOST = {
    "default": {"median": 8.5},
    "real_arm": {"median": 10.0},
    "worn_arm": {"median": 14.0},
    "yielding": {"median": 10.0},
    "random": {"median": 10.0, "p99": 30.0},
    "edge": {"median": 12.5},
    "soft_servos": {"median": 15.0, "p99": 30.0},
}
ARMS = {"default": (99.9, 98.0, 98.0), "real_arm": (99.0, 90.0, 97.0), "worn_arm": (90.0, 80.0, 95.0)}
"""Least share (%) charged, aligned of these, and with the true force in the told interval."""
MOVES_MOST = {"median": 1, "p99": 3, "max": 14}
QUANTILES = {"median": "median", "p90": "90 %", "p99": "99 %", "max": "largest"}
AXES = {"horizontal": (1000.0, " mm"), "vertical": (1000.0, " mm"), "angle": (math.degrees(1.0), "°")}
"""Scale and unit of an estimate's error, by axis."""
GUARDED = ("default", "soft_servos", "random", "upright", "edge", "soft")
"""Campaigns whose pooled dockings decide most targets."""
CALIBRATED = (
    "random",
    "edge",
    "soft",
    "tilted",
    "default",
    "second",
    "second_1N",
    "second_sensitive",
    "random_second",
    "high_row",
    "parked",
)
"""Campaigns in the table of the estimates' errors."""


def columns(results: dict[str, list[Any]]) -> Columns:
    """Return the results of a campaign as arrays, with |roll| in degrees as `degrees`."""
    found = {name: np.asarray(values) for name, values in results.items()}
    found["degrees"] = np.degrees(np.abs(found["place_roll"].astype(float)))
    return found


def joined(rows: dict[str, Columns], *names: str) -> Columns | None:
    """Return the rows of campaigns, concatenated in their common columns, with the name as `campaign`.

    Args:
        rows: by the campaign's name.
        names: of campaigns; those that were not run are left out; None if none was run.
    """
    parts = {name: rows[name] for name in names if name in rows}
    if not parts:
        return None
    shared = set.intersection(*map(set, parts.values()))
    found = {key: np.concatenate([each[key] for each in parts.values()]) for key in shared}
    return found | {"campaign": np.repeat(list(parts), [len(each["number"]) for each in parts.values()])}


def part(rows: Columns, chosen: Array) -> Columns:
    """Return the chosen rows (indices or mask)."""
    return {name: column[chosen] for name, column in rows.items()}


def summarise(rows: Columns) -> dict[str, Any]:
    """Return the figures of one campaign; NaN if there is nothing to count."""
    charged = rows["charged"].astype(bool)
    count = len(charged)
    x, y = np.abs(rows["final_horizontal"][charged]), np.abs(rows["final_vertical"][charged])
    rest = rows["rest_current"][charged & np.isfinite(rows["rest_current"])]
    band = (rest >= BAND[0]) & (rest <= BAND[1])
    unsafe = rows["energised_unsafe"] > 0.0
    live = rows["energised"] > 0.0
    return {
        "n": count,
        "charged": rate(int(charged.sum()), count),
        "refused": refused(rows),
        "crashed": int(np.sum(rows["code_name"] == CRASHED)),
        "near": _share((x <= NEAR) & (y <= NEAR)),
        "near_vertical": _share(y <= NEAR),
        "near_horizontal": _share(x <= OVERLAP_LOSS),
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
        **_told(rows, charged),
    }


def _told(rows: Columns, charged: Array) -> Figures:
    """Return how true the told force was, and how undocking ended; {} for results of earlier versions."""
    if "undocked" not in rows:
        return {}
    true = rows["true_push"][charged].astype(float)
    inside = (rows["force_min"][charged] <= true) & (true <= rows["force_max"][charged])
    left = rows["undocked"][charged]
    return {
        "aligned": _share(rows["aligned"][charged].astype(bool)),
        "told": float(np.median(rows["reported_push"][charged].astype(float))) if len(true) else math.nan,
        "true": finite_quantiles(true, 0.0, 0.5, 1.0),
        "inside": _share(inside),
        "interval": finite_quantiles(rows["force_max"][charged] - rows["force_min"][charged].astype(float), 0.5)[0],
        "kept": dict(Counter(str(name) for name in left if name not in ("", "NONE"))),
        "still_touching": int(np.sum(rows["still_touching"][charged].astype(bool))),
    }


def holding(rows: Columns) -> Figures:
    """Return the charged share of robots whose brakes hold 25 N and more, and what the others ended with."""
    holds = rows["world.stand.brakes"].astype(float) >= HOLDS
    good, poor = part(rows, holds), part(rows, ~holds)
    return {
        "charged": _share(good["charged"].astype(bool)),
        "kept": _told(good, good["charged"].astype(bool))["kept"],
        "poor": _share(poor["charged"].astype(bool)),
        "refused": refused(poor),
    }


def rate(hits: int, count: int) -> dict[str, Any]:
    """Return a share with its 95 % interval (Wilson)."""
    return {"hits": hits, "n": count, "share": hits / count if count else math.nan, "interval": wilson(hits, count)}


def _share(found: Array) -> dict[str, Any]:
    return rate(int(found.sum()), len(found))


def quantiles(values: Array) -> dict[str, float]:
    """Return median, 90 %, 99 % and the largest of the finite values."""
    return dict(zip(QUANTILES, finite_quantiles(values.astype(float), 0.5, 0.9, 0.99, 1.0), strict=True))


def refused(rows: Columns) -> dict[str, int]:
    """Return the count of each code of uncharged dockings, the most frequent first."""
    codes = Counter(str(name) for name in rows["code_name"] if name not in ("NONE", CRASHED))
    return dict(codes.most_common())


def binned(rows: Columns, values: Array, edges: Iterable[float]) -> Iterator[tuple[float, float, Columns]]:
    """Yield the ends of each bin and its rows; the last bin includes its upper end."""
    ends = list(itertools.pairwise(edges))
    for low, high in ends:
        inside = (values >= low) & ((values < high) | ((low, high) == ends[-1]) & (values <= high))
        yield low, high, part(rows, inside)


def by_angle(rows: Columns) -> list[Figures]:
    """Return charged share and refusals of each non-empty bin of |roll|."""
    found = []
    for low, high, inside in binned(rows, rows["degrees"], BINS):
        if len(inside["charged"]):
            charged = rate(int(inside["charged"].sum()), len(inside["charged"]))
            unsafe = int(np.sum(inside["energised_unsafe"] > 0.0))
            found.append({"low": low, "high": high, **charged, "refused": refused(inside), "unsafe": unsafe})
    return found


def by_drawn(rows: Columns) -> list[Figures]:
    """Return results of dockings in the parts of each drawn range."""
    offset = 1000.0 * np.maximum(np.abs(rows["place_x"] - rows["goal_x"]), np.abs(rows["place_y"] - rows["goal_y"]))
    drawn = (
        ("servo stiffness, N·m/rad", rows["world.servo.stiffness"].astype(float), (2.0, 6.0, 12.0, 20.0, 40.0)),
        ("contact stiffness, N/m", rows["world.contact.stiffness"].astype(float), (1e4, 1e5, 1e6, 1e7)),
        ("offset at contact, mm", offset, (0.0, 4.0, 7.0, 10.0)),
        ("gravity along the push", rows["gravity_z"] / GRAVITY_STRENGTH, (-1.0, -1.0 / 3.0, 1.0 / 3.0, 1.0)),
    )
    return [
        {"name": name, "range": f"{low:.2g} to {high:.2g}", **_briefly(inside)}
        for name, values, edges in drawn
        for low, high, inside in binned(rows, np.round(values, 9), edges)
    ]


def by_tilt(rows: Columns) -> list[Figures]:
    """Return results of dockings by the tilt (degrees) of the faces about y."""
    tilt = np.degrees(np.abs(rows["world.target.tilt_y"].astype(float)))
    found = []
    for low, high, inside in binned(rows, tilt, (0.0, 0.1, 0.25, 0.5, 0.75, 1.0)):
        error = inside["last_horizontal_error"].astype(float)
        found.append({"low": low, "high": high, "error": 1000.0 * _rms(error[np.isfinite(error)]), **_briefly(inside)})
    return found


def nudges(rows: Columns) -> Figures:
    """Return for charges with a moved target: number opened, delay (s), and number and time (s) unsafe."""
    live = part(rows, rows["charged"].astype(bool))
    opened, unsafe = np.isfinite(live["nudge_opened"].astype(float)), live["energised_unsafe"].astype(float)
    return {
        "n": len(opened),
        "opened": int(opened.sum()),
        "delay": quantiles(live["nudge_opened"]),
        "unsafe": int(np.sum(unsafe > 0.0)),
        "unsafe_opened": int(np.sum((unsafe > 0.0) & opened)),
        "seconds": quantiles(unsafe[unsafe > 0.0]),
    }


def near_zero(rows: Columns) -> Figures:
    """Return results of dockings by bins of the true clearance (mm) at the last estimate, finest near 0."""
    clear = 1000.0 * rows["last_clearance"].astype(float)
    edges = (-math.inf, -1.0, -0.5, 0.0, 0.25, 0.5, 0.75, 1.0, 1.5, 2.0, math.inf)
    bins = [
        {"low": low, "high": high, **rate(int(inside["charged"].sum()), len(inside["charged"]))}
        for low, high, inside in binned(rows, clear, edges)
    ]
    return {"bins": bins, "unknown": int(np.sum(~np.isfinite(clear)))}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _briefly(rows: Columns) -> Figures:
    each = summarise(rows)
    numbers = {"time": each["time"]["median"], "moves": each["moves"]["median"], "hottest": each["hottest"]["p99"]}
    return {"n": each["n"], "charged": each["charged"], "near": each["near"], **numbers}


def calibration(rows: Columns) -> dict[str, dict[str, float]]:
    """Return error / σ of the first and the last estimate: rms, largest and share beyond 3."""
    found = {}
    for which in ("first", "last"):
        for axis in AXES:
            error, stddev = rows[f"{which}_{axis}_error"].astype(float), rows[f"{which}_{axis}_stddev"].astype(float)
            known = np.isfinite(error) & (stddev > 0.0)
            z = error[known] / stddev[known]
            found[f"{which}_{axis}"] = {
                "n": len(z),
                "rms": _rms(z),
                "max": float(np.max(np.abs(z), initial=0.0)) if len(z) else math.nan,
                "beyond_3": float(np.mean(np.abs(z) > 3.0)) if len(z) else math.nan,
                "error_rms": _rms(error[known]),
            }
    return found


def estimated_clearance(rows: Columns, sigmas: float) -> Array:
    """Return docking's estimated clearance (m) at its last estimate, minus this many standard deviations."""
    from deltacharger_docking.parameters import DockingParameters

    known = DockingParameters()
    gap, half = known.electrode_half_gap, known.electrode_half_length
    angle = rows["estimated_angle"].astype(float)
    across = rows["estimated_vertical"] * np.cos(angle) - rows["estimated_horizontal"] * np.sin(angle)
    slope = gap * np.abs(np.sin(angle)) + half * np.cos(angle)
    spread = np.hypot(slope * rows["last_angle_stddev"], rows["last_across_stddev"])
    clear = gap * (1.0 + np.cos(angle)) - half * np.abs(np.sin(angle)) - np.abs(across)
    return np.asarray(clear - sigmas * spread)


def targets(found: dict[str, dict[str, Any]], upright: dict[str, Any] | None) -> list[dict[str, Any]]:
    """Return every target with its measured value and verdict.

    Args:
        found: summaries by the campaign's name; those that were not run are missing.
        upright: of all dockings with magnets and |roll| up to `UPRIGHT`.
    """

    def share(of: dict[str, Any] | None, key: str) -> float | None:
        return None if of is None else 100.0 * float(of[key]["share"])

    def largest(key: str) -> float | None:
        return max((most for each in guarded if formats.is_known(most := each[key]["max"])), default=None)

    def unsafe(name: str) -> tuple[int | None, str]:
        hits = found[name]["unsafe"]["hits"] if name in found else None
        return hits, f"of {found.get(name, {}).get('n', 0)}"

    guarded = [found[name] for name in GUARDED if name in found]
    default = found.get("default")
    shorts = sum(each["shorts"] for each in guarded) if guarded else None
    crashed = sum(each["crashed"] for each in found.values()) if found else None
    return [
        *(each for name, least in ARMS.items() for each in _arms(name, found.get(name), *least)),
        *(
            each
            for name, limits in SECONDS_MOST.items()
            for each in _limits(f"seconds to charging, {name}", found.get(name), "time", limits, "s")
        ),
        *_limits("moves, default", default, "moves", MOVES_MOST, ""),
        report.at_least(f"charged, angle up to ±{UPRIGHT:g}°", share(upright, "charged"), 99.9, "%"),
        report.at_least("charged, scenes at 8–11°", share(found.get("edge"), "charged"), 58.0, "%"),
        report.at_least("at rest within 2.5 mm across the bars, default", share(default, "near_vertical"), 99.5, "%"),
        report.at_least("at rest within 4 mm along the bars, default", share(default, "near_horizontal"), 99.5, "%"),
        report.at_least("at rest within 2.5 mm in both axes, default", share(default, "near"), 94.0, "%"),
        report.none("energised without clearance, random scenes", *unsafe("random")),
        report.none("energised without clearance, scenes at 8–11°", *unsafe("edge")),
        report.none("shorts, our algorithm", shorts, f"of {sum(each['n'] for each in guarded)}"),
        report.at_least("contact current at rest in 0.4–0.5 A", _pooled(guarded, "in_band"), 100.0, "%"),
        report.at_most("largest push of the servos in contact", largest("push"), PUSH_MOST, "N"),
        report.at_most("hottest servo while charging, largest", largest("hottest"), HOTTEST_MOST, "A"),
        *_limits("strike, exact, default", found.get("strike"), "strike", STRIKE_MOST, "N"),
        report.none("dockings that crashed", crashed, f"of {sum(each['n'] for each in found.values())}"),
    ]


def _arms(
    name: str, of: dict[str, Any] | None, charged: float, aligned: float, inside: float
) -> Iterator[dict[str, Any]]:
    """Yield the targets of arms and robots as they are."""
    for what, key, least in (
        ("charged", "charged", charged),
        ("aligned of these", "aligned", aligned),
        ("true force in the told interval", "inside", inside),
    ):
        share = 100.0 * float(of[key]["share"]) if of and key in of else None
        yield report.at_least(f"{what}, {name}", share, least, "%")
    if of is None or "kept" in of:
        count = f"of {of['charged']['hits'] if of else 0}"
        yield report.none(f"undocked while touching, {name}", None if of is None else of["still_touching"], count)


def _limits(
    name: str, of: dict[str, Any] | None, key: str, limits: Mapping[str, float], unit: str
) -> Iterator[dict[str, Any]]:
    """Yield the target of each quantile that has a limit."""
    for which, most in limits.items():
        yield report.at_most(f"{name}, {QUANTILES[which]}", None if of is None else of[key][which], most, unit)


def _pooled(parts: list[dict[str, Any]], key: str) -> float | None:
    count = sum(part[key]["n"] for part in parts)
    return 100.0 * float(sum(part[key]["hits"] for part in parts)) / count if count else None


def by_angle_and_campaign(
    parts: dict[str, Figures], names: Iterable[str]
) -> list[tuple[tuple[float, float], dict[str, Figures]]]:
    """Return for each bin of |roll| (degrees) the campaigns' figures."""
    found: dict[tuple[float, float], dict[str, Figures]] = {}
    for name in names:
        for each in parts[name]["bins"]:
            found.setdefault((each["low"], each["high"]), {})[name] = each
    return sorted(found.items())


def compared(pair: Figures) -> Iterator[tuple[str, Figures, str, float]]:
    """Yield name, figures, unit and scale of each paired comparison."""
    for name, each in pair["rates"].items():
        yield name, each, "%", 100.0
    for name, each in pair["numbers"].items():
        yield name, each, *(("mm", 1000.0) if each["unit"] == "m" else (each["unit"], 1.0))
