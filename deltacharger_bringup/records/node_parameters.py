# SPDX-License-Identifier: Apache-2.0
"""Read the parameters of a charger's nodes by the standard services; derive docking settings and geometry from them."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from rcl_interfaces.srv import GetParameters, ListParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python

from deltacharger_bringup.records.recording.folder import PARAMETERS
from deltacharger_core import files, mcap_file, parameters
from deltacharger_core.ros.qos import SERVICE
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import DeltaGeometry, geometry_to_mapping, load_geometry

_FILE, _GEOMETRY = "geometry_file", "geometry"


class ParameterReader:
    """Reads all parameters of another node.

    Args:
        node: that asks; its executor must run.
        name: of the other node, in the same namespace.
    """

    def __init__(self, node: Node, name: str) -> None:
        self._names: Any = node.create_client(ListParameters, f"{name}/list_parameters", qos_profile=SERVICE)
        self._values: Any = node.create_client(GetParameters, f"{name}/get_parameters", qos_profile=SERVICE)

    def is_ready(self) -> bool:
        """Whether the other node's services are available."""
        return bool(self._names.service_is_ready() and self._values.service_is_ready())

    def ask(self, take: Callable[[dict[str, Any]], None]) -> None:
        """Call `take` with the parameters, arrays as tuples; never if the node does not answer."""

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


def with_geometry(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return docking_node's parameters with the content of its geometry file, if that is readable on this computer."""
    try:
        return {**values, _GEOMETRY: geometry_to_mapping(load_geometry(files.given_path(values[_FILE])))}
    except (LookupError, OSError, ValueError):
        return dict(values)


def docking_settings(values: Mapping[str, Any]) -> tuple[DockingParameters, DeltaGeometry]:
    """Return docking_node's settings from its parameters; missing ones have their defaults.

    Raises:
        OSError: its geometry file cannot be read on this computer.
        ValueError: a value is refused.
    """
    if _GEOMETRY in values:
        geometry = parameters.from_mapping(values[_GEOMETRY], DeltaGeometry)
    else:
        geometry = load_geometry(files.given_path(values[_FILE])) if values.get(_FILE) else DeltaGeometry()
    names = {item.name for item in fields(DockingParameters)}
    return DockingParameters(**{name: _plain(value) for name, value in values.items() if name in names}), geometry


def known_settings(values: Mapping[str, Any]) -> tuple[DockingParameters, DeltaGeometry]:
    """As `docking_settings`, with the default geometry if its file is on another computer."""
    try:
        return docking_settings(values)
    except OSError:
        return docking_settings({**values, _FILE: ""})


def recorded_settings(file: mcap_file.McapFile) -> tuple[DockingParameters, DeltaGeometry] | None:
    """Return a record's settings; None if they were not recorded.

    Raises:
        RecordingError: they are invalid.
    """
    values = file.metadata_named(PARAMETERS)
    try:
        return known_settings({name: files.parse_json(text) for name, text in values[-1].items()}) if values else None
    except (ValueError, TypeError) as error:
        raise mcap_file.RecordingError(f"{file.path}: invalid parameters of docking_node: {error}") from error


def _plain(value: Any) -> Any:
    return tuple(value) if hasattr(value, "__iter__") and not isinstance(value, str) else value
