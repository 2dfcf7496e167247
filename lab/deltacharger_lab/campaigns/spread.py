# SPDX-License-Identifier: Apache-2.0
"""Distribution of a campaign's value: a number or word, a linear or log range, a normal distribution or a choice."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

from deltacharger_core.bounded_file import brief
from deltacharger_core.parameters import Declaration, ParameterError, did_you_mean

Value = float | bool | str
_REDRAWS = 1000  # of a normal distribution outside the bounds; then the mean is used
_LOG, _SIDES = "log", "either_sign"
HELP = (
    "give a number, a range [low, high], {log: [low, high]}, {either_sign: [low, high]}, {mean: …, stddev: …} or "
    "{choose: [ … ]}"
)


@dataclass(frozen=True)
class Spread:
    """Distribution of a value.

    Attributes:
        shape: "fixed", "range", "log", "either_sign", "normal" or "choose".
        numbers: the value; low and high (of the size for "either_sign"); mean and standard deviation; or the choices.
        key: bounds and kind; a number, a truth value or a word.
    """

    shape: str
    numbers: tuple[Value, ...]
    key: Declaration

    def draw(self, source: random.Random) -> Value:
        """Return one value within the bounds."""
        first = self.numbers[0]
        if self.shape == "fixed":
            return first
        if self.shape == "choose":
            return self.numbers[source.randrange(len(self.numbers))]
        if self.shape == "normal":
            return self._normal(source)
        first, last = cast(tuple[float, float], self.numbers)
        if self.shape == _LOG:
            drawn = math.exp(source.uniform(math.log(first), math.log(last)))
            return min(max(drawn, first), last)
        if self.shape == _SIDES:
            return source.choice((-1.0, 1.0)) * source.uniform(first, last)
        return source.randint(int(first), int(last)) if self.key.kind is int else source.uniform(first, last)

    def _normal(self, source: random.Random) -> float:
        mean, stddev = cast(tuple[float, float], self.numbers)
        for _ in range(_REDRAWS):
            value = source.gauss(mean, stddev)
            if self.key.low <= value <= self.key.high:
                return value
        return float(mean)

    @property
    def ends(self) -> tuple[Value, Value]:
        """Smallest and largest value of a range or a choice; of a normal distribution its mean twice."""
        if self.shape == "normal":
            return self.numbers[0], self.numbers[0]
        if self.shape == _SIDES:
            return -float(self.numbers[1]), self.numbers[1]
        known = cast(tuple[float, ...], self.numbers)  # or words, which have an order, too
        return min(known), max(known)


def _usage(key: Declaration) -> str:
    return f"give one of {', '.join(key.choices)}, or {{choose: [ … ]}}" if key.kind is str else HELP


def _checked(key: Declaration, value: Any, where: str) -> Value:
    """Return the value in the key's own type.

    Raises:
        ParameterError: it has the wrong type or lies outside the bounds.
    """
    if key.kind is int and isinstance(value, float) and value.is_integer():
        value = int(value)
    problem = "has no value" if value is None else key.problem(value)
    if problem:
        number = isinstance(value, int | float) and key.kind is not str
        usage = "" if number else did_you_mean(value, key.choices) or f"; {_usage(key)}"
        raise ParameterError(where, value, problem + usage)
    checked: Value = key.kind(value)
    return checked


def read_spread(value: Any, key: Declaration, where: str) -> Spread:
    """Return the distribution that a YAML value describes.

    Args:
        value: number, truth value, word, [low, high], {mean, stddev} or {choose}.
        key: its bounds and kind.
        where: dotted key, for messages.

    Raises:
        ParameterError: it is none of these, or a number in it lies outside the bounds.
    """
    if isinstance(value, list | tuple):
        return _read_range(value, key, where)
    if isinstance(value, Mapping):
        if set(value) == {"choose"}:
            choices = value["choose"]
            if not isinstance(choices, list | tuple) or not choices:
                raise ParameterError(f"{where}.choose", choices, f"{brief(choices)} is not a list of values")
            checked = (_checked(key, item, f"{where}.choose[{index}]") for index, item in enumerate(choices))
            return Spread("choose", tuple(checked), key)
        if set(value) == {"mean", "stddev"} and key.kind is float:
            return _read_normal(value, key, where)
        if len(value) == 1 and {_LOG, _SIDES} & set(value) and key.kind is float:
            shape, ends = next(iter(value.items()))
            return _read_scale(shape, ends, key, where)
        raise ParameterError(where, dict(value), f"{brief(dict(value))} is not a distribution; {_usage(key)}")
    return Spread("fixed", (_checked(key, value, where),), key)


def _read_range(value: Any, key: Declaration, where: str) -> Spread:
    if len(value) != 2 or key.kind in (bool, str):
        raise ParameterError(where, value, f"{brief(value)} is not a range [low, high]; {_usage(key)}")
    low, high = (cast(float, _checked(key, item, f"{where}[{index}]")) for index, item in enumerate(value))
    if low > high:
        raise ParameterError(where, value, f"{low:g} is above {high:g}; give the lower one first")
    return Spread("range", (low, high), key)


def _read_scale(shape: str, ends: Any, key: Declaration, where: str) -> Spread:
    """Return a spread over sizes: logarithmic, or linear with either sign."""
    where = f"{where}.{shape}"
    if not isinstance(ends, list | tuple):
        raise ParameterError(where, ends, f"{brief(ends)} is not a range [low, high]; {HELP}")
    low, high = cast(tuple[float, float], _read_range(ends, key, where).numbers)
    if shape == _LOG and low <= 0.0:
        raise ParameterError(where, ends, f"{low!r} has no logarithm; give numbers above 0")
    if shape == _SIDES:
        if low < 0.0:
            raise ParameterError(where, ends, f"{low!r} is not a size; give both ends ≥ 0")
        _checked(key, -high, where)
    return Spread(shape, (low, high), key)


def _read_normal(value: Mapping[str, Any], key: Declaration, where: str) -> Spread:
    mean, stddev = cast(float, _checked(key, value["mean"], f"{where}.mean")), value["stddev"]
    known = not isinstance(stddev, bool) and isinstance(stddev, int | float)
    if not known or not 0.0 <= stddev <= key.high - key.low:
        raise ParameterError(
            f"{where}.stddev", stddev, f"{brief(stddev)} is outside 0 to {key.high - key.low:g} {key.unit}".rstrip()
        )
    return Spread("normal", (mean, float(stddev)), key)
