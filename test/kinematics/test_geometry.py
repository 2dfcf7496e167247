# SPDX-License-Identifier: Apache-2.0
"""Geometries as values and files: impossible ones are refused by name."""

import math
from pathlib import Path
from typing import Any

import pytest

from deltacharger_kinematics import DeltaGeometry, LimbAdjustment
from deltacharger_kinematics.geometry import load_geometry, save_geometry

CALIBRATED = DeltaGeometry(
    arm=0.1002,
    z_offset=0.0951,
    limbs=(LimbAdjustment(angle_offset=0.012, rod=0.1801), LimbAdjustment(), LimbAdjustment(tangential_offset=-3.1e-4)),
)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, 0.0) for name in ("base_radius", "arm", "rod", "platform_radius")),
        *(("arm", value) for value in (-0.1, math.nan, math.inf, "0.1", True)),
        ("joint_min", 2.0),
        ("workspace_min", (0.0, 0.0, 0.2)),
        ("workspace_max", (0.1, 0.1, math.nan)),
        ("limbs", (LimbAdjustment(),) * 2),
    ],
)
def test_impossible_values_are_refused_by_name(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=name):
        DeltaGeometry(**{name: value})


def test_a_file_keeps_every_digit(tmp_path: Path) -> None:
    path = tmp_path / "geometry.yaml"
    save_geometry(CALIBRATED, path, "made by a test\nsecond line")
    assert load_geometry(path) == CALIBRATED
    assert path.read_text().startswith("# made by a test\n# second line\n")


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"armm: 0.1", "armm.*'arm'"),
        (b"limbs: [{}, {}]", "limbs"),
        (b"limbs: [{}, {}, {rodd: 0.18}]", r"limbs\[2\]\.rodd.*'rod'"),
    ],
)
def test_a_bad_file_is_refused_with_its_name_and_the_key(tmp_path: Path, content: bytes, named: str) -> None:
    path = tmp_path / "geometry.yaml"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"geometry\.yaml(?s:.*){named}"):
        load_geometry(path)
    with pytest.raises(OSError, match="none"):
        load_geometry(tmp_path / "none.yaml")
