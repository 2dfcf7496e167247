# SPDX-License-Identifier: Apache-2.0
"""The light model against MuJoCo and statics with equal parameters: at rest, in contact, leaning."""

import math
from collections.abc import Callable
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError
from deltacharger_kinematics.geometry import DeltaGeometry, LimbAdjustment
from deltacharger_lab.mujoco.world import mujoco_world, pull, refuse, side_pull
from deltacharger_sim.parameters import (
    CableParameters,
    ContactParameters,
    MagnetParameters,
    PlatformParameters,
    StandParameters,
    TargetParameters,
    WorldParameters,
)
from deltacharger_sim.touch import TargetTouch
from deltacharger_sim.world import World
from test.marks import night, rest
from test.plain import plain_servo

ArmFactory = Callable[..., Any]
SLIPPERY = plain_servo(friction=0.0, viscosity=0.02)
WEIGHTLESS = {"servo": SLIPPERY, "gravity_y": 0.0}
NO_TARGET = TargetParameters(present=False)
MAGNETS = MagnetParameters()


def require_mujoco() -> None:
    pytest.importorskip("mujoco", reason="the reference of the simulation is deltacharger-lab[sim]")


@pytest.fixture
def pair(arm: ArmFactory) -> Callable[..., tuple[Any, Any]]:
    """Return the light arm and its MuJoCo counterpart, both commanded every 5 ms."""
    require_mujoco()

    def make(parameters: WorldParameters, step: float = 0.001) -> tuple[Any, Any]:
        light, other = arm(parameters), arm(parameters)
        other.world = mujoco_world(parameters, step=step)
        return light, other

    return make


CALIBRATED = DeltaGeometry(
    limbs=(
        LimbAdjustment(radius_offset=1e-3, angle_offset=0.03),
        LimbAdjustment(tangential_offset=-1e-3, arm=0.101),
        LimbAdjustment(height_offset=1e-3, rod=0.179),
    )
)


@pytest.mark.parametrize(
    ("gravity", "geometry"), [rest((0.0, -8.5, -4.9), CALIBRATED), night((5.0, 0.0, 3.0), DeltaGeometry())]
)
def test_both_sag_equally(gravity: tuple[float, float, float], geometry: DeltaGeometry) -> None:
    require_mujoco()
    x, y, z = gravity
    parameters = WorldParameters(servo=SLIPPERY, target=NO_TARGET, gravity_x=x, gravity_y=y, gravity_z=z)
    worlds = World(parameters, geometry=geometry), mujoco_world(parameters, geometry=geometry)
    for world in worlds:
        for index, goal in enumerate((0.1, 0.2, 0.15)):
            world.command(index, True, goal, 4.1)
        for _ in range(400):
            world.step(0.005)
    first, second = (world.mechanics for world in worlds)
    assert max(map(abs, first.torques)) > 0.05
    assert second.position == pytest.approx(first.position, abs=2e-6)
    assert second.angles == pytest.approx(first.angles, abs=1e-5)
    assert second.torques == pytest.approx(first.torques, abs=1e-4)


@pytest.mark.parametrize(
    ("stiffness", "z", "bound"), [rest(1e5, 0.086, 4.1), night(1e7, 0.086, 4.1), night(1e3, 0.105, 0.6)]
)
def test_both_settle_with_the_same_force_gap_and_contact_current(
    pair: Any, stiffness: float, z: float, bound: float
) -> None:
    """Drawn aside by the magnets; soft springs at their hard stop, where the current bound holds."""
    # Servos at their bound neither hold nor brake a swing sideways.
    aside = (0.004, -0.003) if bound > 1.0 else (0.0, 0.0)
    contact, target = ContactParameters(stiffness=stiffness, friction=0.0), TargetParameters(x=aside[0], y=aside[1])
    arms = pair(WorldParameters(contact=contact, target=target, **WEIGHTLESS))
    for each in arms:
        each.go((0.0, 0.0, 0.07), 0.6)
        each.go((0.0, 0.0, z), 1.4, bound=bound)
    (light, other) = (each.world.mechanics for each in arms)
    assert light.contact_force > 60.0
    assert light.position[:2] == pytest.approx(other.position[:2], abs=2e-6)
    assert bound < 1.0 or light.position[0] > 0.001
    assert stiffness > 1e3 or 0.002 < -light.gap < 0.0022
    assert other.contact_force == pytest.approx(light.contact_force, rel=1e-4)
    assert other.gap == pytest.approx(light.gap, abs=2e-6 if stiffness == 1e3 else 2e-7)
    assert arms[1].contact_current == pytest.approx(arms[0].contact_current, abs=2e-4)
    assert max(map(abs, other.torques)) <= bound * 6.0 / 4.1 + 1e-9


