"""Two chargers side by side, told apart by their namespaces alone: in one process, and one of them in another.

What one does, suffers and says leaves the other's arm, contactor, states and goals alone.
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

from deltacharger_bringup.client import CODES, ChargerClient
from deltacharger_bringup.composition import Composition
from deltacharger_bringup.outcomes import DockRequest, Outcome, Pose
from deltacharger_bringup.scene import Scene

from .conftest import DEADLINE, Process, new_namespace, wait_until

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))


class Watched:
    """A charger of some namespace by what it says; who runs it does not matter."""

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
        """Look only at what is said from now on."""
        del self.states[:-1], self.powers[:], self.torques[:], self.angles[:]

    def assert_at_rest(self) -> None:
        """Nothing was done since `forget`."""
        wait_until(lambda: self.powers and self.angles, "news")
        assert not any(self.powers)
        assert not any(self.torques)
        assert len(self.states) == 1
        assert max(math.dist(each, self.angles[0]) for each in self.angles) < 1e-3

    def assert_charging(self) -> None:
        """It went on charging since `forget`, without a word."""
        wait_until(lambda: self.powers, "news")
        assert all(self.powers)
        assert all(self.torques)
        assert len(self.states) == 1
        assert self.states[-1].charging

    def dock(self) -> Outcome:
        """Dock; an estimate that a stalled mock arm spoilt is tried again, as a fleet would."""
        outcomes: list[Outcome] = []

        def done() -> bool:
            outcomes.append(self.client.dock(GOAL, deadline=DEADLINE))
            return outcomes[-1].success

        wait_until(done, f"a docking that succeeds: {outcomes}")
        return outcomes[-1]

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
    """Two in this process, of which the first is returned, and one in another; one namespace lies in another."""
    names = [new_namespace(), new_namespace()]
    names.append(f"{names[0]}/inner")
    other = start(*deltacharger, "up", "--scene", str(quick_file), "--namespace", names[1])
    with Composition(quick_scene, context, names[0]) as first, Composition(quick_scene, context, names[2]):
        watched = [Watched(name, context) for name in names]
        other.wait_for_line("ready", other.err)
        for each in watched:
            each.ready()
        yield first, watched
        for each in watched:
            each.client.close()


def test_what_one_does_and_suffers_leaves_the_others_alone(chargers: tuple[Composition, list[Watched]]) -> None:
    composition, (first, process, inner) = chargers
    for each in (process, inner):
        each.forget()
    assert first.dock().success
    for each in (process, inner):
        each.assert_at_rest()

    for each in (process, inner):
        assert each.dock().success
        each.forget()
    servos = composition.node("mock_servo_node")
    assert servos.set_parameters([Parameter("fault", value="silence")])[0].successful
    wait_until(lambda: first.states[-1].error_code, "the first to notice")
    assert CODES[first.states[-1].error_code] == "SERVO_FAULT"
    for each in (process, inner):
        each.assert_charging()
    assert servos.set_parameters([Parameter("fault", value="none")])[0].successful
    wait_until(lambda: first.undock().success, "the first to be home")
    for each in (process, inner):
        each.assert_charging()

    assert process.undock().success
    inner.assert_charging()
    first.forget()
    assert inner.undock().success
    first.assert_at_rest()
