# SPDX-License-Identifier: Apache-2.0
"""The parameters of the mock nodes, and the fault that each may be given while it runs."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from deltacharger_core import machine, texts
from deltacharger_core.parameters import Bounded, choice, number

SERVO_FAULTS = ("none", "silence")
TACTILE_FAULTS = ("none", "silence", "short", "contactor_refusal")
DETECTOR_FAULTS = ("none", "nothing", "beyond_reach", "leaning")
NAVIGATOR_FAULTS = ("none", "abort")
_FAULT = "fault to produce"


@dataclass(frozen=True)
class MockServoNodeParameters(Bounded):
    """How the mock servos misbehave."""

    fault: str = choice("none", SERVO_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockTactileNodeParameters(Bounded):
    """Pose of the target that the mock pads feel."""

    target_x: float = number(0.0, -0.1, 0.1, "m", "midpoint of the target's electrodes along x")
    target_y: float = number(0.0, -0.1, 0.1, "m", "midpoint of the target's electrodes along y")
    target_angle: float = number(0.0, -math.pi / 2, math.pi / 2, "rad", "of the target about +z")
    fault: str = choice("none", TACTILE_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockDetectorNodeParameters(Bounded):
    """Reported pose of the electrodes."""

    x: float = number(0.0, -1.0, 1.0, "m", "electrodes along x of charger_base")
    y: float = number(0.0, -1.0, 1.0, "m", "electrodes along y of charger_base")
    z: float = number(machine.DOCK_DISTANCE, -1.0, 1.0, "m", "electrodes along z of charger_base")
    roll: float = number(0.0, -math.pi / 2, math.pi / 2, "rad", "of the electrodes about z")
    fault: str = choice("none", DETECTOR_FAULTS, _FAULT, tunable=True)


@dataclass(frozen=True)
class MockNavigatorNodeParameters(Bounded):
    """Start and driving of the mock base."""

    x: float = number(0.0, -texts.ON_MAP, texts.ON_MAP, "m", "initial x of the base; y and yaw are 0")
    speed: float = number(0.5, 0.01, 1000.0, "m/s", "of the base; it turns at twice as many rad/s")
    fault: str = choice("none", NAVIGATOR_FAULTS, _FAULT, tunable=True)


def fault_switch(node: Any, faults: Sequence[str]) -> Callable[[], str]:
    """Return what returns the present value of a node's declared parameter `fault`; unknown values are refused."""
    from rcl_interfaces.msg import SetParametersResult  # not to read parameters

    def check(parameters: Sequence[Any]) -> SetParametersResult:
        wrong = [each.value for each in parameters if each.name == "fault" and each.value not in faults]
        reason = f"fault '{wrong[0]}' is unknown: give one of {', '.join(faults)}" if wrong else ""
        return SetParametersResult(successful=not wrong, reason=reason)

    node.add_on_set_parameters_callback(check)
    return lambda: str(node.get_parameter("fault").value)
