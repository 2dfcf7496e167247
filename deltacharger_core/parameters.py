# SPDX-License-Identifier: Apache-2.0
"""Declared parameters: fields of frozen dataclasses with unit, bounds and meaning, checked at construction.

A package declares its parameters once, in its `parameters.py`. Constructor checks, scene and campaign keys, node
parameters and docs/parameters.md follow from these declarations.
"""

import dataclasses
import difflib
import functools
import math
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

from deltacharger_core import files, texts

T = TypeVar("T")

_LONGEST_KEY = 100  # characters of a key in a message
_KEY = "declaration"  # in the metadata of a field
_KINDS = {bool: "true or false", str: "text", int: "a whole number", float: "a number"}


class ParameterError(ValueError):
    """A key is unknown, or a value has the wrong type or lies outside its bounds.

    Attributes:
        key: dotted path of the key.
        value: the given value.
        problem: the error and the allowed values.
    """

    def __init__(self, key: str, value: Any, problem: str) -> None:
        self.key = key
        self.value = value
        self.problem = problem
        super().__init__(f"{key}: {problem}")


@dataclass(frozen=True)
class Declaration:
    """Declaration of one parameter.

    Attributes:
        name: field name, dotted below groups.
        kind: float, int, bool or str; object = parameter classes, which check themselves.
        default: default value; a tuple for several values, None if the value is optional.
        text: meaning; may contain the unit as {unit}.
        unit: unit of value and bounds; '' = none.
        low, high: inclusive bounds; infinite = any finite value.
        choices: allowed texts; empty = any.
        tunable: whether it may be set while its node runs (between goals if the node serves goals).
    """

    name: str
    kind: type
    default: Any
    text: str
    unit: str = ""
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    tunable: bool = False

    def description(self) -> str:
        """Return the text with its unit, appended in brackets unless the text contains it."""
        if "{unit}" in self.text:
            return self.text.replace("{unit}", self.unit)
        return f"{self.text} ({self.unit})" if self.unit else self.text

    def problem(self, value: Any) -> str:
        """Return the error in a value; '' = none."""
        if self.kind is object or (value is None and self.default is None):
            return ""
        if not isinstance(self.default, tuple):
            return self._problem(value)
        if not isinstance(value, list | tuple):
            return f"{files.brief(value)} is not a list"
        if self.kind is not str and len(value) != len(self.default):
            return f"has {len(value)} numbers; give {len(self.default)}"
        return next((problem for item in value if (problem := self._problem(item))), "")

    def _problem(self, value: Any) -> str:
        allowed: Any = (int, float) if self.kind is float else self.kind
        if not isinstance(value, allowed) or (isinstance(value, bool) and self.kind is not bool):
            return f"{files.brief(value)} is not {_KINDS[self.kind]}{self._range('; allowed are ')}"
        if self.choices and value not in self.choices:
            return f"{files.brief(value)} is not one of {', '.join(self.choices)}"
        if self.kind not in (int, float):
            return ""
        if not math.isfinite(value):
            return f"{files.brief(value)} is not finite{self._range('; allowed are ')}"
        return texts.outside(value, self.low, self.high, self.unit)

    def _range(self, before: str) -> str:
        return f"{before}{self.low:.10g} to {self.high:.10g} {self.unit}".rstrip() if math.isfinite(self.low) else ""


def _declared(kind: type, default: Any, text: str, **about: Any) -> Any:
    return field(default=default, metadata={_KEY: Declaration("", kind, default, text, **about)})


def number(default: float | None, low: float, high: float, unit: str, text: str) -> Any:
    """Declare a number with inclusive bounds, unit and meaning; an int default allows integers only."""
    whole = isinstance(default, int)
    return _declared(int if whole else float, default, text, unit=unit, low=low, high=high)


def tunable(default: float, low: float, high: float, unit: str, text: str) -> Any:
    """Declare a number, as `number` does, that may be set while its node runs."""
    item = number(default, low, high, unit, text)
    return field(default=default, metadata={_KEY: replace(item.metadata[_KEY], tunable=True)})


def numbers(default: tuple[float, ...], low: float, high: float, unit: str, text: str) -> Any:
    """Declare several numbers, each within the bounds; an all-int default allows integers only."""
    whole = all(isinstance(item, int) for item in default)
    return _declared(int if whole else float, default, text, unit=unit, low=low, high=high)


