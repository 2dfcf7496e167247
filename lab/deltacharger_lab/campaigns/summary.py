# SPDX-License-Identifier: Apache-2.0
"""Summary of a campaign's results."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from deltacharger_lab.campaigns.docking import CRASHED

Results = Mapping[str, Sequence[Any]]

NUMBERS = {
    "time": "s",
    "moves": "",
    "final_misalignment": "m",
    "peak_push": "N",
    "time_above_band": "s",
}
"""Numbers of the summary with their units; time, moves and final_misalignment are those of charged dockings."""
OF_CHARGED = ("time", "moves", "final_misalignment")
RATES = ("charged", "aligned")
COLUMNS = ("number", "code_name", "shorts", "energised_unsafe", *RATES, *NUMBERS)
"""Columns that summaries and comparisons read."""


def summarise(results: Results) -> dict[str, Any]:
    """Return the summary of results from `read_results`.

    Returns:
        n; charged and aligned as shares, with 95 % intervals (Wilson) under charged_interval and aligned_interval;
        refused, how often by code; crashed; shorts and energised_unsafe (s), sums; and for each of `NUMBERS` median,
        p95 and max, NaN for none. Of hostile dockings also broken: how often each law was.
    """
    count = len(results["number"])
    codes = Counter(name for name in results["code_name"] if name not in ("NONE", CRASHED))
    summary: dict[str, Any] = {"n": count}
    for name in RATES:
        hits = sum(map(bool, results[name]))
        summary[name] = hits / count if count else math.nan
        summary[f"{name}_interval"] = list(wilson(hits, count))
    summary["refused"] = dict(sorted(codes.items()))
    summary["crashed"] = sum(name == CRASHED for name in results["code_name"])
    summary["shorts"] = int(sum(results["shorts"]))
    summary["energised_unsafe"] = float(np.nansum(np.asarray(results["energised_unsafe"], dtype=float)))
    if "broken" in results:
        summary["broken"] = dict(Counter(law for each in results["broken"] for law in each.split()))
    for name in NUMBERS:
        summary[name] = dict(
            zip(("median", "p95", "max"), quantiles(numbers(results, name), 0.5, 0.95, 1.0), strict=True)
        )
    return summary


def quantiles(values: np.ndarray, *shares: float) -> list[float]:
    """Return quantiles of the finite values; NaN for none."""
    known = values[np.isfinite(values)]
    return [float(each) for each in np.quantile(known, shares)] if len(known) else [math.nan] * len(shares)


def numbers(results: Results, name: str) -> np.ndarray:
    """Return a column as floats (n,); NaN if the docking does not count: not charged, or crashed."""
    values = np.asarray(results[name], dtype=float)
    counts = np.asarray(results["charged"], dtype=bool)
    if name not in OF_CHARGED:
        counts = np.asarray([code != CRASHED for code in results["code_name"]], dtype=bool)
    return np.where(counts, values, np.nan) if len(values) else values


def wilson(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927), which stays within 0 to 1; NaN for no count."""
    if not count:
        return math.nan, math.nan
    from scipy.stats import binomtest

    interval = binomtest(hits, count).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def upper_bound(hits: int, count: int) -> float:
    """Return the exact one-sided 95 % bound of a share (Clopper and Pearson 1934); without hits about 3 / count."""
    if not count:
        return math.nan
    from scipy.stats import binomtest

    return float(binomtest(hits, count, alternative="less").proportion_ci().high)
