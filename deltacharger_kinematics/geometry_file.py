# SPDX-License-Identifier: Apache-2.0
"""A geometry as YAML: what a calibration writes and a node reads."""

from __future__ import annotations

import dataclasses
import difflib
import numbers
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deltacharger_core.yaml_file import read_yaml, write_yaml
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, LimbAdjustment


def load_geometry(path: str | Path) -> DeltaGeometry:
    """Read a geometry file; keys that it leaves out keep their defaults.

    Raises:
        OSError: the file cannot be read.
        ValueError: names the file and the key; not YAML, an unknown key or an impossible value.
    """
    content = read_yaml(path)
    try:
        return geometry_from_mapping({} if content is None else content)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def save_geometry(geometry: DeltaGeometry, path: str | Path, comment: str = "") -> None:
    """Write `geometry` with every key and every digit, `comment` above it.

    Raises:
        OSError: the file cannot be written.
    """
    write_yaml(path, geometry_to_mapping(geometry), comment)


def geometry_to_mapping(geometry: DeltaGeometry) -> dict[str, Any]:
    """Return `geometry` as plain numbers, lists and mappings; what a limb leaves at its default is left out."""
    mapping = dataclasses.asdict(geometry)
    for key in ("workspace_min", "workspace_max"):
        mapping[key] = [float(value) for value in mapping[key]]
    neutral = dataclasses.asdict(LimbAdjustment())
    mapping["limbs"] = [
        {key: float(value) for key, value in limb.items() if value != neutral[key]} for limb in mapping["limbs"]
    ]
    return {key: float(value) if isinstance(value, numbers.Real) else value for key, value in mapping.items()}


def geometry_from_mapping(mapping: Any) -> DeltaGeometry:
    """Return the geometry that `mapping` describes.

    Raises:
        ValueError: names the key; it is unknown or its value is impossible.
    """
    values = _known(mapping, DeltaGeometry, "")
    for key in ("workspace_min", "workspace_max"):
        if isinstance(values.get(key), list):
            values[key] = tuple(values[key])
    if "limbs" in values:
        limbs = values["limbs"]
        if not isinstance(limbs, list) or len(limbs) != LIMB_COUNT:
            raise ValueError(f"limbs: {limbs!r} is not a list of three mappings")
        values["limbs"] = tuple(_limb(limb, f"limbs[{index}]") for index, limb in enumerate(limbs))
    return DeltaGeometry(**values)


def _limb(mapping: Any, where: str) -> LimbAdjustment:
    values = _known({} if mapping is None else mapping, LimbAdjustment, f"{where}.")
    try:
        return LimbAdjustment(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def _known(mapping: Any, cls: type[Any], prefix: str) -> dict[str, Any]:
    if not isinstance(mapping, Mapping):
        raise ValueError(f"{prefix or 'the file'} is {mapping!r}: give a mapping of keys to values")
    names = [field.name for field in dataclasses.fields(cls)]
    for key in mapping:
        if key not in names:
            near = difflib.get_close_matches(str(key), names, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(names)}"
            raise ValueError(f"{prefix}{key}: unknown key; {hint}")
    return dict(mapping)
