# SPDX-License-Identifier: Apache-2.0
"""Two campaigns of one seed, docking by docking: differences of rates and numbers, each with its interval."""

import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.campaigns.docking import CRASHED
from deltacharger_lab.campaigns.store import CampaignRefused, read_results, read_settings
from deltacharger_lab.campaigns.summary import COLUMNS, NUMBERS, RATES, Results, numbers

_RESAMPLES = 4000
_MANY = 20_000  # pairs from which the mean is normally distributed and resampling adds only cost
_Z = 1.959963984540054  # 95 %, normal distribution
_CHUNK = 4_000_000  # drawn at once


def compare_campaigns(a: Path, b: Path) -> dict[str, Any]:
    """Compare the dockings that both campaigns have; differences are B − A.

    Args:
        a, b: their folders, complete or not.

    Returns:
        pairs; differs (texts); rates and numbers by name, each with a, b, difference, interval (95 %) and n; refused by
        code, shorts and energised_unsafe (s) of each; crashed, pairs left out after a crash.

    Raises:
        CampaignRefused: a folder holds no campaign, or the two have different seeds or no common docking.
    """
    first, second = read_settings(a), read_settings(b)
    if first.seed != second.seed:
        raise CampaignRefused(
            f"{a} has seed {first.seed} and {b} {second.seed}: their dockings are not pairs; run both with one seed"
        )
    left, right, crashed = _pairs(read_results(a, COLUMNS), read_results(b, COLUMNS))
    count = len(left["number"])
    if not count:
        raise CampaignRefused(f"{a} and {b} have no common docking")
    return {
        "a": str(a),
        "b": str(b),
        "pairs": count,
        "crashed": crashed,
        "seed": first.seed,
        "differs": [f"{what}: {one} → {two}" for what, one, two in first.differences(second) if what != "n"],
        "rates": {name: compare_rates(left[name], right[name]) for name in RATES},
        "numbers": {
            name: {**compare_numbers(numbers(left, name), numbers(right, name)), "unit": unit}
            for name, unit in NUMBERS.items()
        },
        "refused": _refused(left, right),
        "shorts": {"a": int(sum(left["shorts"])), "b": int(sum(right["shorts"]))},
        "energised_unsafe": {"a": float(sum(left["energised_unsafe"])), "b": float(sum(right["energised_unsafe"]))},
    }


def compare_rates(a: Sequence[Any], b: Sequence[Any]) -> dict[str, Any]:
    """Compare two shares over pairs.

    The interval is the adjusted one of Bonett and Price (2012), which also holds if few pairs differ. p is McNemar's
    exact test: the probability of so uneven a split of the differing pairs by chance.

    Args:
        a, b: truth values of the same dockings.
    """
    first, second = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    count = len(first)
    only_a, only_b = int(np.sum(first & ~second)), int(np.sum(second & ~first))
    gained, lost = (only_b + 1.0) / (count + 2.0), (only_a + 1.0) / (count + 2.0)
    reach = _Z * math.sqrt((gained + lost - (gained - lost) ** 2) / (count + 2.0))
    return {
        "a": float(np.mean(first)),
        "b": float(np.mean(second)),
        "difference": float(np.mean(second)) - float(np.mean(first)),
        "interval": [max(gained - lost - reach, -1.0), min(gained - lost + reach, 1.0)],
        "only_a": only_a,
        "only_b": only_b,
        "p": mcnemar(only_a, only_b),
        "n": count,
    }


def mcnemar(only_a: int, only_b: int) -> float:
    """Return the two-sided exact probability that differing pairs split at least so unevenly by chance."""
    if not only_a + only_b:
        return 1.0
    from scipy.stats import binomtest

    return float(binomtest(only_a, only_a + only_b).pvalue)


