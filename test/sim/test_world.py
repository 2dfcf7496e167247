# SPDX-License-Identifier: Apache-2.0
"""The complete world: contacts and their jitter, records, the emulators' plant, and reproducibility."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from deltacharger_core import machine, servo_types
from deltacharger_driver.servos.registers import REGISTERS, TICK
from deltacharger_sim import parameters
from deltacharger_sim.emulators.servo import OK
from deltacharger_sim.emulators.servo_bus import ServoBusEmulator
from deltacharger_sim.world import SharedWorld, World
from test.plain import plain_servo

ArmFactory = Callable[..., Any]
SIX_DEGREES = parameters.TargetParameters(roll=math.radians(6.0))


class Pads:
    """A tactile source that records its inputs and displaces docking n by n mm along y."""

    def __init__(self) -> None:
        self.dockings = 0
        self.asked: list[tuple[float, tuple[float, float, float] | None, float]] = []

    def begin_docking(self) -> tuple[float, float, float]:
        self.dockings += 1
        return 0.0, 0.001 * self.dockings, 0.01 * self.dockings

    def sample(
        self, time: float, pose: tuple[float, float, float] | None, force: float, share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        self.asked.append((time, pose, force))
        return np.zeros((10, 10)), np.zeros((10, 10))


class TestContact:
    def test_each_contact_has_its_own_jitter_which_affects_clearance(self, arm: ArmFactory) -> None:
        pads = Pads()
        touching = arm(parameters.WorldParameters(target=SIX_DEGREES), tactile=pads)
        clearances = []
        for docking in (1, 2):
            touching.go((0.0, 0.0, 0.07))
            assert touching.world.misalignment is None
            touching.go((0.0, 0.0, 0.086))
            x, y, angle = touching.world.misalignment
            position = touching.world.mechanics.position
            assert pads.dockings == touching.world.record.contacts == docking
            assert x == pytest.approx(-position[0])
            assert y == pytest.approx(0.001 * docking - position[1])
            assert angle == pytest.approx(math.radians(6.0) + 0.01 * docking)
            clearances.append(touching.world.snapshot().clearance)
            touching.go((0.0, 0.0, 0.05))
        assert clearances[1] < clearances[0] < 0.0036  # without jitter 3.58 mm


class TestRecord:
    def test_a_short_while_charging_is_recorded_and_one_without_energy_is_not(self, arm: ArmFactory) -> None:
        dragged = arm(parameters.WorldParameters(servo=plain_servo(), target=SIX_DEGREES))
        dragged.charge()
        for side in range(1, 61):
            dragged.go((0.0, 0.001 * side, 0.085), 0.1)
            if not dragged.world.circuit.closed:
                break
        assert dragged.power.fault == 2
        assert dragged.world.snapshot().clearance < 0.0
        assert dragged.world.record.energised_shorts == 1
        assert dragged.world.record.energised_unsafe > 0.0
        assert (dragged.world.record.parted_live, dragged.world.record.unpowered_live) == (0, 0)
        dead = arm(parameters.WorldParameters(target=parameters.TargetParameters(roll=math.radians(15.0))))
        dead.dock()
        assert dead.world.snapshot().clearance < 0.0
        assert (dead.world.record.energised_shorts, dead.world.record.energised_unsafe) == (0, 0.0)

    def test_torque_lost_before_the_current_and_current_broken_by_an_emergency_are_recorded(
        self, arm: ArmFactory
    ) -> None:
        hasty = arm()
        hasty.charge()
        hasty.release()
        hasty.run(0.2)
        assert hasty.world.record.unpowered_live == 1
        hasty.power.trip(2)
        hasty.run(0.01)
        assert hasty.world.record.broken_current == pytest.approx(10.0)


class TestServos:
    @pytest.mark.parametrize("share", [0.0, 0.1])
    def test_the_current_read_is_the_torque_with_noise_in_counts(self, arm: ArmFactory, share: float) -> None:
        still = arm(parameters.WorldParameters(servo=plain_servo(current_noise_share=share)))
        still.go((0.0, 0.0, 0.05))
        true = still.world.mechanics.torques[1] / (6.0 / 4.1)
        readings = np.array([still.world.servo(1)[2] for _ in range(2000)])
        assert readings.mean() == pytest.approx(true, abs=1e-3)
        assert readings.std() == pytest.approx(0.008 + share * abs(true), rel=0.1)
        assert readings / servo_types.MX_64.current_unit == pytest.approx(
            np.round(readings / servo_types.MX_64.current_unit), abs=1e-9
        )

    def test_play_lets_the_encoder_run_ahead_of_the_arm_by_at_most_half(self, arm: ArmFactory) -> None:
        loose = arm(parameters.WorldParameters(servo=plain_servo(friction=0.0, backlash=0.006), target=ALONE))
        tight = arm(parameters.WorldParameters(servo=plain_servo(friction=0.0), target=ALONE))
        for each in (loose, tight):
            each.go((0.0, 0.0, 0.05), 2.0)
        mechanics = loose.world.mechanics
        ahead = mechanics.slack
        assert max(map(abs, ahead)) <= 0.003 + 1e-12
        read = [loose.world.servo(index)[0] for index in range(3)]
        assert read == pytest.approx([a + b for a, b in zip(mechanics.angles, ahead, strict=True)], abs=0.5 * TICK)
        # Under constant weight, the arm is at one end of the play; the motors' load is unchanged.
        assert ahead[1] == pytest.approx(-0.003)
        assert ahead[2] == pytest.approx(0.003)
        assert mechanics.torques == pytest.approx(tight.world.mechanics.torques, abs=2e-3)
        assert tight.world.mechanics.slack == (0.0, 0.0, 0.0)

    def test_the_same_seed_gives_the_same_readings(self) -> None:
        worlds = [World(parameters.WorldParameters(), None, seed) for seed in (4, 4, 5)]
        for each in worlds:
            each.command(0, True, -0.5, 4.1)
            each.step()
        one, same, other = ([each.servo(0)[2] for _ in range(50)] for each in worlds)
        assert one == same != other


class Shared:
    """A world shared by the emulators, with a clock."""

    def __init__(self) -> None:
        self.now = 100.0
        self.world = World(parameters.WorldParameters())
        self.plant = SharedWorld(self.world, lambda: self.now)

    def after(self, seconds: float) -> float:
        """Return the world's time after a pause and an access."""
        self.now += seconds
        self.plant.read_power()
        return self.world.time


