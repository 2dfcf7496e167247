# SPDX-License-Identifier: Apache-2.0
"""The system's clock is set forward and back by a second and an hour while the charger docks and while it charges.

The test controls every node's clock (as /clock would) and lets it jump. Durations use the monotonic clock, so a jump
may end a goal with a code or be tolerated. Nothing closes or stays fresh because of it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from rclpy.clock import ROSClock
from rclpy.time import Time

from deltacharger_ros.messages import CODES
from deltacharger_ros.outcomes import Progress
from deltacharger_scenes.scene import Scene

from ..chargers import wait_until
from ..marks import rest
from .hostile import Hostile

pytestmark = pytest.mark.ros

STALE = {"SERVO_FAULT", "TACTILE_STALE", "POWER_STALE", "ESTIMATE_UNSURE"}
_TICK = 0.01  # s


class Clocks:
    """Controls the clocks of several nodes together, starting at the system's time."""

    def __init__(self, nodes: list[Any]) -> None:
        self._clocks: list[ROSClock] = [node.get_clock() for node in nodes]
        self.offset = 0.0
        self._over = threading.Event()
        self._set()
        for clock in self._clocks:
            clock._set_ros_time_is_active(True)
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _set(self) -> None:
        now = Time(nanoseconds=time.time_ns() + int(self.offset * 1e9))
        for clock in self._clocks:
            clock.set_ros_time_override(now)

    def _run(self) -> None:
        while not self._over.wait(_TICK):
            self._set()

    def close(self) -> None:
        self._over.set()
        self._thread.join()
        for clock in self._clocks:
            clock._set_ros_time_is_active(False)


@pytest.fixture(scope="module")
def hostile(quick_scene: Scene, context: Any) -> Iterator[Hostile]:
    hostile = Hostile(quick_scene, context)
    yield hostile
    hostile.close()


@pytest.fixture
def clocks(hostile: Hostile) -> Iterator[Clocks]:
    clocks = Clocks(hostile.nodes())
    yield clocks
    clocks.close()


@pytest.mark.parametrize("jump", [-3600.0, 1.0, rest(-1.0), rest(3600.0)])
def test_a_jump_while_charging_passes_or_opens_with_a_code(hostile: Hostile, clocks: Clocks, jump: float) -> None:
    hostile.heal()
    hostile.charge()
    clocks.offset = jump
    time.sleep(1.0)
    if hostile.code:
        wait_until(lambda: not hostile.is_closed, "an open contactor", 1.0)
        assert CODES[hostile.code] in STALE, hostile.states[-1].error_message
    # Stale and fresh data are distinguished after the jump as before it.
    else:
        assert hostile.is_closed
        hostile.relay.distort["servo_state"] = lambda message: None
        assert hostile.opens_after() < 1.0
        wait_until(lambda: hostile.code, "a code")
        assert CODES[hostile.code] == "SERVO_FAULT"


@pytest.mark.parametrize("jump", [rest(-3600.0), 3600.0])
def test_a_jump_while_docking_passes_or_ends_with_a_code(hostile: Hostile, clocks: Clocks, jump: float) -> None:
    hostile.heal()

    def set_clock(progress: Progress) -> None:
        if progress.phase == "contact":
            clocks.offset = jump

    outcome = hostile.dock(set_clock)
    assert outcome.success or outcome.error_name in STALE, outcome
    assert hostile.is_closed == outcome.success
    hostile.heal()  # with the clock as it now is
