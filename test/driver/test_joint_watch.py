# SPDX-License-Identifier: Apache-2.0
"""By dice: whatever turns, zeros and trajectories, no shaft leaves its bounds or is sent faster than declared."""

from __future__ import annotations

import contextlib
import math
import random
from typing import Any

import pytest

from deltacharger_core.machine import JOINT_MAX, JOINT_MIN, JOINT_SPEED, TICKS_PER_TURN
from deltacharger_driver.emulators.servo_bus import ServoBusEmulator
from deltacharger_driver.errors import ServoFault, TrajectoryRefused
from deltacharger_driver.servos.bus import ServoPhase
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.motion import JointLimits, ServoWaypoint, check
from deltacharger_driver.servos.registers import TICK, BusSettings

from ..marks import night
from ..plants import BenchArm
from .servo_rig import NAMES
from .virtual_line import Clock, Line

_BEYOND = 0.09 + 0.03  # rad: what servo_node allows, and what a shaft turns until it has stopped
_BURST = 0.81  # rad that a goal may jump: twice what a spring of 15 N·m/rad, four times softer, yields under 0.83 A
LIMITS = JointLimits(NAMES, JOINT_MIN, JOINT_MAX, 4.4)


def play(seed: int) -> tuple[bool, int]:
    """Power up an arm and send it trajectories; return whether it got torque, and how many were refused."""
    dice = random.Random(seed)
    clock = Clock()
    arm = BenchArm(
        tuple(dice.uniform(-math.pi, math.pi) for _ in range(3)) if dice.random() < 0.3 else (0.1,) * 3, clock
    )
    signs = tuple(dice.choice((1, -1)) for _ in range(3))
    zeros = tuple(
        2048 + TICKS_PER_TURN * dice.randint(-2, 2) + dice.choice((0, dice.randint(-300, 300))) for _ in range(3)
    )

    def shafts() -> list[float]:
        """Return the joints' angles (rad) by how the servos are mounted, without whole turns."""
        ticks = [angle / TICK + 2048 for angle in arm.angles]
        return [math.remainder(s * (t - z) * TICK, math.tau) for s, t, z in zip(signs, ticks, zeros, strict=True)]

    refused = 0
    emulator = ServoBusEmulator(arm)
    with Line(emulator, clock) as line:
        settings = BusSettings(line.path, torque_constant=1.463, zero_ticks=zeros, direction=signs)
        controller = ServoController(settings, handler=line.handler)
        controller.open()
        request = controller.request("torque_on")
        for _ in range(20):
            controller.cycle()
            if request.wait(0.0):
                break
        before, goals, ahead, at = shafts(), [math.nan] * 3, [0.0] * 3, clock()
        if not request.success:
            assert "stands at" in request.message, request.message
            assert any(not JOINT_MIN - 0.09 <= angle <= JOINT_MAX + 0.09 for angle in before)
            controller.close()
            return False, 0
        for _ in range(4):
            count = dice.randint(1, 3)
            times = sorted(dice.choice((0.0, dice.uniform(0.0, 1.0))) + 0.001 * index for index in range(count))
            rows: list[Any] = [(at, [dice.uniform(JOINT_MIN, JOINT_MAX) for _ in range(3)]) for at in times]
            with contextlib.suppress(ServoFault):
                try:
                    controller.submit(check(NAMES, [ServoWaypoint(*row) for row in rows], LIMITS))
                except TrajectoryRefused:
                    refused += 1
            for _ in range(dice.randint(1, 25)):
                report = controller.cycle()
                clock.sleep(0.005)
                for index, angle in enumerate(shafts()):
                    assert JOINT_MIN - _BEYOND <= angle <= JOINT_MAX + _BEYOND, (index, angle)
                passed, at = max(clock() - at, 0.01), clock()
                sent = [command[1] if command and command[0] else math.nan for command in arm.commands]
                for index, (new, old) in enumerate(zip(sent, goals, strict=True)):
                    if (
                        math.isfinite(new) and math.isfinite(old) and report.phase is ServoPhase.ON
                    ):  # a stop holds at once
                        ahead[index] = max(ahead[index] + abs(new - old) - JOINT_SPEED * passed, 0.0)
                        assert ahead[index] <= _BURST + 0.05, (index, new, old, report.phase)
                goals = sent
        controller.close()
    return True, refused


@pytest.mark.parametrize("count", [6, night(400)])
def test_no_shaft_leaves_its_bounds_or_is_sent_faster_than_declared(count: int) -> None:
    played = [play(seed) for seed in range(count)]
    assert 0 < sum(torque for torque, _ in played) < count
    assert any(refused for _, refused in played)
