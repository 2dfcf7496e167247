# SPDX-License-Identifier: Apache-2.0
"""The parameters of servo_node and tactile_node."""

import math
from dataclasses import dataclass

from deltacharger_core import machine, parameters
from deltacharger_core.parameters import number, numbers, words

REPLY_MARGIN = 0.02
"""s beyond wire time and USB latency until a reply in the cycle counts as lost. A healthy servo answers in 1 ms. The
margin covers scheduling delays of an ordinary kernel and costs nothing until a servo fails."""
STALL_MARGIN = 0.03
"""s added while all servos answer: then this computer is late rather than a servo silent. Beside other programs the
ordinary scheduler wakes a process 40 ms late; a lost reply would have every servo asked by itself."""
BOARD_MARGIN = 0.03
"""s added if the servos are connected to the board: pad sampling and tactile frames have precedence, and on a busy
computer bytes also wait for tactile_node."""

SERVOS_FOLLOW = {name: name for name in ("torque_constant", "position_p_gain", "position_d_gain")}
"""Parameters of servo_node that a file of measured servos sets, and their names in that file."""
OF_TYPE = (*SERVOS_FOLLOW, "current_max")
"""Parameters of servo_node that go with the type of the servos where nobody sets them; the defaults are the MX-64's."""


@dataclass(frozen=True)
class ServoNodeParameters(parameters.Bounded):
    """Parameters of servo_node: its bus, its servos and their limits.

    Raises:
        ParameterError: a value lies outside its bounds, or two contradict each other.
    """

    port: str = words(
        "/dev/ttyUSB0",
        f"serial port of the servos; `{machine.BEHIND_BOARD}`: they are connected to the board with the pads",
    )
    baud_rate: int = number(machine.BAUD_RATE, 9600, 4_000_000, "bit/s", "speed of the servos' bus")
    ids: tuple[int, ...] = numbers(machine.SERVO_IDS, 0, 252, "", "servo ids of limbs 0, 1, 2")
    rate: float = number(100.0, 20.0, 200.0, "Hz", "bus cycles per second")
    zero_ticks: tuple[int, ...] = numbers(
        (2048, 2048, 2048),
        -machine.EXTENDED_TICKS,
        machine.EXTENDED_TICKS,
        "",
        "encoder count at arm angle 0, per limb",
    )
    direction: tuple[int, ...] = numbers(
        (1, 1, 1), -1, 1, "", "per limb: 1 if the count rises with the angle, -1 if it falls"
    )
    torque_constant: float = number(machine.TORQUE_CONSTANT, 0.1, 10.0, "N·m/A", "torque per current of a servo")
    current_max: float = number(
        machine.STALL_CURRENT, 0.0, machine.STALL_CURRENT, "A", "largest current bound a trajectory may set"
    )
    position_p_gain: int = number(
        machine.POSITION_P_GAIN,
        1,
        machine.GAIN_MAX,
        "",
        "servos' position P gain, register 84: 434 = 15 N·m/rad; the vendor's is 850",
    )
    position_d_gain: int = number(
        machine.POSITION_D_GAIN,
        0,
        machine.GAIN_MAX,
        "",
        "servos' position D gain, register 80: nothing else brakes in mode 5",
    )
    joint_min: float = number(machine.JOINT_MIN, -math.pi, math.pi, "rad", "smallest arm angle")
    joint_max: float = number(machine.JOINT_MAX, -math.pi, math.pi, "rad", "largest arm angle")
    reply_margin: float = number(REPLY_MARGIN, 0.002, 0.1, "s", "margin until a reply counts as missing")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.joint_min >= self.joint_max:
            raise parameters.ParameterError(
                "joint_min", self.joint_min, f"{self.joint_min!r} is not below 'joint_max' ({self.joint_max!r})"
            )


@dataclass(frozen=True)
class TactileNodeParameters(parameters.Bounded):
    """Parameters of tactile_node."""

    port: str = words("/dev/ttyACM0", "serial port of the board")
    rate: float = number(machine.FRAME_RATE, 1.0, 200.0, "Hz", "tactile frames per second")
