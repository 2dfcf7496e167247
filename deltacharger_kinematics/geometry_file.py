# SPDX-License-Identifier: Apache-2.0
"""YAML files of a geometry, written by a calibration and read by nodes."""

from __future__ import annotations

import dataclasses
import numbers
from pathlib import Path
from typing import Any

from deltacharger_core.units import outside
from deltacharger_core.yaml_file import YamlError, read_declared, write_yaml
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment

LARGEST = 1.0  # m; a longer arm was written in millimetres


def load_geometry(path: str | Path) -> DeltaGeometry:
    """Read a geometry file; errors as in `read_declared`."""
    geometry = read_declared(path, DeltaGeometry)
    lengths = {name: getattr(geometry, name) for name in ("base_radius", "arm", "rod", "platform_radius", "z_offset")}
    far = max(map(abs, (*geometry.workspace_min, *geometry.workspace_max)))
    for name, value in (*lengths.items(), ("workspace_min and workspace_max", far)):
        if problem := outside(value, -LARGEST, LARGEST, "m"):
            raise YamlError(path, f"'{name}': {problem}")
    return geometry


def save_geometry(geometry: DeltaGeometry, path: str | Path, comment: str = "") -> None:
    """Write `geometry` with every key and every digit, with `comment` above it.

    Raises:
        OSError: the file cannot be written.
    """
    write_yaml(path, geometry_to_mapping(geometry), comment)


def geometry_to_mapping(geometry: DeltaGeometry) -> dict[str, Any]:
    """Return `geometry` as plain numbers, lists and mappings, without default values of limbs."""
    mapping = dataclasses.asdict(geometry)
    neutral = dataclasses.asdict(LimbAdjustment())
    mapping["limbs"] = [
        {key: float(value) for key, value in limb.items() if value != neutral[key]} for limb in mapping["limbs"]
    ]
    return {key: float(value) if isinstance(value, numbers.Real) else value for key, value in mapping.items()}
