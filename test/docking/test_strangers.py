# SPDX-License-Identifier: Apache-2.0
"""A stranger who floods docking's topics with lies, repetitions and broken bytes, by dice, before and while it charges.

Whatever it says: docking_node lives, meets no defect, closes nothing while the stranger is there, and the next goal is
served when it is gone.
"""

from __future__ import annotations

import random
import threading
import time
from array import array
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.node import Node
from rclpy.serialization import serialize_message

from deltacharger_ros.messages import CODES
from deltacharger_scenes.scene import Scene

from ..chargers import wait_until
from ..nodes import options
from .hostile import TOPICS, Defects, Hostile

pytestmark = [pytest.mark.ros, pytest.mark.realtime, pytest.mark.slow]

PACE = 0.004  # s between two messages of a stranger: faster than any of the true ones
LEAST = 500  # messages that it sends in each of its visits
NUMBERS = (0.0, 1.0, -1.0, 0.3, 1e-300, 1e308, -1e308, float("nan"), float("inf"), float("-inf"))
SHIFTS = (0, 0, 0, 1, -1, 3600, -3600)


class Stranger:
    """Hears the true messages and publishes others beside them until it leaves.

    Attributes:
        sent: messages so far.
    """

    def __init__(self, hostile: Hostile, seed: int) -> None:
        self.sent = 0
        self._dice = random.Random(seed)
        self._hostile = hostile
        self._heard: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
        for topic in TOPICS:
            hostile.relay.distort[topic] = self._listener(topic)
        self._node = Node("stranger", **options(hostile.context, hostile.namespace))
        self._publishers = {
            topic: self._node.create_publisher(kind, f"heard/{topic}", qos) for topic, (kind, qos) in TOPICS.items()
        }
        wait_until(lambda: "stranger" in hostile.states[-1].duplicate_sources, "the stranger to be seen")
        self._gone = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    def leave(self) -> None:
        wait_until(lambda: self.sent >= LEAST, "a stranger's words")
        self._gone.set()
        self._thread.join()
        self._node.destroy_node()
        wait_until(lambda: not self._hostile.states[-1].duplicate_sources, "the stranger to be gone")

    def _listener(self, topic: str) -> Any:
        def listen(message: Any) -> Any:
            self._heard[topic] = [*self._heard[topic][-9:], serialize_message(message)]
            return message

        return listen

    def _talk(self) -> None:
        while not self._gone.wait(PACE):
            topic = self._dice.choice(list(TOPICS))
            if self._heard[topic]:
                self._publishers[topic].publish(self._word(topic))
                self.sent += 1

    def _word(self, topic: str) -> Any:
        data = self._dice.choice(self._heard[topic])
        way = self._dice.randrange(4)
        if way == 0:
            return data  # one of the true ones again
        if way == 1:
            return self._broken(bytearray(data))
        return self._lie(TOPICS[topic][0])

    def _broken(self, data: bytearray) -> bytes:
        dice = self._dice
        for _ in range(dice.randrange(1, 20)):
            data[dice.randrange(len(data))] = dice.randrange(256)
        return bytes(data[: dice.choice((len(data), dice.randrange(len(data) + 1)))])

    def _lie(self, kind: Any) -> Any:
        """Return a message of fields at random, most of them of the right length and stamped now."""
        dice, message = self._dice, kind()
        now = time.time()
        message.header.stamp.sec = min(int(now) + dice.choice(SHIFTS), 2**31 - 1)
        message.header.stamp.nanosec = dice.choice((int(now % 1 * 1e9), 2**32 - 1, 0))
        for name, type_ in kind.get_fields_and_field_types().items():
            value = getattr(message, name)
            if isinstance(value, bool):
                setattr(message, name, dice.random() < 0.5)
            elif isinstance(value, float):
                setattr(message, name, dice.choice(NUMBERS[:4] if type_ == "float" else NUMBERS))
            elif isinstance(value, int):
                setattr(message, name, dice.choice((0, 1, 3, 10, 10, 10, 255)))
            elif isinstance(value, array) and value.typecode in "fd":
                length = dice.choice((0, 3, 3, 100, 100, 101))
                row = [dice.choice(NUMBERS[:4]) for _ in range(length)]
                setattr(message, name, array(value.typecode, row))
        return message


@pytest.fixture(scope="module")
def hostile(quick_scene: Scene, context: Any) -> Iterator[Hostile]:
    hostile = Hostile(quick_scene, context, duplicate_source_timeout=0.5)
    yield hostile
    hostile.close()


@pytest.mark.timeout(300)
@pytest.mark.parametrize("seed", range(4))
def test_a_stranger_by_dice_does_no_harm(hostile: Hostile, seed: int) -> None:
    defects = Defects(hostile)
    stranger = Stranger(hostile, seed)
    outcome = hostile.dock()
    assert not outcome.success
    assert outcome.error_name != "INTERNAL", outcome
    assert not hostile.is_closed
    stranger.leave()
    hostile.heal()
    hostile.charge()
    stranger = Stranger(hostile, seed + 1000)
    stranger.leave()
    assert CODES[hostile.code] != "INTERNAL"
    wait_until(lambda: hostile.is_closed or hostile.is_idle(), "charging or the way home")
    hostile.heal()
    hostile.charge()
    hostile.heal()
    assert defects.told == []
