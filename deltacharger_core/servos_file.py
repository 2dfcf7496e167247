# SPDX-License-Identifier: Apache-2.0
"""YAML files of measured servos: written by `deltacharger calibrate servos`, read by the nodes that use the servos."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deltacharger_core.machine import GAIN_MAX, POSITION_D_GAIN, POSITION_P_GAIN, SERVO_STIFFNESS, TORQUE_CONSTANT
from deltacharger_core.parameters import Bounded, ParameterError, number, words
from deltacharger_core.yaml_file import read_declared, write_yaml

STIFFNESS_MIN, STIFFNESS_MAX = 0.5, 160.0
"""N·m/rad, range that docking accepts."""


@dataclass(frozen=True)
class ServosFileParameters(Bounded):
    """Path of the file of measured servos."""

    servos_file: str = words("", "YAML file of `deltacharger calibrate servos`; the only source of the values in it")


@dataclass(frozen=True)
class MeasuredServo(Bounded):
    """One servo, or the mean of all: values and their standard errors; None = not given."""

    stiffness: float = number(SERVO_STIFFNESS, STIFFNESS_MIN, STIFFNESS_MAX, "N·m/rad", "of the position loop")
    stiffness_error: float | None = number(None, 0.0, STIFFNESS_MAX, "N·m/rad", "its standard error")
    torque_constant: float = number(TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current")
    torque_constant_error: float | None = number(None, 0.0, 10.0, "N·m/A", "its standard error")
    friction: float | None = number(None, 0.0, 3.0, "N·m", "of the powered gear")
    friction_error: float | None = number(None, 0.0, 3.0, "N·m", "its standard error")
    backlash: float | None = number(None, 0.0, 0.1, "rad", "play between encoder and arm, from stop to stop")
    backlash_error: float | None = number(None, 0.0, 0.1, "rad", "its standard error")
    damping: float | None = number(None, -1.0, 10.0, "N·m·s/rad", "of the position loop, by the D gain")
    damping_error: float | None = number(None, 0.0, 10.0, "N·m·s/rad", "its standard error")


@dataclass(frozen=True)
class MeasuredServos(MeasuredServo):
    """The servos of an arm: the means that nodes use, the gains of the measurement, and each servo.

    Raises:
        ParameterError: a value lies outside its bounds, or there are not three servos.
    """

    friction_share: float | None = number(None, -1.0, 1.0, "", "share of the torque that friction takes besides")
    position_p_gain: int = number(POSITION_P_GAIN, 1, GAIN_MAX, "", "P gain during the measurement")
    position_i_gain: int = number(0, 0, GAIN_MAX, "", "I gain during the measurement")
    position_d_gain: int = number(POSITION_D_GAIN, 0, GAIN_MAX, "", "D gain during the measurement")
    servos: tuple[MeasuredServo, MeasuredServo, MeasuredServo] = field(
        default_factory=lambda: (MeasuredServo(), MeasuredServo(), MeasuredServo())
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.servos) != 3:
            raise ParameterError("servos", self.servos, f"has {len(self.servos)} servos; give three or none")


def load_servos(path: str | Path) -> MeasuredServos:
    """Read a file of measured servos; errors as in `read_declared`."""
    return read_declared(path, MeasuredServos)


def save_servos(servos: MeasuredServos, path: str | Path, comment: str = "") -> None:
    """Write measured servos atomically, with `comment` above them.

    Raises:
        OSError: the file cannot be written.
    """
    write_yaml(path, servos_to_mapping(servos), comment)


def servos_to_mapping(servos: MeasuredServos) -> dict[str, Any]:
    """Return measured servos as plain numbers, lists and mappings, without values that are not given."""
    content = dataclasses.asdict(servos)
    return {
        **{name: value for name, value in content.items() if name != "servos" and value is not None},
        "servos": [{name: value for name, value in each.items() if value is not None} for each in content["servos"]],
    }