class TestSharedWorld:
    @pytest.mark.parametrize("period", [0.0073, 0.02])
    def test_time_passes_in_whole_steps_at_accesses_and_never_drifts(self, period: float) -> None:
        shared = Shared()
        for _ in range(round(2.0 / period)):
            passed = shared.after(period)
        assert passed == pytest.approx(shared.now - 100.0, abs=0.0051)
        assert passed / 0.005 == pytest.approx(round(passed / 0.005), abs=1e-6)

    def test_a_long_pause_is_skipped_and_a_clock_that_steps_back_pauses_the_world(self) -> None:
        shared = Shared()
        passed = shared.after(3600.0)
        assert passed <= 0.51
        assert shared.after(0.1) - passed == pytest.approx(0.1, abs=0.0051)
        passed = shared.world.time
        assert shared.after(-0.05) == passed


def test_a_refused_move_leaves_the_target_in_place() -> None:
    world = World(parameters.WorldParameters())
    for move in ((math.nan, 0.0, 0.0, 0.2), (0.001, 0.0, 0.0, 0.0), (0.001, 0.0, 0.0, math.inf), (0.3, 0.0, 0.0, 0.2)):
        with pytest.raises(ValueError, match=r"finite|outside"):
            world.move_target(*move)
    assert not world.target_moves
    world.step(0.01)
    assert world.parameters.target.x == 0.0


ALONE = parameters.TargetParameters(present=False)
QUIET = plain_servo(current_noise=0.0, friction=0.0)
GOALS = (0.1, 0.2, 0.15)


def settled(arm: Any, *gains: float) -> Any:
    """Let an arm rest at GOALS with these gains; return the torque over the deflection of each servo, N·m/rad."""
    for index, (goal, gain) in enumerate(zip(GOALS, gains, strict=True)):
        arm.world.command(index, True, goal, 4.1, gain)
    arm.run(3.0)
    mechanics = arm.world.mechanics
    return [
        torque / (goal - angle) for torque, goal, angle in zip(mechanics.torques, GOALS, mechanics.angles, strict=True)
    ]


class TestGains:
    def test_each_servo_has_its_own_gain_also_if_it_changes_at_rest(self, arm: ArmFactory) -> None:
        resting = arm(parameters.WorldParameters(servo=QUIET, target=ALONE))
        assert settled(resting, 1.0, 1.0, 1.0) == pytest.approx([15.0] * 3, rel=1e-4)
        assert settled(resting, 1.0, 0.5, 2.0) == pytest.approx([15.0, 7.5, 30.0], rel=1e-4)

    def test_the_registers_reach_the_world(self) -> None:
        world = World(parameters.WorldParameters(servo=QUIET, target=ALONE))
        bus, mechanics = ServoBusEmulator(SharedWorld(world, lambda: 0.0)), world.mechanics
        for name, usual in (("position_p_gain", machine.POSITION_P_GAIN), ("position_d_gain", machine.POSITION_D_GAIN)):
            register = REGISTERS[name]
            for servo in (1, 2, 3):
                assert bus.servo(servo).write(register.address, register.to_bytes(servo * usual), 0.0) == OK
        assert mechanics.gains == mechanics.brakes == (1.0, 2.0, 3.0)
        bus.servo(3).reboot(0.0)
        assert (mechanics.gains[2], mechanics.brakes[2]) == (pytest.approx(850 / machine.POSITION_P_GAIN), 0.0)
