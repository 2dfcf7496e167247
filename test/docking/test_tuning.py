# SPDX-License-Identifier: Apache-2.0
"""Docking's live parameters are set between goals: they apply to the next goal, never to a running one."""

from __future__ import annotations

import dataclasses
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.parameter import Parameter

from deltacharger_core.parameters import declared
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.outcomes import DockRequest, Pose, Progress
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, dock_at_last, new_namespace

PLACE = Pose(0.0, 0.0, 0.080)
LIVE = [each for each in declared(DockingParameters) if each.tunable]
GUARDS = {  # of live electrodes, or copied by another part
    "approach", "published_clearance_rule", "critical_angle", "clearance_min", "clearance_sigmas", "clearance_frames",
    "charge_current_max", "target_voltage_min", "target_voltage_max", "probe_resistance_min", "contact_lost_current",
    "unsafe_max", "blind_max", "servo_age_max", "live_servo_age_max", "tactile_age_max", "power_age_max",
    "hard_current", "torque_constant", "gravity_z", "servo_stiffness", "electrode_half_gap",
}  # fmt: skip


def changed(name: str) -> DockingParameters:
    """Return parameters with one different value, toward the bound that contradicts no other."""
    about, usual = next(each for each in LIVE if each.name == name), DockingParameters()
    value = getattr(usual, name)
    if about.kind is bool:
        return dataclasses.replace(usual, **{name: not value})
    if about.kind is int:
        return dataclasses.replace(usual, **{name: value + 1})
    for other in (value + 0.05 * (about.high - value), value - 0.05 * (value - about.low)):
        try:
            return dataclasses.replace(usual, **{name: other})
        except ValueError:
            continue
    raise AssertionError(name)


def content(thing: Any, seen: set[int]) -> Any:
    """Return all values that can be reached from an object."""
    if id(thing) in seen or callable(thing):
        return type(thing).__name__
    if isinstance(thing, dict | list | tuple) or hasattr(thing, "__dict__"):
        seen.add(id(thing))
    if isinstance(thing, dict):
        return {str(key): content(value, seen) for key, value in thing.items()}
    if isinstance(thing, list | tuple):
        return [content(value, seen) for value in thing]
    if hasattr(thing, "__dict__"):
        return content(vars(thing), seen)
    return repr(thing)


@pytest.mark.parametrize("name", [each.name for each in LIVE])
def test_a_tuned_machine_equals_one_created_with_these_values(name: str) -> None:
    wanted = changed(name)
    tuned = DockingMachine(DockingParameters())
    assert tuned.tune(wanted) == ""
    assert content(tuned, set()) == content(DockingMachine(wanted), set())
    assert content(tuned, set()) != content(DockingMachine(DockingParameters()), set())


def test_parameters_that_protect_live_electrodes_or_describe_the_machine_are_fixed() -> None:
    assert len(LIVE) > 50
    assert not GUARDS & {each.name for each in LIVE}
    assert {each.name for each in declared(DockingParameters)} >= GUARDS


def test_tuning_is_refused_while_the_arm_retracts() -> None:
    machine = DockingMachine(DockingParameters())
    machine.start_undock("", Observation(0.0))
    assert machine.tune(DockingParameters(home_z=0.01)).startswith("a goal is running")
    machine.emergency()
    assert machine.tune(DockingParameters(home_z=0.01)) == ""


@pytest.fixture
def charger(quick_scene: Scene, context: Any) -> Iterator[tuple[Any, ChargerClient]]:
    namespace = new_namespace()
    client = ChargerClient(namespace, context)
    with Composition(quick_scene, context, namespace) as composition:
        assert client.wait_until_ready(DEADLINE)
        yield composition.node("docking_node"), client
    client.close()


@pytest.mark.ros
def test_a_running_goal_keeps_its_values_and_the_next_one_uses_the_new_ones(charger: tuple[Any, ChargerClient]) -> None:
    node, client = charger
    seen: list[Progress] = []
    reasons: list[str] = []
    charges = threading.Event()

    def set_home(z: float) -> str:
        both = [Parameter("home_z", value=z), Parameter("unsure_max", value=5)]
        return str(node.set_parameters_atomically(both).reason)

    def while_it_charges(progress: Progress) -> None:
        seen.append(progress)
        if progress.phase == "charging" and not reasons:
            reasons.append(set_home(0.03))
            charges.set()

    end = time.monotonic() + DEADLINE
    while not reasons and time.monotonic() < end:
        client.dock(DockRequest(PLACE, hold=True), while_it_charges, charges, DEADLINE)
    assert reasons[0].startswith("home_z, unsure_max not set: a goal is running")
    assert seen[-1].z == pytest.approx(0.06, abs=2e-3), "it went where it would have gone"
    assert (node.get_parameter("home_z").value, node.get_parameter("unsure_max").value) == (0.06, 4)

    dock_at_last(client, DockRequest(PLACE, start_charging=False))
    assert "undock first" in set_home(0.03), "the electrodes rest on the target"
    assert client.undock(deadline=DEADLINE).success
    assert set_home(0.05) == ""
    dock_at_last(client, DockRequest(PLACE, start_charging=False))
    assert client.undock(deadline=DEADLINE, on_progress=seen.append).success
    assert seen[-1].z == pytest.approx(0.05, abs=2e-3)
