# SPDX-License-Identifier: Apache-2.0
"""Parameters of a node: declared, set by a file of measured servos, changed while it runs, and work at such a rate."""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException, ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from deltacharger_core import files, servo_types, yaml_file
from deltacharger_core.parameters import Declaration, ParameterError, declared, did_you_mean
from deltacharger_core.ros import log, node_support

T = TypeVar("T")

_OF_EVERY_NODE = {"use_sim_time", "start_type_description_service"}
_WIDER = {Parameter.Type.INTEGER: Parameter.Type.DOUBLE, Parameter.Type.INTEGER_ARRAY: Parameter.Type.DOUBLE_ARRAY}


def declare_all(node: Node, table: type[T], defaults: Any = None, prefix: str = "") -> T:
    """Declare every parameter of a class on the node, and return their values.

    Integers are accepted for floats, because ROS reads `rate:=50` and YAML's `rate: 50` as integers.

    Args:
        node: owner of the parameters.
        table: a parameter class without groups.
        defaults: object with attributes of the same names, in place of the class's defaults.
        prefix: of the parameters' names on the node, for one of several of this class.

    Raises:
        StartupError: a given value has another type, lies outside its bounds or contradicts another one.
    """
    values: dict[str, Any] = {}
    for each in declared(table):
        default = each.default if defaults is None else getattr(defaults, each.name)
        named = replace(each, name=prefix + each.name)
        values[each.name] = _declare(node, named, default, each.description())
    try:
        return table(**values)
    except ParameterError as error:
        raise _refusal(node, prefix + error.key, error.problem) from error


def declare_with_servos(node: Node, defaults: T, follows: Mapping[str, str]) -> T:
    """Declare every parameter of an object's class; those of its servos take their values from `servos_file`.

    With a `servos_file` its values are used and shown in the parameters. A parameter that is given as well must have
    the same value.

    Args:
        node: owner of the parameters.
        defaults: of a parameter class without groups.
        follows: parameter name to key in the file, for the parameters that the file sets.

    Raises:
        StartupError: the file is missing or invalid, a value is out of range, or a given parameter differs.
    """
    servos = declare_file(
        node, servo_types.ServosFileParameters, lambda path: yaml_file.read_declared(path, servo_types.MeasuredServos)
    )
    if servos is None:
        return declare_all(node, type(defaults), defaults)
    file = node.get_parameter("servos_file").value
    measured = {name: getattr(servos, key) for name, key in follows.items()}
    try:
        given = declare_all(node, type(defaults), replace(defaults, **measured))  # type: ignore[type-var]
    except (node_support.StartupError, ValueError) as error:
        raise node_support.StartupError(f"{error} (servos_file '{file}')") from error
    for name, value in measured.items():
        if getattr(given, name) != value:
            raise node_support.StartupError(
                f"{node.get_name()}: parameter '{name}' is {getattr(given, name)!r}, but parameter 'servos_file' "
                f"('{file}') has {value!r}; remove '{name}', or measure the servos again"
            )
    return given


def declare_file(node: Node, table: type[Any], read: Callable[[Path], T]) -> T | None:
    """Declare the only parameter of a class, the path of a file, and return what `read` makes of it; None = no file.

    Raises:
        StartupError: the file is missing or invalid.
    """
    ((name, file),) = asdict(declare_all(node, table)).items()
    if not file:
        return None
    where = files.given_path(file).absolute()
    try:
        return read(where)
    except OSError as error:
        problem = f"'{where}' cannot be read: {error.strerror or error}; give the path of such a file, or remove it"
    except ValueError as error:
        problem = str(error)
    raise _refusal(node, name, problem)


def was_given(node: Node, name: str) -> bool:
    """Return whether a parameter was given to the node, and not just left at its default."""
    return name in node._parameter_overrides  # private, but rclpy's only source for it


def show_values(node: Node, values: Mapping[str, Any]) -> None:
    """Show in parameters that were not given what the node uses instead of their defaults, as it found out since."""
    for name, value in values.items():
        node._parameters[name] = Parameter(name, value=value)  # private: rclpy changes no read-only parameter


def reject_unknown(node: Node) -> None:
    """Refuse given parameters that the node does not have; call it after all are declared.

    Those that a parameter file gives to all nodes may belong to another node: they are ignored, with a warning.
    It also makes later settings accept integers for floats.

    Raises:
        StartupError: names the parameter and the nearest known one.
    """
    known = set(node.get_parameters_by_prefix("")) | _OF_EVERY_NODE
    given = {name for name in node._parameter_overrides if not name.startswith("qos_overrides.")}
    unknown = given - known
    ignored = unknown & _of_all_nodes() if unknown else set()
    for name in sorted(unknown - ignored):
        raise node_support.StartupError(
            f"{node.get_name()}: unknown parameter '{name}'{did_you_mean(name, sorted(known))}"
        )
    if ignored:
        names = ", ".join(sorted(ignored))
        log.Log(node).warning(f"unknown parameters of a section for all nodes are ignored: {names}")

    this = weakref.ref(node)  # weak: a node that fails to start must be freed

    def changes(given: list[Parameter[Any]]) -> list[Parameter[Any]]:
        if (node := this()) is None:
            return given
        return [
            _widened(each, node.describe_parameter(each.name).type) if node.has_parameter(each.name) else each
            for each in given
        ]

    node.add_pre_set_parameters_callback(changes)


