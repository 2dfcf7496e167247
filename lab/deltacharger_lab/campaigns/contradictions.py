# SPDX-License-Identifier: Apache-2.0
"""Contradictions between keys of a scene: docking's assumptions, disturbances and pads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from deltacharger_core.parameters import ParameterError, declared
from deltacharger_lab.campaigns.pads import SECOND
from deltacharger_lab.campaigns.parts import second_family
from deltacharger_lab.campaigns.spread import Spread, Value
from deltacharger_sim.parameters import TargetParameters

_SIGMAS = 3.0  # of a normal distribution, taken as its ends
_TILT = {key.name: key for key in declared(TargetParameters)}["tilt_y"]

_DEAD_BAND = "second.sheet.dead_band"  # 0 = none
_LITTLE = 1e-6  # N of a dead band drawn from 0 on
_BOUNDED_ABOVE = (
    ("foundation.confinement", "foundation.modulus"),
    ("bars.seat",),
    ("bars.rate",),
    ("sheet.dead_band_spread",),
    ("sheet.dead_band", "sheet.dead_band_spread"),
    ("sheet.edge_loss", "sheet.neighbour"),
)
"""Keys that each rule of SecondParameters bounds from above. It bounds its other keys from below, so one corner of
the ranges breaks it first."""

_Ends = Mapping[str, tuple[Value, Value]]  # of each key
_Problem = tuple[str, Value, str]  # key, value and problem


def refuse_contradictions(spreads: Mapping[str, Spread], dockings: Sequence[Mapping[str, Value]]) -> None:
    """Refuse the first key without effect or in contradiction with another.

    Args:
        spreads: of the drawn keys.
        dockings: listed values, which take precedence.

    Raises:
        ParameterError: names the key.
    """
    drawn = {name: _ends_of(spread) for name, spread in spreads.items()}
    for values in dockings or ({},):
        ends = {**drawn, **{name: (value, value) for name, value in values.items()}}
        for problem in (*_assumptions(ends), *_disturbed(ends), *_pads(ends)):
            raise ParameterError(*problem)


def _ends_of(spread: Spread) -> tuple[Value, Value]:
    low, high = spread.ends
    if spread.shape == "normal":
        mean, reach = float(spread.numbers[0]), _SIGMAS * float(spread.numbers[1])
        low, high = max(mean - reach, spread.key.low), min(mean + reach, spread.key.high)
    if spread.key.name == _DEAD_BAND and low == 0.0 != high:
        low = min(float(each) for each in spread.numbers if each) if spread.shape == "choose" else _LITTLE
    return low, high


def _is_nothing(ends: _Ends, *names: str) -> bool:
    return all(ends.get(name, (0.0, 0.0)) == (0.0, 0.0) for name in names)


def _numbers(ends: _Ends, name: str, default: float) -> tuple[float, float]:
    low, high = ends.get(name, (default, default))
    return float(low), float(high)


def _assumptions(ends: _Ends) -> Iterator[_Problem]:
    if "assumed.gravity_tilt" in ends and False in ends.get("gravity.known", ()):
        yield "gravity.known", False, "contradicts assumed.gravity_tilt, which sets known gravity; remove one of them"
    if "assumed.gravity_azimuth" in ends and _is_nothing(ends, "assumed.gravity_tilt"):
        value = ends["assumed.gravity_azimuth"][0]
        yield "assumed.gravity_azimuth", value, "has no effect if assumed.gravity_tilt is 0; remove one"


def _disturbed(ends: _Ends) -> Iterator[_Problem]:
    if "nudge.after" in ends and _is_nothing(ends, "nudge.x", "nudge.y", "nudge.roll"):
        yield "nudge.after", ends["nudge.after"][0], "has no effect without nudge.x, nudge.y or nudge.roll"
    heading, tilt = _numbers(ends, "parked.heading", 0.0), _numbers(ends, "world.target.tilt_y", 0.0)
    least, most = tilt[0] - heading[1], tilt[1] - heading[0]
    if not _TILT.low <= least <= most <= _TILT.high:
        yield (
            "parked.heading",
            max(heading, key=abs),
            f"makes faces tilted by {least:g} to {most:g} rad with world.target.tilt_y; "
            f"allowed are {_TILT.low:g} to {_TILT.high:g} rad",
        )


def _pads(ends: _Ends) -> Iterator[_Problem]:
    if SECOND not in ends.get("pads", ()):
        for name in ends:
            if name.startswith("second."):
                yield name, ends[name][0], "has no effect if pads is first; add pads: second"
    second = {name: pair for name, pair in ends.items() if name.startswith("second.")}
    for above in _BOUNDED_ABOVE if second else ():
        second_family({name: pair[name.removeprefix("second.") in above] for name, pair in second.items()})
    if ends.get("pads") == (SECOND, SECOND):
        for name in ends:
            if name.startswith("electrode."):
                yield name, ends[name][0], "has no effect if pads is second, which has its own family; remove one"
    if "estimator.model" in ends and ends.get("estimator.paper") == (True, True):
        yield "estimator.model", ends["estimator.model"][0], "has no effect if estimator.paper is true; remove one"
