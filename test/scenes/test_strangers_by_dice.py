# SPDX-License-Identifier: Apache-2.0
"""A foreign program with random messages and responses in a charger's namespace does no harm.

Beside a second source of what docking relies on no contactor closes. The next goal is served.
"""

from __future__ import annotations

import importlib
import math
import random
from array import array
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from deltacharger.action import Dock
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import PredictMisalignment, Probe, SetContactor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from deltacharger_core.machine import JOINTS
from deltacharger_docking import energy
from deltacharger_ros.executor import Spinner

from ..chargers import wait_until
from ..nodes import options
from ..quick import quick_simulation
from ..running_charger import RunningCharger

pytestmark = [pytest.mark.ros, pytest.mark.night]

ACTS = 100  # of a foreign node while electrodes are live
PACE = 0.01  # s between two of them
_NUMBERS = (0.0, -1.0, 1.0, 0.08, math.pi, 1e9, -3e38, 1e-300, math.nan, math.inf, -math.inf)
_TEXTS = ("", "docking_node", "charger_base", "x" * 100_000, "\n\x1b[2J", "é€")
_LISTS = ([], list(JOINTS), list(JOINTS), list(reversed(JOINTS)), [""] * 3)


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


class Stranger(Node):
    """Publishes or serves a name of other nodes with random, damaged, repeated, old or flooding messages."""

    def __init__(self, context: Any, namespace: str, name: str) -> None:
        super().__init__("stranger", **options(context, namespace))
        self.dice = random.Random(name)
        self.acts = 0
        if name in SERVICES:
            self.create_service(SERVICES[name], name, self._serve)
            return
        kind = TOPICS[name]
        publisher = self.create_publisher(kind, name, QoSProfile(depth=10))
        genuine: deque[Any] = deque([kind()], maxlen=100)
        best = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.create_subscription(kind, name, lambda message: genuine.append(message), best)
        messages: list[Callable[[], Any]] = [
            lambda: lie(kind, self.dice),
            lambda: self._broken(serialize_message(genuine[-1])),
            lambda: genuine[-1],
            lambda: genuine[0],
        ]

        def act() -> None:
            message = self.dice.choice(messages)()
            for _ in range(self.dice.choice((1, 1, 2, 50))):
                publisher.publish(message)
            self.acts += 1

        self.create_timer(PACE, act)

    def _broken(self, data: bytes) -> bytes:
        """Return bytes of which some are changed, and the end perhaps cut off."""
        changed = bytearray(data)
        for _ in range(self.dice.randrange(1, 20)):
            changed[self.dice.randrange(len(changed))] = self.dice.randrange(256)
        return bytes(changed[: self.dice.choice((len(changed), self.dice.randrange(len(changed) + 1)))])

    def _serve(self, request: Any, response: Any) -> Any:
        self.acts += 1
        return lie(type(response), self.dice)


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(energy, "_DUPLICATE_SOURCE_TIMEOUT", 0.5)
        with RunningCharger(quick_simulation("simulated"), context) as charger:
            yield charger


@pytest.mark.parametrize("name", [*TOPICS, *SERVICES])
def test_no_contactor_closes_beside_a_second_source_and_live_electrodes_stay_unharmed(
    charger: RunningCharger, context: Any, name: str
) -> None:
    """Dock beside a foreign node, then without it, and add it again while current flows."""
    for live in (False, True):
        if live:
            charger.charge()
        energised = charger.world.record.energised
        spinner = Spinner(Stranger(context, charger.namespace, name))
        stranger: Any = spinner.node
        if not live:
            outcome = charger.dock()
            assert not outcome.success
            assert outcome.error_name != "INTERNAL", outcome
            assert charger.world.record.energised == energised
        elif name in TOPICS:
            wait_until(lambda stranger=stranger: stranger.acts >= ACTS, "the stranger's acts")
        else:
            wait_until(lambda: charger.state.duplicate_sources, "the discovery of the second server")
        spinner.close()
        charger.assert_unharmed()
        charger.wait_until_single()
        charger.go_home()
    assert Dock.Result.INTERNAL not in {state.error_code for state in charger.states}
    assert charger.composition is not None
    assert charger.composition.failed() == []
