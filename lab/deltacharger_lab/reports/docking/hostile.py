# SPDX-License-Identifier: Apache-2.0
"""Dockings under faults: laws that were broken, and how dockings with each fault ended."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

from deltacharger_lab.campaigns import hostile, judge, summary
from deltacharger_lab.campaigns.hostile import SCENES as BASE_CODES
from deltacharger_lab.reports.docking.summary import Columns, Figures, quantiles
from deltacharger_lab.reports.report import at_least, none

SCENES = ("hostile", "hostile_exact")
"""Campaigns of the section, if they were run."""
_EXAMPLES = 5
_CODES = ("code_name", "ended", "undocked")


def figures(rows: Columns) -> Figures:
    """Return the figures of one hostile campaign."""
    broken = [set(str(each).split()) for each in rows["broken"]]
    codes = [[str(rows[name][index]) for name in _CODES if rows[name][index]] for index in range(len(broken))]
    return {
        "n": len(broken),
        "clean": sum(not each for each in broken),
        "laws": [_law(name, rows, broken) for name in judge.LAWS],
        "outside": quantiles(rows["outside"]),
        "outside_limp": quantiles(rows["outside_limp"]),
        "single": _single(rows, broken, codes),
        "force": quantiles(rows["peak_force"]),
        "unsafe": quantiles(rows["live_unsafe_all"]),
        "faults": [each for fault in hostile.FAULTS if (each := _fault(fault.name, rows, broken, codes))["n"]],
        "next": _next(rows, codes),
    }


def _law(name: str, rows: Columns, broken: list[set[str]]) -> Figures:
    """Return how often a law was broken, its bound, and the numbers of some dockings that broke it."""
    numbers = [int(number) for number, laws in zip(rows["number"], broken, strict=True) if name in laws]
    bound = summary.upper_bound(len(numbers), len(broken))
    return {
        "name": name,
        "about": judge.LAWS[name],
        "hits": len(numbers),
        "bound": bound,
        "examples": numbers[:_EXAMPLES],
    }


def _fault(name: str, rows: Columns, broken: list[set[str]], codes: list[list[str]]) -> Figures:
    """Return for the dockings in which a fault acted: codes, the share that the faults explain, and broken laws."""
    acted = [index for index, names in enumerate(rows["acted"]) if name in str(names).split()]
    explained = sum(not broken[index] & {"code", "crashed", "outcome"} for index in acted)
    return {
        "name": name,
        "n": len(acted),
        "codes": dict(Counter(code for index in acted for code in codes[index]).most_common()),
        "explained": explained / len(acted) if acted else 0.0,
        "broken": dict(Counter(law for index in acted for law in judge.LAWS if law in broken[index])),
    }


def _single(rows: Columns, broken: list[set[str]], codes: list[list[str]]) -> dict[str, int]:
    """Return how many goals one lasting fault ended, and in how many of them the code named its cause."""
    ended = [
        broken[index]
        for index, (names, drawn) in enumerate(zip(rows["acted"], rows["drawn_faults"], strict=True))
        if len(str(names).split()) == 1
        and not any(word in str(drawn) for word in (" for ", " Hz"))
        and set(codes[index]) - set(BASE_CODES[str(rows["scene"][index])].split())
    ]
    return {"n": len(ended), "named": sum(not each & {"code", "crashed", "outcome"} for each in ended)}


def _next(rows: Columns, codes: list[list[str]]) -> dict[str, int]:
    """Return the codes of the goals after the faults were removed, of dockings whose codes asked for no person."""
    free = [index for index, each in enumerate(codes) if not set(each) & set(judge.PERSON)]
    return dict(Counter(str(rows["next_code"][index]) or "none" for index in free).most_common())


def targets(found: dict[str, Figures]) -> Iterator[dict[str, Any]]:
    """Yield the target of each law, over all hostile campaigns."""
    count = f"of {sum(each['n'] for each in found.values())}"
    for index, name in enumerate(judge.LAWS):
        hits = sum(each["laws"][index]["hits"] for each in found.values()) if found else None
        yield none(f"hostile: {name}", hits, count)
    ended, named = (sum(each["single"][key] for each in found.values()) for key in ("n", "named"))
    share = named / ended if ended else None
    yield at_least("hostile: code names the cause of a single lasting fault", share, 0.97, "of them")
