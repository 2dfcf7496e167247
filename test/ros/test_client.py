# SPDX-License-Identifier: Apache-2.0
"""The client with a charger that answers goals slowly or never."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.action import Dock, Undock
from rclpy.action import client as action_client
from rclpy.action.server import ActionServer, GoalResponse
from rclpy.node import Node

from deltacharger_ros import client as client_module
from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.executor import Spinner
from deltacharger_ros.outcomes import DockRequest, Pose

from ..chargers import DEADLINE
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
    for server in servers:
        server.destroy()
    spinner.close()


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


def test_a_goal_that_cannot_be_sent_ends_with_an_error_each_time(silent_charger: str, context: Any) -> None:
    with ChargerClient(silent_charger, context) as client:
        assert client.wait_until_it_answers(DEADLINE)
        for _ in range(2):
            with pytest.raises(ClientError, match="did not accept the goal 'undock'"):
                client.undock("\udcff")
