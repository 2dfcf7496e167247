# SPDX-License-Identifier: Apache-2.0
"""The client with a charger that answers goals slowly or never, or whose answers are lost."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from deltacharger.action import Dock, Undock
from rclpy.action import client as action_client
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from deltacharger_ros import client as client_module
from deltacharger_ros.action_caller import ActionCaller
from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest, Pose
from deltacharger_ros.sent_goal import LOST

from ..chargers import DEADLINE, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros


@pytest.fixture
def silent_charger(context: Any, namespace: str) -> Iterator[str]:
    """Both actions of a charger that answers no goal until the test is over; yields its namespace."""
    over = threading.Event()

    def decide(goal: Any) -> GoalResponse:
        over.wait(DEADLINE)
        return GoalResponse.REJECT

    node = Node("docking_node", **options(context, namespace))
    servers = [
        ActionServer(node, kind, name, execute_callback=lambda handle: None, goal_callback=decide)
        for kind, name in ((Dock, "dock"), (Undock, "undock"))
    ]
    spinner = Spinner(node)
    yield namespace
    over.set()
    spinner.close(*servers)


def test_an_unanswered_goal_ends_with_an_error(
    silent_charger: str, context: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with ChargerClient(silent_charger, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        monkeypatch.setattr(client_module, "_LOST_AFTER", 0.5)
        with pytest.raises(ClientError, match="did not answer the goal 'undock'"):
            client.undock()


def test_a_cancel_does_not_wait_for_an_unanswered_goal(silent_charger: str, context: Any) -> None:
    cancel = threading.Event()
    with ChargerClient(silent_charger, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        cancel.set()
        started = time.monotonic()
        with pytest.raises(ClientError, match="did not answer the goal 'undock'"):
            client.undock(cancel=cancel)
        assert time.monotonic() - started < 3.0


def test_an_answer_during_sending_is_received(context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Late(action_client.Future):  # type: ignore[misc]
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            time.sleep(0.1)  # a stall between the request and the lookup of its answer
            super().__init__(*args, **kwargs)

    def execute(handle: Any) -> Dock.Result:
        handle.succeed()
        return Dock.Result(success=True)

    node = Node("docking_node", **options(context, namespace))
    servers = [ActionServer(node, kind, name, execute) for kind, name in ((Dock, "dock"), (Undock, "undock"))]
    spinner = Spinner(node)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        monkeypatch.setattr(action_client, "Future", Late)
        assert client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE).success
    spinner.close(*servers)


def test_a_callers_unanswered_goal_is_lost(silent_charger: str, context: Any) -> None:
    ends: list[tuple[Any, ...]] = []
    node = Node("mission_node", **options(context, silent_charger))
    caller = ActionCaller(node, Dock, "dock", lambda *end: ends.append(end), lost_timeout=0.3)
    spinner = Spinner(node)
    caller.send(7, Dock.Goal())

    def ended() -> bool:
        caller.tick()
        return bool(ends)

    wait_until(ended, "the end of the goal")
    assert ends == [(7, LOST, None, None)]
    assert caller.is_settled
    spinner.close(caller)


class Lossy:
    """Handle of an action server; drops the first responses of some kinds."""

    def __init__(self, server: Any, **drops: int) -> None:
        self.server = server
        self._handle = server._handle
        self._drops = {f"send_{kind}_response": number for kind, number in drops.items()}
        self.dropped = 0

    def __getattr__(self, name: str) -> Any:
        if not self._drops.get(name):
            return getattr(self._handle, name)

        def drop(*arguments: Any) -> None:
            self._drops[name] -= 1
            self.dropped += 1

        return drop


@pytest.fixture
def lossy_charger(context: Any, namespace: str) -> Iterator[Callable[..., Lossy]]:
    """Function that starts both actions of a charger: goals end as `execute` says, and dock drops responses."""
    started: list[Any] = []

    def start(execute: Callable[[Any], None] = lambda handle: handle.succeed(), **drops: int) -> Lossy:
        def work(handle: Any) -> Any:
            execute(handle)
            return Dock.Result(success=True)

        node = Node("docking_node", **options(context, namespace))
        servers: Any = [
            ActionServer(node, kind, name, work, cancel_callback=lambda handle: CancelResponse.ACCEPT)
            for kind, name in ((Dock, "dock"), (Undock, "undock"))
        ]
        servers[0]._handle = lossy = Lossy(servers[0], **drops)
        started.append((Spinner(node), servers))
        return lossy

    yield start
    for spinner, servers in started:
        spinner.close(*servers)


@pytest.mark.parametrize("drops", [{"goal": 1}, {"result": 1}, {"goal": 1, "result": 1}], ids=str)
def test_a_lost_response_is_requested_again(
    lossy_charger: Callable[..., Lossy], context: Any, namespace: str, drops: dict[str, int]
) -> None:
    lossy = lossy_charger(**drops)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        assert client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE).success
    assert lossy.dropped == sum(drops.values())


def test_feedback_shows_that_a_goal_was_accepted(
    lossy_charger: Callable[..., Lossy], context: Any, namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    over = threading.Event()

    def execute(handle: Any) -> None:
        while not over.wait(0.05):
            handle.publish_feedback(Dock.Feedback())
        handle.succeed()

    lossy_charger(execute, goal=1)
    monkeypatch.setattr(client_module, "_LOST_AFTER", 2.0)
    timer = threading.Timer(3.0, over.set)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        timer.start()
        assert client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), deadline=DEADLINE).success


def test_a_goal_that_its_server_has_forgotten_is_lost(
    lossy_charger: Callable[..., Lossy], context: Any, namespace: str
) -> None:
    over = threading.Event()

    def execute(handle: Any) -> None:
        lossy.server._goal_handles.clear()  # like a node that has restarted
        over.wait(DEADLINE)

    lossy = lossy_charger(execute)
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        with pytest.raises(ClientError, match="no longer knows the goal 'dock'"):
            client.dock(DockRequest(Pose(0.0, 0.0, 0.080)))
    over.set()


def test_a_goal_is_cancelled_although_its_acceptance_was_lost(
    lossy_charger: Callable[..., Lossy], context: Any, namespace: str
) -> None:
    begun, cancel, ended = threading.Event(), threading.Event(), threading.Event()

    def execute(handle: Any) -> None:
        begun.set()
        wait_until(lambda: handle.is_cancel_requested, "the cancel")
        handle.canceled()
        ended.set()

    lossy_charger(execute, goal=1)
    threading.Thread(target=lambda: begun.wait(DEADLINE) and cancel.set(), daemon=True).start()
    with ChargerClient(namespace, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        with pytest.raises(ClientError, match="did not answer the goal 'dock'"):
            client.dock(DockRequest(Pose(0.0, 0.0, 0.080)), cancel=cancel)
        assert ended.wait(DEADLINE)


def test_a_goal_that_cannot_be_sent_ends_with_an_error_each_time(silent_charger: str, context: Any) -> None:
    with ChargerClient(silent_charger, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        for _ in range(2):
            with pytest.raises(ClientError, match="did not accept the goal 'undock'"):
                client.undock("\udcff")