@pytest.mark.parametrize(
    ("parameters", "key"),
    [
        ({"servo": plain_servo(backlash=0.01)}, "servo.backlash"),
        ({"cable": CableParameters(drag=1.0)}, "cable.drag"),
        ({"stand": StandParameters(stiffness=5000.0)}, "stand.stiffness"),
    ],
)
def test_parameters_that_the_reference_lacks_are_refused_by_key(parameters: Any, key: str) -> None:
    with pytest.raises(ParameterError) as caught:
        refuse(WorldParameters(**{"servo": plain_servo()} | parameters))
    assert caught.value.key == key


def leaning(
    compliance: float, pitch: float, yaw: float, stiffness: float = 1e5, roll: float = 0.0, **changes: Any
) -> WorldParameters:
    """Angles in degrees; the platform tilts about its own face, where friction has no lever."""
    return WorldParameters(
        contact=ContactParameters(stiffness=stiffness),
        platform=PlatformParameters(compliance=compliance, lever=0.0),
        target=TargetParameters(roll=math.radians(roll), tilt_x=math.radians(pitch), tilt_y=math.radians(yaw)),
        **changes,
    )


@pytest.mark.parametrize(
    ("compliance", "pitch", "yaw", "stiffness", "roll"),
    [
        rest(0.02, -2.0, 1.5, 1e5, 0.0),
        night(0.0, 0.0, 5.0, 1e3, 0.0),  # an end is pressed beyond its travel: the stop holds it
        night(0.03, -3.0, 5.0, 1e6, 0.0),
    ],
)
def test_both_lean_equally_with_equal_forces_on_each_bar(
    pair: Any, compliance: float, pitch: float, yaw: float, stiffness: float, roll: float
) -> None:
    arms = pair(leaning(compliance, pitch, yaw, stiffness, roll, **WEIGHTLESS), 2e-4)
    for each in arms:
        each.go((0.0, 0.0, 0.07), 0.6)
        each.go((0.0, 0.0, 0.086), 1.4)
    light, other = (each.world.mechanics for each in arms)
    assert other.contact_force == pytest.approx(light.contact_force, rel=0.012)
    assert other.gap == pytest.approx(light.gap, abs=4e-5)
    assert other.tilt == pytest.approx(light.tilt, rel=0.02, abs=2e-4)
    assert other.bars[:2] == pytest.approx(light.bars[:2], rel=0.03, abs=0.5)
    assert other.bars[2:] == pytest.approx(light.bars[2:], abs=0.06)  # a point of 24 more or less
    for found in (light, other):
        assert found.peak_force >= found.contact_force == pytest.approx(found.bars.upper + found.bars.lower)
        assert found.lean.free == pytest.approx((-math.radians(pitch), -math.radians(yaw)))
        residual = found.tilt[0] - math.radians(pitch), found.tilt[1] - math.radians(yaw)
        assert found.lean.residual == pytest.approx(residual, rel=0.02, abs=2e-4)


@pytest.mark.parametrize("offset", [0.002, 0.006, 0.03])
@pytest.mark.parametrize("gap", [0.0005, 0.004])
def test_both_models_pull_sideways_by_the_energy_of_the_pull(gap: float, offset: float) -> None:
    touch, tiny = TargetTouch(WorldParameters()), 1e-7

    def pulls(gap: float, offset: float) -> tuple[float, float]:
        """Toward the target and toward its centre, N."""
        touch.lie(0.6 * offset, -0.8 * offset)
        ahead, *_, aligning = touch.forces(gap, 0.0, 0.0, (0.0, 0.0), 0.0)
        assert ahead == pytest.approx(pull(MAGNETS, gap, offset))
        assert aligning == pytest.approx(side_pull(MAGNETS, gap, offset))
        return ahead, aligning * offset

    # Both are derivatives of one energy, by the gap and by the offset, so their cross derivatives are equal.
    ahead = (pulls(gap, offset + tiny)[0] - pulls(gap, offset - tiny)[0]) / (2.0 * tiny)
    aside = (pulls(gap + tiny, offset)[1] - pulls(gap - tiny, offset)[1]) / (2.0 * tiny)
    assert aside == pytest.approx(ahead, rel=1e-5, abs=1e-3)
    assert (pulls(gap, offset)[1] > 0.0) == (offset < 0.016)  # beyond, the share is at its floor