def _of_all_nodes() -> set[str]:
    """Return the parameters that parameter files of the command line give to all nodes.

    A file of launch holds what a launch file gives to one node, although its section is for all.
    """
    names: set[str] = set()
    for option, file in pairwise(sys.argv):
        if option == "--params-file" and not Path(file).name.startswith("launch_params_"):
            with contextlib.suppress(OSError, ValueError):  # ROS has read it; this reader is stricter
                sections = yaml_file.read_yaml(file) or {}
                names |= {name for each in ("/**", "*") for name in _flat(sections.get(each))}
    return {name.removeprefix("ros__parameters.") for name in names}


def _flat(given: Any, prefix: str = "") -> set[str]:
    """Return the names of nested parameters, joined by dots."""
    if not isinstance(given, dict):
        return {prefix.rstrip(".")}
    return {name for key, value in given.items() for name in _flat(value, f"{prefix}{key}.")}


def _declare(node: Node, each: Declaration, default: Any, description: str) -> Any:
    """Declare one parameter and return its value, several as a tuple."""
    several = isinstance(each.default, tuple)
    usual = [each.kind(item) for item in default] if several else each.kind(default)
    if each.kind is float and each.name in node._parameter_overrides:
        wanted = Parameter.Type.DOUBLE_ARRAY if several else Parameter.Type.DOUBLE
        node._parameter_overrides[each.name] = _widened(node._parameter_overrides[each.name], wanted.value)
    try:
        value = node.declare_parameter(each.name, usual, _descriptor(each, description)).value
    except (InvalidParameterTypeException, InvalidParameterValueException, ParameterException) as error:
        raise _refusal(node, each.name, f"{error}. {description}") from error
    value = tuple(value) if several else value
    if problem := each.problem(value):
        raise _refusal(node, each.name, f"{problem}. {description}")
    return value


def _widened(given: Parameter[Any], wanted: int) -> Parameter[Any]:
    """Return a parameter with integers converted to floats if `wanted` is the float type; otherwise unchanged."""
    wider = _WIDER.get(given.type_)
    if wider is None or wider.value != wanted:
        return given
    value = list(map(float, given.value)) if wider is Parameter.Type.DOUBLE_ARRAY else float(given.value)
    return Parameter(given.name, wider, value)


def _descriptor(each: Declaration, description: str) -> ParameterDescriptor:
    descriptor = ParameterDescriptor(name=each.name, description=description, read_only=not each.tunable)
    descriptor.dynamic_typing = each.default == ()  # from an empty list rclpy would infer bytes
    if each.choices:
        descriptor.additional_constraints = "one of: " + ", ".join(each.choices)
    elif not math.isfinite(each.low):
        pass
    elif isinstance(each.default, tuple):
        descriptor.additional_constraints = f"{each.low} to {each.high}"
    elif each.kind is int:
        descriptor.integer_range = [IntegerRange(from_value=int(each.low), to_value=int(each.high), step=0)]
    else:
        bounds = FloatingPointRange(from_value=float(each.low), to_value=float(each.high), step=0.0)
        descriptor.floating_point_range = [bounds]
    return descriptor


def _refusal(node: Node, name: str, problem: str) -> node_support.StartupError:
    return node_support.StartupError(f"{node.get_name()}: parameter '{name}': {problem}")


_LAST = 2.0  # s for running work to end when its node closes


class Tuning(Generic[T]):
    """Makes the tunable parameters of a table settable while their node runs; one table per node.

    One call sets all its values or none, and the answer states the reason. rclpy refuses read-only parameters and wrong
    types; this class also refuses values outside their bounds, contradicting values, and changes that the node does not
    accept now.

    Args:
        node: has declared the table with `declare_all` and called `reject_unknown`.
        given: the declared values.
        take: applies new values and returns '', or returns the reason of a refusal; must not wait.
    """

    def __init__(self, node: Node, given: T, take: Callable[[T], str]) -> None:
        self._log = log.Log(node)
        self._given = given
        self._take = take
        self._lock = threading.Lock()
        self._several = {each.name: isinstance(each.default, tuple) for each in declared(type(given))}
        node.add_on_set_parameters_callback(self._on_set)

    def _on_set(self, parameters: Sequence[Parameter[Any]]) -> SetParametersResult:
        """Apply new values. rclpy has already checked type and access, and no later callback refuses."""
        values = {each.name: each.value for each in parameters if each.name in self._several}
        changes = {name: tuple(value) if self._several[name] else value for name, value in values.items()}
        with self._lock:
            try:
                given = replace(self._given, **changes)  # type: ignore[type-var]
            except ParameterError as error:
                return SetParametersResult(successful=False, reason=str(error))
            reason = self._take(given) if given != self._given else ""
            if reason:
                return SetParametersResult(successful=False, reason=f"{', '.join(changes)} not set: {reason}")
            self._given = given
        for name, value in changes.items():
            self._log.info(f"{name} set to {value!r}")
        return SetParametersResult(successful=True)


class Regularly:
    """A thread that works at a rate; no thread at rate 0.

    Args:
        work: called with its period (s) and an event; it must return when the event is set.
        name: name of the thread.
        rate: Hz.
    """

    def __init__(self, work: Callable[[float, threading.Event], None], name: str, rate: float) -> None:
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        if rate > 0.0:
            self._thread = threading.Thread(target=work, args=(1.0 / rate, self._stopping), name=name, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Stop, and wait for running work. Safe to call twice."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(_LAST)
