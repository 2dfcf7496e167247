# SPDX-License-Identifier: Apache-2.0
"""The client with a charger that answers goals slowly or never, or whose answers are lost."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from deltacharger.action import Dock, Undock
from rclpy.action.server import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node

from deltacharger_core.ros import action_caller, client as client_module, executor, messages, outcomes
from deltacharger_core.ros.client import ChargerClient, ClientError
from deltacharger_docking.codes import Code

from ..chargers import DEADLINE, wait_until
from ..nodes import options

pytestmark = pytest.mark.ros

GOAL = outcomes.DockRequest(outcomes.Pose(0.0, 0.0, 0.080))


class Server:
    """Both actions of a charger: goals end as `execute` says, and dock drops the next responses of some kinds.

    Attributes:
        dock: the action server.
        dropped: number of responses so far.
        over: set at the end.
    """

    def __init__(
        self,
        node: Node,
        execute: Callable[[Any], None] = lambda handle: handle.succeed(),
        decides: bool = True,
    ) -> None:
        self.dropped = 0
        self.over = threading.Event()
        self._drops: dict[str, int] = {}

        def work(handle: Any) -> Any:
            execute(handle)
            return Dock.Result(success=True)

        def decide(goal: Any) -> GoalResponse:
            return GoalResponse.ACCEPT if decides else self.over.wait(DEADLINE) and GoalResponse.REJECT

        self._servers: list[Any] = [
            ActionServer(
                node, kind, name, work, goal_callback=decide, cancel_callback=lambda handle: CancelResponse.ACCEPT
            )
            for kind, name in ((Dock, "dock"), (Undock, "undock"))
        ]
        self.dock = self._servers[0]
        self._handle, self.dock._handle = self.dock._handle, self
        self._spinner = executor.Spinner(node)

    def __getattr__(self, name: str) -> Any:
        """Stand in for the handle of dock's server."""
        if not self._drops.get(name):
            return getattr(self._handle, name)

        def drop(*arguments: Any) -> None:
            self._drops[name] -= 1
            self.dropped += 1

        return drop

    def drop(self, **drops: int) -> None:
        self._drops = {f"send_{kind}_response": number for kind, number in drops.items()}

    def close(self) -> None:
        self.over.set()
        self._spinner.close(*self._servers)


@pytest.fixture
def serve(context: Any, namespace: str) -> Iterator[Callable[..., Server]]:
    started: list[Server] = []

    def start(*arguments: Any, **options_: Any) -> Server:
        started.append(Server(Node("docking_node", **options(context, namespace)), *arguments, **options_))
        return started[-1]

    yield start
    for server in started:
        server.close()


@pytest.fixture
def client(context: Any, namespace: str) -> Iterator[ChargerClient]:
    with ChargerClient(namespace, context) as client:
        yield client


@pytest.fixture
def answering(serve: Callable[..., Server], client: ChargerClient) -> Callable[..., Server]:
    """Start a server, and wait until the client has heard it; then it drops responses."""

    def start(*arguments: Any, decides: bool = True, **drops: int) -> Server:
        server = serve(*arguments, decides=decides)
        assert client.wait_until_it_answers(DEADLINE)
        server.drop(**drops)
        return server

    return start


Answering = Callable[..., Server]


@pytest.mark.parametrize("cancels", [False, True])
def test_an_unanswered_goal_ends_with_an_error_with_or_without_a_cancel(
    answering: Answering, client: ChargerClient, monkeypatch: pytest.MonkeyPatch, cancels: bool
) -> None:
    answering(decides=False)
    cancel = threading.Event()
    monkeypatch.setattr(client_module, "_LOST_AFTER", DEADLINE if cancels else 0.3)
    if cancels:
        cancel.set()
    with pytest.raises(ClientError, match="did not answer the goal 'undock'"):
        client.undock(cancel=cancel)


def test_a_charger_whose_answers_do_not_arrive_is_named_and_gets_no_goal(
    serve: Callable[..., Server], client: ChargerClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As between root and another user: Fast DDS discovers over UDP and delivers over shared memory."""
    served: list[Any] = []
    serve(served.append).drop(goal=10**6, cancel=10**6)
    monkeypatch.setattr(client_module, "_LOST_AFTER", 0.3)
    with pytest.raises(ClientError, match="answers do not arrive: run both as one user"):
        client.wait_until_it_answers(DEADLINE)
    with pytest.raises(ClientError, match="answers do not arrive"):
        client.dock(GOAL)
    assert not served


def test_a_callers_unanswered_goal_is_lost(serve: Callable[..., Server], context: Any, namespace: str) -> None:
    serve(decides=False)
    ends: list[tuple[Any, ...]] = []
    node = Node("mission_node", **options(context, namespace))
    caller = action_caller.ActionCaller(node, Dock, "dock", lambda *end: ends.append(end), lost_timeout=0.3)
    spinner = executor.Spinner(node)
    caller.send(7, Dock.Goal())

    def ended() -> bool:
        caller.tick()
        return bool(ends)

    wait_until(ended, "the end of the goal")
    assert ends == [(7, action_caller.LOST, None, None)]
    assert caller.is_settled
    spinner.close(caller)


@pytest.mark.version
def test_a_goal_that_its_server_has_forgotten_is_lost(answering: Answering, client: ChargerClient) -> None:
    def execute(handle: Any) -> None:
        server.dock._goal_handles.clear()  # like a node that has restarted
        server.over.wait(DEADLINE)

    server = answering(execute)
    with pytest.raises(ClientError, match="no longer knows the goal 'dock'"):
        client.dock(GOAL)


def test_a_goal_is_cancelled_although_its_acceptance_was_lost(answering: Answering, client: ChargerClient) -> None:
    cancel, ended = threading.Event(), threading.Event()

    def execute(handle: Any) -> None:
        cancel.set()
        wait_until(lambda: handle.is_cancel_requested, "the cancel")
        handle.canceled()
        ended.set()

    answering(execute, goal=1)
    with pytest.raises(ClientError, match="did not answer the goal 'dock'"):
        client.dock(GOAL, cancel=cancel)
    assert ended.wait(DEADLINE)


def test_a_client_names_every_code() -> None:
    assert {code: Code(code).name for code in Code} == messages.CODES
