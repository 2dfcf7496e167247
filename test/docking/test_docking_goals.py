# SPDX-License-Identifier: Apache-2.0
"""docking_node and its goals: every state is reported, no goal is lost between two clients, and all are answered."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest
from deltacharger.action import Dock
from deltacharger.msg import ChargerPower, ServoState
from hypothesis import given
from hypothesis import strategies as st
from rclpy.action.client import ActionClient
from rclpy.qos import QoSProfile

from deltacharger_docking.codes import State
from deltacharger_docking.phase_log import changes
from deltacharger_ros.client import ChargerClient
from deltacharger_ros.messages import fill_pose
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import Scene

from ..chargers import DEADLINE, dock_at_last, new_namespace, wait_until
from ..nodes import answer
from ..records.docking_tapes import patient

pytestmark = pytest.mark.ros

GOAL = DockRequest(Pose(0.0, 0.0, 0.080))
states = st.sampled_from(list(State))


@given(states, st.lists(states), states)
def test_states_passed_between_two_reports_are_reported_once_each_in_order(
    before: State, passed: list[State], now: State
) -> None:
    reported = changes(before, passed, now)
    assert [before, *reported] == [state for state, _ in itertools.groupby([before, *passed, now])]


@pytest.fixture(scope="module")
def charger(quick_scene: Scene, context: Any) -> Iterator[tuple[str, Composition]]:
    namespace = new_namespace()
    with Composition(patient(quick_scene), context, namespace) as composition:
        yield namespace, composition


@pytest.fixture
def clients(charger: tuple[str, Composition], context: Any) -> Iterator[list[ChargerClient]]:
    made = [ChargerClient(charger[0], context) for _ in range(4)]
    assert all(client.wait_until_ready(DEADLINE) for client in made)
    yield made
    wait_until(lambda: made[0].undock(deadline=DEADLINE).success, "an arm at home")
    for client in made:
        client.close()


def at_once(clients: list[ChargerClient], request: DockRequest) -> list[Outcome]:
    """Send a goal from every client at the same instant."""
    outcomes: list[Outcome] = []
    start = threading.Barrier(len(clients))

    def dock(client: ChargerClient) -> None:
        start.wait()
        outcomes.append(client.dock(request, deadline=DEADLINE))

    threads = [threading.Thread(target=dock, args=(client,)) for client in clients]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(DEADLINE)
    return outcomes


def test_of_simultaneous_clients_one_is_served_and_the_others_may_retry(clients: list[ChargerClient]) -> None:
    outcomes = at_once(clients, GOAL)
    assert len(outcomes) == len(clients)
    served = [outcome for outcome in outcomes if outcome.error_name != "REJECTED"]
    assert len(served) == 1
    for outcome in outcomes:
        if outcome not in served:
            assert (outcome.error_code, outcome.retriable) == (101, True)
            assert "another goal is being served" in outcome.error_message


def test_every_client_that_docks_when_docked_gets_its_result(clients: list[ChargerClient]) -> None:
    dock_at_last(clients[0], GOAL)
    for _ in range(3):
        outcomes = at_once(clients, GOAL)
        assert len(outcomes) == len(clients)
        assert [outcome for outcome in outcomes if outcome.error_name not in ("NONE", "REJECTED")] == []
        assert any(outcome.success for outcome in outcomes)


def test_a_held_charger_moves_nothing_and_serves_queued_goals_after_release(quick_scene: Scene, context: Any) -> None:
    namespace = new_namespace()
    with (
        Composition(patient(quick_scene), context, namespace, held=True) as composition,
        ChargerClient(namespace, context) as client,
    ):
        assert client.wait_until_ready(DEADLINE)
        goals = ActionClient(client.node, Dock, "dock")
        client.waitables.append(goals)
        request = Dock.Goal()
        fill_pose(request.electrodes, Pose(0.0, 0.0, 0.080))
        goal = answer(answer(client.node.executor.call_soon(goals.send_goal_async, request)))
        torque: list[bool] = []
        client.node.create_subscription(
            ServoState, "servo_state", lambda state: torque.append(any(state.torque_enabled)), QoSProfile(depth=1)
        )
        wait_until(lambda: len(torque) >= 20, "servo_state")
        assert not any(torque)
        ended = goal.get_result_async()
        assert not ended.done()
        composition.release()
        wait_until(ended.done, "the docking")
        assert any(torque)
        assert ended.result().result.error_code in (0, 107), ended.result().result.error_message


def test_a_charger_that_was_never_released_does_not_disturb_another_of_its_name(
    quick_scene: Scene, context: Any
) -> None:
    namespace = new_namespace()
    with (
        Composition(patient(quick_scene), context, namespace) as composition,
        ChargerClient(namespace, context) as client,
    ):
        assert client.wait_until_ready(DEADLINE)
        dock_at_last(client, GOAL)
        assert client.node.count_publishers("dock/_action/feedback") == 1
        with Composition(replace(quick_scene, nodes=("docking_node",)), context, namespace, held=True):
            wait_until(lambda: client.node.count_publishers("dock/_action/feedback") == 2, "the second charger")
        wait_until(lambda: client.node.count_publishers("dock/_action/feedback") == 1, "its end")
        power: list[bool] = []
        client.node.create_subscription(
            ChargerPower, "charger_power", lambda message: power.append(message.contactor_closed), QoSProfile(depth=1)
        )
        wait_until(lambda: len(power) >= 20, "charger_power")
        assert all(power)
        assert client.undock(deadline=DEADLINE).success
        assert not composition.node("mock_tactile_node").contactor_closed
