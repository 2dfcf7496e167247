# SPDX-License-Identifier: Apache-2.0
"""The light model against MuJoCo with equal parameters: statics, settled contact, path; unsupported parameters."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment
from deltacharger_sim import mujoco_model
from deltacharger_sim.mujoco_world import MujocoMechanics, mujoco_world
from deltacharger_sim.parameters import (
    ContactParameters,
    MagnetParameters,
    ServoParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.world import World

ArmFactory = Callable[..., Any]
SLIPPERY = ServoParameters(friction=0.0)
WEIGHTLESS = {"servo": SLIPPERY, "gravity_y": 0.0}


@pytest.fixture
def pair(arm: ArmFactory) -> Callable[..., tuple[Any, Any]]:
    """Return the light arm and its MuJoCo counterpart, both commanded every 5 ms."""
    pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger[sim]")

    def make(parameters: WorldParameters, step: float = 0.001) -> tuple[Any, Any]:
        light, other = arm(parameters), arm(parameters)
        other.world = mujoco_world(parameters, step=step)
        return light, other

    return make


@pytest.mark.parametrize("gravity", [(0.0, -9.81, 0.0), (0.0, -8.5, -4.9), (5.0, 0.0, 3.0)])
def test_both_sag_equally(pair: Any, gravity: tuple[float, float, float]) -> None:
    x, y, z = gravity
    parameters = WorldParameters(
        servo=SLIPPERY, target=TargetParameters(present=False), gravity_x=x, gravity_y=y, gravity_z=z
    )
    light, other = pair(parameters)
    for each in (light, other):
        each.go((0.01, 0.02, 0.08), 2.0, lead=False)
    first, second = light.world.mechanics, other.world.mechanics
    assert math.dist(first.position, (0.01, 0.02, 0.08)) > 1e-3
    assert second.position == pytest.approx(first.position, abs=1e-6)
    assert second.angles == pytest.approx(first.angles, abs=1e-5)
    assert second.torques == pytest.approx(first.torques, abs=1e-4)


@pytest.mark.parametrize("stiffness", [1e3, 1e5, 1e7])
def test_both_settle_with_the_same_force_and_contact_current(pair: Any, stiffness: float) -> None:
    arms = pair(WorldParameters(contact=ContactParameters(stiffness=stiffness), **WEIGHTLESS))
    for each in arms:
        each.go((0.0, 0.0, 0.07), 0.6)
        each.go((0.0, 0.0, 0.086), 1.2)
    (light, other) = (each.world.mechanics for each in arms)
    assert light.contact_force > 70.0
    assert other.contact_force == pytest.approx(light.contact_force, rel=1e-4)
    assert other.gap == pytest.approx(light.gap, abs=2e-7)
    assert arms[1].contact_current == pytest.approx(arms[0].contact_current, abs=2e-4)


def test_both_dock_along_the_same_path(pair: Any) -> None:
    light, other = pair(WorldParameters())
    squares = []
    for tick in range(24):
        for each in (light, other):
            each.aim((0.0, 0.0, 0.06 + 0.026 * min((tick + 1) / 16.0, 1.0)))
        for _ in range(10):
            for each in (light, other):
                each.run(0.005)
            if tick > 4:
                squares.append(math.dist(light.world.mechanics.position, other.world.mechanics.position) ** 2)
    assert math.sqrt(sum(squares) / len(squares)) < 1e-4
    assert light.world.record.contacts == other.world.record.contacts == 1


def test_both_agree_in_fast_motion(pair: Any) -> None:
    """The rotors' inertia follows the arms' curved path: a model without half of that is 6 mm off here."""
    servo = ServoParameters(friction=0.0, inertia=0.02)
    light, other = pair(WorldParameters(servo=servo, target=TargetParameters(present=False)), 0.0002)
    light.step = other.step = 0.0002
    for each in (light, other):
        each.go((-0.05, 0.0, 0.02), 0.8)
        each.aim((0.05, 0.03, 0.1))
    for _ in range(600):
        for each in (light, other):
            each.world.step(0.0002)
        assert math.dist(light.world.mechanics.position, other.world.mechanics.position) < 4e-4


def test_a_calibrated_geometry_is_the_same_arm_in_both(pair: Any) -> None:
    del pair
    geometry = DeltaGeometry(
        limbs=(
            LimbAdjustment(radius_offset=1e-3, angle_offset=0.03),
            LimbAdjustment(tangential_offset=-1e-3, arm=0.101),
            LimbAdjustment(height_offset=1e-3, rod=0.179),
        )
    )
    parameters = WorldParameters(servo=SLIPPERY, target=TargetParameters(present=False))
    worlds = World(parameters, geometry=geometry), mujoco_world(parameters, geometry=geometry)
    for world in worlds:
        for index, goal in enumerate((0.1, 0.2, 0.15)):
            world.command(index, True, goal, 4.1)
        for _ in range(400):
            world.step(0.005)
    assert worlds[1].mechanics.position == pytest.approx(worlds[0].mechanics.position, abs=2e-6)


def test_hard_stop_and_current_bound_hold_in_both(pair: Any) -> None:
    arms = pair(WorldParameters(contact=ContactParameters(stiffness=1e3), **WEIGHTLESS))
    for each in arms:
        each.dock(0.010)
        each.go((0.0, 0.0, 0.105), 1.0, bound=0.6)
    light, other = (each.world.mechanics for each in arms)
    assert 0.002 < -other.gap < 0.0022
    assert other.gap == pytest.approx(light.gap, abs=2e-6)
    assert max(map(abs, other.torques)) <= 0.6 * 6.0 / 4.1 + 1e-9


@pytest.mark.parametrize(
    ("parameters", "key"),
    [
        (WorldParameters(servo=ServoParameters(backlash=0.01)), "servo.backlash"),
        (WorldParameters(servo=ServoParameters(stall_sag=0.5)), "servo.stall_sag"),
    ],
)
def test_parameters_that_the_reference_lacks_are_refused_by_key(parameters: WorldParameters, key: str) -> None:
    with pytest.raises(ParameterError) as caught:
        mujoco_model.refuse(parameters)
    assert caught.value.key == key


def test_an_unknown_integrator_and_a_start_out_of_reach_are_refused() -> None:
    pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger[sim]")
    with pytest.raises(ValueError, match="leapfrog"):
        mujoco_world(WorldParameters(), integrator="leapfrog")
    with pytest.raises(ValueError, match="reach"):
        MujocoMechanics(WorldParameters(magnets=MagnetParameters(force=0.0)), DeltaGeometry(), (0.0, 0.0, 1.0))


def test_without_mujoco_the_message_states_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModuleNotFoundError, match=r"deltacharger\[sim\]"):
        mujoco_world(WorldParameters())


def test_the_light_world_imports_no_mujoco() -> None:
    import subprocess

    code = "import sys, deltacharger_sim.world, deltacharger_sim.mujoco_world; sys.exit('mujoco' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
