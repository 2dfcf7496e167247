# SPDX-License-Identifier: Apache-2.0
"""Two chargers side by side, distinguished by their namespaces only, one inside the other's.

Actions, faults and messages of one do not affect the other's arm, contactor, states and goals.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from deltacharger.msg import ChargerPower, DockingState, ServoState
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, Process, dock_at_last, new_namespace, wait_until

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))


class Watched:
    """A charger of some namespace, observed by its messages; its processes do not matter."""

    def __init__(self, namespace: str, context: Any) -> None:
        self.client = ChargerClient(namespace, context)
        self.states: list[DockingState] = []
        self.powers: list[bool] = []
        self.torques: list[bool] = []
        self.angles: list[tuple[float, ...]] = []
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node = self.client.node
        node.create_subscription(DockingState, "docking_state", self.states.append, latched)
        node.create_subscription(ChargerPower, "charger_power", self._on_power, QoSProfile(depth=1))
        node.create_subscription(ServoState, "servo_state", self._on_servos, QoSProfile(depth=1))

    def ready(self) -> None:
        assert self.client.wait_until_ready(DEADLINE)
        wait_until(lambda: self.states and self.powers and self.angles, "states, power and servos")

    def forget(self) -> None:
        """Consider only messages from now on."""
        del self.states[:-1], self.powers[:], self.torques[:], self.angles[:]

    def assert_at_rest(self) -> None:
        """Nothing has happened since `forget`."""
        wait_until(lambda: self.powers and self.angles, "news")
        assert not any(self.powers)
        assert not any(self.torques)
        assert len(self.states) == 1
        assert max(math.dist(each, self.angles[0]) for each in self.angles) < 1e-3

    def assert_charging(self) -> None:
        """It has continued charging since `forget`, without interruption."""
        wait_until(lambda: self.powers, "news")
        assert all(self.powers)
        assert all(self.torques)
        assert len(self.states) == 1
        assert self.states[-1].charging

    def dock(self) -> Outcome:
        return dock_at_last(self.client, GOAL)

    def undock(self) -> Outcome:
        return self.client.undock(deadline=DEADLINE)

    def _on_power(self, message: ChargerPower) -> None:
        self.powers.append(message.contactor_closed)

    def _on_servos(self, message: ServoState) -> None:
        self.torques.append(any(message.torque_enabled))
        self.angles.append(tuple(message.position))


@pytest.fixture
def chargers(
    quick_scene: Scene,
    quick_file: Path,
    context: Any,
    start: Callable[..., Process],
    deltacharger: tuple[str, ...],
) -> Iterator[tuple[Composition, list[Watched]]]:
    """Start one in this process, which is returned, and one in another; two in one would starve each other."""
    name = new_namespace()
    other = start(*deltacharger, "up", "--scene", str(quick_file), "--namespace", f"{name}/inner")
    with Composition(quick_scene, context, name) as here:
        watched = [Watched(each, context) for each in (name, f"{name}/inner")]
        other.wait_for_line("ready", other.err)
        for each in watched:
            each.ready()
        yield here, watched
        for each in watched:
            each.client.close()


def test_actions_and_faults_of_one_do_not_affect_the_other(chargers: tuple[Composition, list[Watched]]) -> None:
    composition, (outer, inner) = chargers
    inner.forget()
    assert outer.dock().success
    inner.assert_at_rest()

    assert inner.dock().success
    inner.forget()
    servos = composition.node("mock_servo_node")
    assert servos.set_parameters([Parameter("fault", value="silence")])[0].successful
    wait_until(lambda: outer.states[-1].error_code, "the outer to notice")
    assert CODES[outer.states[-1].error_code] == "SERVO_FAULT"
    inner.assert_charging()
    assert servos.set_parameters([Parameter("fault", value="none")])[0].successful
    wait_until(lambda: outer.undock().success, "the outer to be home")
    inner.assert_charging()

    outer.forget()
    assert inner.undock().success
    outer.assert_at_rest()