def pose(default: tuple[float, ...], text: str) -> Any:
    """Declare a pose on a robot: seven numbers, of which the quaternion may have any length."""
    return numbers(
        default, -texts.ON_ROBOT, texts.ON_ROBOT, "m", f"{text}: x, y, z in {{unit}}, then the quaternion x, y, z, w"
    )


def flag(default: bool, text: str) -> Any:
    """Declare a boolean."""
    return _declared(bool, default, text)


def words(default: str | tuple[str, ...], text: str, tunable: bool = False) -> Any:
    """Declare a text or several texts."""
    return _declared(str, default, text, tunable=tunable)


def choice(default: str, choices: tuple[str, ...], text: str, tunable: bool = False) -> Any:
    """Declare a text with fixed choices."""
    return _declared(str, default, text, choices=choices, tunable=tunable)


def entries(text: str) -> Any:
    """Declare a tuple of parameter classes, empty by default, which check themselves."""
    return _declared(object, (), text)


def like(cls: type[Any], name: str, **about: Any) -> Any:
    """Declare a field like another class's, with changes such as closer bounds."""
    item = cls.__dataclass_fields__[name]
    return field(default=item.default, metadata={_KEY: replace(item.metadata[_KEY], **about)})


def declaration(item: dataclasses.Field[Any]) -> Declaration | None:
    """Return the declaration of a field; None = undeclared."""
    found = item.metadata.get(_KEY)
    return None if found is None else replace(found, name=item.name)


@functools.cache
def _hints(cls: type[Any]) -> Mapping[str, Any]:
    """Return the types of a class's fields, evaluated once."""
    return typing.get_type_hints(cls)


def declared(cls: type[Any], path: str = "") -> Iterator[Declaration]:
    """Yield the declaration of every parameter of a class; parameters of groups have dotted names."""
    hints = _hints(cls)  # type: ignore[arg-type]  # a class is hashable
    for item in dataclasses.fields(cls):
        name, found = f"{path}.{item.name}" if path else item.name, declaration(item)
        if dataclasses.is_dataclass(hints[item.name]):
            yield from declared(hints[item.name], name)
        elif found is not None:
            yield replace(found, name=name)


@dataclass(frozen=True)
class Bounded:
    """Base of parameter classes: checks every field against its declaration.

    Raises:
        ParameterError: a value has the wrong type or lies outside its bounds.
    """

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            about = item.metadata.get(_KEY)
            if about is not None and (problem := about.problem(value := getattr(self, item.name))):
                raise ParameterError(item.name, value, problem)


def did_you_mean(word: object, known: Iterable[str]) -> str:
    """Return "; did you mean '…'?" with the nearest known name; '' if none is near."""
    near = difflib.get_close_matches(str(word), list(known), 1)
    return f"; did you mean '{near[0]}'?" if near else ""


def from_mapping(mapping: Any, cls: type[T], path: str = "") -> T:
    """Build a parameter class from a mapping such as a YAML section; missing keys keep their defaults.

    Args:
        mapping: keys to values, nested like the classes.
        cls: dataclass to build.
        path: dotted path of the mapping, for messages.

    Raises:
        ParameterError: states key, value and allowed values; for an unknown key the nearest known one.
    """
    if not isinstance(mapping, Mapping):
        raise ParameterError(path or "(top)", mapping, f"{files.brief(mapping)} is not a mapping of keys to values")
    hints = _hints(cls)  # type: ignore[arg-type]  # a class is hashable
    names = [item.name for item in dataclasses.fields(cls)]  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for key, value in mapping.items():
        name = str(key) if len(str(key)) <= _LONGEST_KEY else files.brief(key)
        where = f"{path}.{name}" if path else name
        if key not in names:
            known = did_you_mean(key, names) or f"; known are {', '.join(names)}"
            raise ParameterError(where, value, f"unknown key{known}")
        values[key] = _convert(value, hints[key], where)
    try:
        return cls(**values)
    except ParameterError as error:
        raise ParameterError(f"{path}.{error.key}" if path else error.key, error.value, error.problem) from None


def _convert(value: Any, hint: Any, where: str) -> Any:
    """Convert a value to the type of its field; the field checks it afterwards."""
    if dataclasses.is_dataclass(hint) and isinstance(hint, type):
        return from_mapping(value, hint, where)
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        return None if value is None else _convert(value, arguments[0], where)
    if origin is tuple:
        if not isinstance(value, list | tuple):
            raise ParameterError(where, value, f"{files.brief(value)} is not a list")
        return tuple(_convert(entry, arguments[0], f"{where}[{index}]") for index, entry in enumerate(value))
    return float(value) if hint is float and type(value) is int else value