def compare_numbers(a: Array, b: Array, seed: int = 0) -> dict[str, Any]:
    """Compare the mean of a number over the pairs in which both have it.

    Args:
        a, b: values of the same dockings, NaN if not counted.
        seed: of the paired bootstrap.
    """
    both = np.isfinite(a) & np.isfinite(b)
    first, second = a[both], b[both]
    count = len(first)
    if not count:
        return {"a": math.nan, "b": math.nan, "difference": math.nan, "interval": [math.nan, math.nan], "n": 0}
    low, high = _interval(second - first, seed)
    return {
        "a": float(np.mean(first)),
        "b": float(np.mean(second)),
        "difference": float(np.mean(second - first)),
        "interval": [low, high],
        "n": count,
    }


def _interval(difference: Array, seed: int) -> tuple[float, float]:
    """Return the 95 % interval of a mean: percentiles of the paired bootstrap, or normal for very many."""
    count, mean = len(difference), float(np.mean(difference))
    if count < 2:
        return math.nan, math.nan
    if count > _MANY:
        reach = _Z * float(np.std(difference, ddof=1)) / math.sqrt(count)
        return mean - reach, mean + reach
    from scipy.stats import bootstrap

    found = bootstrap(
        (difference,),
        np.mean,
        n_resamples=_RESAMPLES,
        batch=max(1, _CHUNK // count),
        method="percentile",
        random_state=np.random.default_rng([0xC0B, seed]),
    )
    return float(found.confidence_interval.low), float(found.confidence_interval.high)


def _pairs(a: Results, b: Results) -> tuple[Results, Results, int]:
    """Return the rows that both have, in the same order, without pairs with a crash, and the number of these pairs."""
    place = {number: index for index, number in enumerate(b["number"])}
    shared = [(index, place[number]) for index, number in enumerate(a["number"]) if number in place]
    complete = [(i, j) for i, j in shared if a["code_name"][i] != CRASHED and b["code_name"][j] != CRASHED]
    left = {name: [values[i] for i, _ in complete] for name, values in a.items()}
    right = {name: [values[j] for _, j in complete] for name, values in b.items()}
    return left, right, len(shared) - len(complete)


def _refused(a: Results, b: Results) -> dict[str, dict[str, int]]:
    counts = [Counter(name for name in side["code_name"] if name != "NONE") for side in (a, b)]
    return {name: {"a": counts[0][name], "b": counts[1][name]} for name in sorted(set().union(*counts))}


def describe(found: dict[str, Any]) -> str:
    """Return the comparison as text lines."""
    lines = [f"{found['pairs']} pairs of simulated dockings, seed {found['seed']}: A {found['a']}, B {found['b']}"]
    lines += [f"  {text}" for text in found["differs"]] or ["  with the same settings"]
    if found["crashed"]:
        lines.append(f"  {found['crashed']} pairs are left out: one of the two dockings crashed")
    lines.append(f"  {'':<20}{'A':>10}{'B':>10}{'B − A':>10}   95 %")
    for name, each in found["rates"].items():
        lines.append(_line(name, each, 100.0, "%") + f"  McNemar p = {each['p']:.3g}")
    for name, each in found["numbers"].items():
        scale, unit = (1e3, "mm") if each["unit"] == "m" else (1.0, each["unit"])
        lines.append(_line(name, each, scale, unit))
    for name, each in found["refused"].items():
        lines.append(f"  {name:<20}{each['a']:>10}{each['b']:>10}")
    lines.append(f"  {'shorts':<20}{found['shorts']['a']:>10}{found['shorts']['b']:>10}")
    return "\n".join(lines)


def _line(name: str, each: dict[str, Any], scale: float, unit: str) -> str:
    low, high = (scale * value for value in each["interval"])
    values = "".join(f"{scale * each[key]:>10.3f}" for key in ("a", "b", "difference"))
    verdict = "differs" if low > 0.0 or high < 0.0 else "no difference seen"
    return f"  {name:<20}{values}   {low:+.3f} to {high:+.3f} {unit}".rstrip() + f"  ({verdict}, n = {each['n']})"
