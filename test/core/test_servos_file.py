# SPDX-License-Identifier: Apache-2.0
"""Files of measured servos: values survive writing and reading, invalid files are refused by name."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from deltacharger_core.machine import POSITION_P_GAIN, SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_core.servo_types import MeasuredServo, MeasuredServos, load_servos, save_servos

ONE = MeasuredServo(14.2, 0.3, 1.41, 0.03, 0.07, 0.002)
WHOLE = MeasuredServos(
    *(14.1, 0.28, 1.4, 0.03, 0.07, 0.001, 0.004, 0.0002, 0.7, 0.02, 0.2, 500, 1, 2),
    servos=(ONE, dataclasses.replace(ONE, backlash=0.004), ONE),
)


def test_a_written_file_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "servos.yaml"
    save_servos(WHOLE, path, "measured today")
    assert load_servos(path) == WHOLE
    assert path.read_text().startswith("# measured today\n")
    assert "null" not in path.read_text()  # missing values are omitted


def test_missing_keys_have_their_defaults(tmp_path: Path) -> None:
    path = tmp_path / "servos.yaml"
    path.write_text("stiffness: 8.5\n")
    loaded = load_servos(path)
    assert (loaded.stiffness, loaded.torque_constant, loaded.position_p_gain) == (8.5, TORQUE_CONSTANT, POSITION_P_GAIN)
    assert loaded.friction is None
    assert loaded.servos[0].stiffness == SERVO_STIFFNESS


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("stifness: 8.5", "did you mean 'stiffness'"),
        ("stiffness: 0.2", "stiffness.*outside 0.5 to 160"),
        ("stiffness: .nan", "stiffness.*not finite"),
        ("torque_constant: x", "torque_constant"),
        ("position_p_gain: 0", "position_p_gain"),
        ("position_p_gain: 434.5", "position_p_gain"),
        ("servos: [{stiffness: 8.0}]", "three"),
        ("servos: [{stiffness: 180.0}, {}, {}]", r"servos\[0\].stiffness"),
        ("[1, 2]", "not a mapping"),
    ],
)
def test_an_invalid_file_is_refused_by_name(tmp_path: Path, content: str, reason: str) -> None:
    path = tmp_path / "servos.yaml"
    path.write_text(content)
    with pytest.raises(ValueError, match=f"(?s)servos.yaml.*{reason}"):
        load_servos(path)
