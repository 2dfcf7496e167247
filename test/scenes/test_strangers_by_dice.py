# SPDX-License-Identifier: Apache-2.0
"""A foreign program with random messages and responses in a charger's namespace does no harm.

Beside a second source of what docking relies on no contactor closes. The next goal is served.
"""

from __future__ import annotations

import importlib
import math
import random
import threading
import time
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from deltacharger.action import Dock
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import PredictMisalignment, Probe, SetContactor
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core.machine import JOINTS
from deltacharger_ros.executor import Spinner

from ..chargers import wait_until
from ..nodes import options
from ..quick import quick_simulation
from ..running_charger import PATIENT, RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.night]

ACTS = 100  # of a foreign node while electrodes are live
STEPS = {**PATIENT, "duplicate_source_timeout": 0.5}
TOPICS = {
    "servo_state": ServoState,
    "tactile_frame": TactileFrame,
    "charger_power": ChargerPower,
    "joint_trajectory": JointTrajectory,
}
SERVICES = {
    "predict_misalignment": PredictMisalignment,
    "probe": Probe,
    "set_contactor": SetContactor,
    "set_torque": SetBool,
    "tare": Trigger,
}
CASES = [
    *(("speaks", kind, name) for name, kind in TOPICS.items()),
    *(("answers", kind, name) for name, kind in SERVICES.items()),
]


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(quick_simulation("simulated", STEPS), context) as charger:
        yield charger


@contextmanager
def stranger(context: Any, charger: RunningCharger, act: str, kind: Any, name: str) -> Iterator[Stranger]:
    """Add a foreign node with a case's behaviour until the end of the block."""
    spinner = Spinner(Stranger(context, charger.namespace))
    node: Any = spinner.node
    getattr(node, act)(kind, name)
    yield node
    spinner.close()
    charger.assert_unharmed()
    charger.wait_until_single()


@pytest.mark.parametrize(("act", "kind", "name"), CASES, ids=str)
def test_no_contactor_closes_beside_a_second_source_and_live_electrodes_stay_unharmed(
    charger: RunningCharger, context: Any, act: str, kind: Any, name: str
) -> None:
    """Dock beside a foreign node, then without it, and add it again while current flows."""
    energised = charger.world.record.energised
    with stranger(context, charger, act, kind, name):
        outcome = charger.dock()
        assert not outcome.success
        assert outcome.error_name != "INTERNAL", outcome
        assert charger.world.record.energised == energised
    charger.go_home()
    charger.charge()
    with stranger(context, charger, act, kind, name) as visitor:
        wait_until(lambda: visitor.acts >= ACTS, "the stranger's acts")
    charger.go_home()
    assert Dock.Result.INTERNAL not in {state.error_code for state in charger.states}
    assert charger.composition is not None
    assert charger.composition.failed() == []


PACE = 0.01  # s between two actions
BURST = 50  # messages of a flood
LATE = 0.7  # s, older than anything that docking accepts
_KEPT = 200  # genuine messages of the last seconds
_NUMBERS = (0.0, -1.0, 1.0, 0.08, math.pi, 1e9, -3e38, 1e-300, math.nan, math.inf, -math.inf)
_TEXTS = ("", "docking_node", "charger_base", "x" * 100_000, "\n\x1b[2J", "é€")
_LISTS = ([], list(JOINTS), list(JOINTS), list(reversed(JOINTS)), [""] * 3)


def lie(kind: type[Any], dice: random.Random) -> Any:
    """Return a message of a class with random values within its types."""
    message = kind()
    for name, of in kind.get_fields_and_field_types().items():
        setattr(message, name, _value(getattr(message, name), of, dice))
    return message


def _value(present: Any, of: str, dice: random.Random) -> Any:
    count = dice.choice((0, 1, 3, 3, 3, 9, 100, 5000))
    if hasattr(type(present), "get_fields_and_field_types"):
        return lie(type(present), dice)
    if isinstance(present, str):
        return dice.choice(_TEXTS)
    if isinstance(present, bool):
        return dice.random() < 0.5
    if isinstance(present, float):
        return dice.choice(_NUMBERS)
    if isinstance(present, int):
        return _whole(of, dice)
    if isinstance(present, array):
        numbers = dice.choices(_NUMBERS, k=count) if present.typecode in "fd" else [_whole(of, dice)] * count
        return array(present.typecode, numbers)
    if not isinstance(present, list):
        return present
    if "string" in of:
        return dice.choice(_LISTS)
    if "boolean" in of:
        return [dice.random() < 0.5 for _ in range(count)]
    package, _, kind = of.removeprefix("sequence<").rstrip(">").partition("/")
    return [lie(getattr(importlib.import_module(f"{package}.msg"), kind), dice) for _ in range(min(count, 9))]


def _whole(of: str, dice: random.Random) -> int:
    bits = next((bits for bits in (64, 32, 16) if str(bits) in of), 8)
    unsigned = "uint" in of or of in ("byte", "octet")
    low, high = (0, 2**bits - 1) if unsigned else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    return dice.choice((0, 1, low, high, 120))


def broken(data: bytes, dice: random.Random) -> bytes:
    """Return a serialised message with some bytes changed and perhaps its end cut off."""
    changed = bytearray(data)
    for _ in range(dice.randrange(1, 20)):
        changed[dice.randrange(len(changed))] = dice.randrange(256)
    return bytes(changed[: dice.choice((len(changed), dice.randrange(len(changed) + 1)))])


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
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._act, name="stranger", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop acting; its executor calls it before it leaves the graph."""
        self._end.set()
        self._thread.join()

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
            if self._acting:
                self.dice.choice(self._acting)()
            self.acts += 1
