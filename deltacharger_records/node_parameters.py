# SPDX-License-Identifier: Apache-2.0
"""What a charger's nodes are set to, asked by the standard services; what docking_node and its arm are by that."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from deltacharger_core.bounded_file import given_path, parse_json
from deltacharger_core.mcap_file import McapFile, RecordingError
from deltacharger_core.parameters import from_mapping
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.geometry_file import geometry_to_mapping, load_geometry
from deltacharger_records.recording.folder import PARAMETERS
from deltacharger_ros.qos import SERVICE

_FILE, _GEOMETRY = "geometry_file", "geometry"


class ParameterReader:
    """Asks another node for all its parameters.

    Args:
        node: asks; its executor must run.
        name: of the other, in the same namespace.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._names: Any = node.create_client(ListParameters, f"{name}/list_parameters", qos_profile=SERVICE)
        self._values: Any = node.create_client(GetParameters, f"{name}/get_parameters", qos_profile=SERVICE)

    def is_ready(self) -> bool:
        """Whether it can be asked."""
        return bool(self._names.service_is_ready() and self._values.service_is_ready())

    def ask(self, take: Callable[[dict[str, Any]], None]) -> None:
        """Have `take` called with what it answers, arrays as tuples; never where it does not answer."""

        def on_names(done: Any) -> None:
            if done.exception() is None and done.result() is not None:
                names = list(done.result().result.names)
                values = self._values.call_async(GetParameters.Request(names=names))
                values.add_done_callback(lambda found: on_values(names, found))

        def on_values(names: list[str], done: Any) -> None:
            if done.exception() is None and done.result() is not None:
                found = [parameter_value_to_python(value) for value in done.result().values]
                take({name: _plain(value) for name, value in zip(names, found, strict=False)})

        self._names.call_async(ListParameters.Request()).add_done_callback(on_names)


def with_geometry(told: Mapping[str, Any]) -> dict[str, Any]:
    """Return docking_node's parameters with the content of its geometry file, where that can be read here."""
    try:
        return {**told, _GEOMETRY: geometry_to_mapping(load_geometry(given_path(told[_FILE])))}
    except (LookupError, OSError, ValueError):
        return dict(told)


def docking_settings(told: Mapping[str, Any]) -> tuple[DockingParameters, DeltaGeometry]:
    """Return what docking_node's parameters say; what they leave out has its default.

    Raises:
        OSError: its geometry file cannot be read here.
        ValueError: a value is refused.
    """
    if _GEOMETRY in told:
        base = from_mapping(told[_GEOMETRY], DeltaGeometry)
    else:
        base = load_geometry(given_path(told[_FILE])) if told.get(_FILE) else DeltaGeometry()
    lengths = {name: _plain(value) for name, value in _of(DeltaGeometry, told).items() if name != "limbs"}
    return DockingParameters(**_of(DockingParameters, told)), replace(base, **lengths)


def known_settings(told: Mapping[str, Any]) -> tuple[DockingParameters, DeltaGeometry]:
    """Return the same, without the limbs' own adjustments where the geometry file is elsewhere."""
    try:
        return docking_settings(told)
    except OSError:
        return docking_settings({**told, _FILE: ""})


def recorded_settings(file: McapFile) -> tuple[DockingParameters, DeltaGeometry] | None:
    """Return the settings that a record tells; None where they were not recorded.

    Raises:
        RecordingError: they are none.
    """
    told = file.told(PARAMETERS)
    try:
        return known_settings({name: parse_json(text) for name, text in told[-1].items()}) if told else None
    except (ValueError, TypeError) as error:
        raise RecordingError(f"{file.path}: docking_node's parameters in it are refused: {error}") from error


def _of(kind: Any, told: Mapping[str, Any]) -> dict[str, Any]:
    return {item.name: told[item.name] for item in fields(kind) if item.name in told}


def _plain(value: Any) -> Any:
    return tuple(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
