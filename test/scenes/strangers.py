# SPDX-License-Identifier: Apache-2.0
"""A foreign program in a charger's namespace that publishes, calls and serves arbitrary messages."""

from __future__ import annotations

import importlib
import math
import random
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable
from typing import Any

from rclpy.action.client import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message

from deltacharger_core.machine import JOINTS
from deltacharger_ros.executor import Spinner

from ..nodes import options

PACE = 0.01  # s between two actions
BURST = 50  # messages of a flood
GOALS_EVERY = 10  # actions; each accepted goal has feedback and a result
LATE = 0.7  # s, older than anything that docking accepts
LONG = 100_000  # characters of a long name
_KEPT = 200  # genuine messages of the last seconds
_NUMBERS = (0.0, -1.0, 1.0, 0.08, math.pi, 1e9, -1e300, 1e-300, math.nan, math.inf, -math.inf)


def lie(kind: type[Any], dice: random.Random) -> Any:
    """Return a message of a class with random values within its types."""
    message = kind()
    for name, of in kind.get_fields_and_field_types().items():
        present = getattr(message, name)
        if hasattr(type(present), "get_fields_and_field_types"):
            setattr(message, name, lie(type(present), dice))
        elif isinstance(present, str):
            setattr(message, name, dice.choice(("", "docking_node", "charger_base", "x" * LONG, "\n\x1b[2J", "é€")))
        elif isinstance(present, bool):
            setattr(message, name, dice.random() < 0.5)
        elif isinstance(present, float):
            setattr(message, name, _fitting(dice.choice(_NUMBERS), of))
        elif isinstance(present, int):
            setattr(message, name, _whole(of, dice))
        elif isinstance(present, array):
            count = dice.choice((0, 1, 3, 3, 3, 9, 100, 5000))
            values = (
                [_fitting(dice.choice(_NUMBERS), of) for _ in range(count)]
                if present.typecode in "fd"
                else [_whole(of, dice) for _ in range(count)]
            )
            setattr(message, name, array(present.typecode, values))
        elif isinstance(present, list):
            setattr(message, name, _several(of.removeprefix("sequence<").rstrip(">"), dice))
    return message


def _several(of: str, dice: random.Random) -> list[Any]:
    """Return random content for a field of texts, truth values or messages; often known texts."""
    if of == "string":
        return dice.choice(([], list(JOINTS), list(JOINTS), list(reversed(JOINTS)), ["x" * LONG], [""] * 3))
    count = dice.choice((0, 1, 3, 3, 100))
    if of == "boolean":
        return [dice.random() < 0.5 for _ in range(count)]
    package, _, kind = of.partition("/")
    return [lie(getattr(importlib.import_module(f"{package}.msg"), kind), dice) for _ in range(count)]


def broken(data: bytes, dice: random.Random) -> bytes:
    """Return a serialised message with some bytes changed and perhaps its end cut off."""
    changed = bytearray(data)
    for _ in range(dice.randrange(1, 20)):
        changed[dice.randrange(len(changed))] = dice.randrange(256)
    return bytes(changed[: dice.choice((len(changed), dice.randrange(len(changed) + 1)))])


def _fitting(value: float, of: str) -> float:
    return max(min(value, 3e38), -3e38) if "float" in of and "32" in of and math.isfinite(value) else value


def _whole(of: str, dice: random.Random) -> int:
    bits = next((bits for bits in (64, 32, 16) if str(bits) in of), 8)
    unsigned = "uint" in of or of in ("byte", "octet")
    low, high = (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return dice.choice((0, 1, low, high, 120))


class Stranger(Node):
    """Acts a hundred times a second until it leaves: random, damaged, repeated, late, doubled or flooding messages.

    Args:
        context: a running rclpy context.
        namespace: of the charger.
        seed: of its random numbers.
    """

    def __init__(self, context: Any, namespace: str, seed: int = 0) -> None:
        super().__init__("stranger", **options(context, namespace))
        self.dice = random.Random(seed)
        self.acts = 0
        self._acting: list[Callable[[], None]] = []
        self._actions: list[Any] = []
        self._end = threading.Event()
        self._spinner: Spinner | None = None
        self._thread = threading.Thread(target=self._act, name="stranger", daemon=True)

    def begin(self) -> Stranger:
        """Start acting."""
        self._spinner = Spinner(self)
        self._thread.start()
        return self

    def leave(self) -> None:
        """Leave the graph. Safe to call twice."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        if self._spinner is not None:
            self._spinner.close(*self._actions)
            self._spinner = None

    def speaks(self, kind: type[Any], topic: str) -> None:
        """Publish a topic of other nodes with arbitrary messages."""
        publisher = self.create_publisher(kind, topic, QoSProfile(depth=10))
        genuine: deque[tuple[float, Any]] = deque(maxlen=_KEPT)
        best = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(kind, topic, lambda message: genuine.append((time.monotonic(), message)), best)

        def act() -> None:
            heard = list(genuine)
            late = [message for when, message in heard if time.monotonic() - when > LATE]
            act = self.dice.choice(("lie", "broken", "repeat", "late", "twice", "flood"))
            message = lie(kind, self.dice)
            if act == "broken" and heard:
                message = broken(serialize_message(heard[-1][1]), self.dice)
            elif act != "lie" and heard:
                message = late[-1] if act == "late" and late else heard[-1][1]
            for _ in range({"twice": 2, "flood": BURST}.get(act, 1)):
                publisher.publish(message)

        self._acting.append(act)

    def asks(self, kind: type[Any], service: str) -> None:
        """Call a service repeatedly, without waiting for responses."""
        client: Any = self.create_client(kind, service)
        calls: deque[Any] = deque()

        def act() -> None:
            for _ in range(2 if self.dice.random() < 0.1 else 1):
                if client.service_is_ready():
                    calls.append(client.call_async(lie(kind.Request, self.dice)))
            while len(calls) > BURST:
                client.remove_pending_request(calls.popleft())

        self._acting.append(act)

    def sends_goals(self, kind: type[Any], name: str) -> None:
        """Send goals repeatedly, without waiting for results."""
        client: Any = ActionClient(self, kind, name)
        self._actions.append(client)

        def act() -> None:
            if client.server_is_ready() and self.acts % GOALS_EVERY == 0:
                client.send_goal_async(lie(kind.Goal, self.dice))

        self._acting.append(act)

    def answers(self, kind: type[Any], service: str) -> None:
        """Serve a service of other nodes, with arbitrary responses, at once or late."""

        def serve(request: Any, response: Any) -> Any:
            if self.dice.random() < 0.3:
                self._end.wait(LATE)
            answer = lie(kind.Response, self.dice)
            if hasattr(answer, "success"):
                answer.success = self.dice.random() < 0.8
            return answer

        self.create_service(kind, service, serve, callback_group=ReentrantCallbackGroup())

    def _act(self) -> None:
        while not self._end.wait(PACE):
            for act in self._acting:
                act()
            self.acts += 1
