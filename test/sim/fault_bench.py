# SPDX-License-Identifier: Apache-2.0
"""Bring a charger into each phase of its work, and back there after every fault, without complete dockings."""

from __future__ import annotations

import enum
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from rclpy.context import Context

from deltacharger_driver.board.tactile_node import TactileNode
from deltacharger_driver.servos.servo_node import ServoNode
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_ros.executor import Spinner
from deltacharger_scenes.scene import parse_scene
from deltacharger_sim.charger.faults import Faults

from ..chargers import wait_until
from ..nodes import options
from .fault_client import PATIENCE, FaultClient
from .fault_pulse import Pulse
from .fault_world import CONTACTOR, RecordedCharger

SCENE = {"nodes": [], "simulation": {"seed": 3, "rig_seed": 1, "world": {"target": {"y": -0.003, "z": 0.080}}}}
_PRESSED = 0.083  # m; goal behind the target's face, for a push by the servos' springs
_NEAR, _FAR, _PERIOD = 0.010, 0.050, 1.2  # m, m, s: motion to and fro in free air
_LINE = 40.0  # s of that motion
_PULL = 4.0  # N·m of each servo, enough for the magnets
_TOUCH = 1.0  # N
_AT_REST = 0.005  # rad/s
_RESTS = 0.1  # s of the world


class Phase(enum.Enum):
    """Activity of the charger at the time of a fault."""

    MOVING = "moving"
    PRESSING = "pressing"
    CHARGING = "charging"


@dataclass(frozen=True)
class Mark:
    """An instant: s of the world, s of the monotonic clock, number of events so far, push (N)."""

    world: float
    host: float
    events: int
    push: float


class Bench:
    """Both drivers on a simulated charger, with a client that acts as docking_node and operator."""

    def __init__(self, context: Context, namespace: str) -> None:
        self.charger = RecordedCharger.build(parse_scene(SCENE, "faults"), namespace)
        self.world = self.charger.world
        self._kinematics = ScalarDelta(DeltaGeometry())
        self.pulse = Pulse()
        self._spinners: list[Spinner] = []
        try:
            self.charger.start()
            for node, port in ((TactileNode, self.charger.board_port), (ServoNode, self.charger.servo_port)):
                self._spinners.append(Spinner(node(**options(context, namespace, port=port))))
            self.client = FaultClient(context, namespace)
            self._spinners.append(Spinner(self.client))
            self.wait(self.client.is_connected, "discovery")
            self.tare()
        except BaseException:
            self.close()
            raise

    @property
    def faults(self) -> Faults:
        """Faults of the hardware."""
        assert self.charger.faults is not None
        return self.charger.faults

    def close(self) -> None:
        for spinner in reversed(self._spinners):
            spinner.close()
        self.charger.stop()
        self.pulse.close()

    def wait(self, condition: Callable[[], Any], what: str, patience: float = PATIENCE) -> None:
        """Wait for a condition, at most `patience` (s)."""
        wait_until(condition, what, patience)

    def mark(self) -> Mark:
        """Return the present instant, and reset the largest push and the longest pause."""
        self.world.record.peak_push = self.world.stood = 0.0
        return Mark(self.world.time, time.monotonic(), len(self.world.events), self.world.push())

    def reach(self, phase: Phase) -> None:
        """Bring the charger from any state into `phase`, with a client's means only."""
        if phase is not Phase.CHARGING or not self._is_pressed():  # the arm must not move while the contactor is closed
            self.client.stop_renewing()
            if self.world.circuit.closed:
                self.ask("set_contactor", close=False)
            self.wait(lambda: not self.client.power.contactor_closed, "the opening to be published")
        self.wait(lambda: all(self.client.servo.valid), "all servos to answer")
        count = self.client.received["frame"]
        self.wait(lambda: self.client.received["frame"] > count, "tactile frames")
        self.ask("set_torque", data=True)
        if phase is Phase.MOVING:
            self._shuttle()
            return
        if not self._is_pressed():
            self._press()
        if phase is Phase.CHARGING and not self.is_charging():
            self.ask("probe")
            answer = self.client.keep_closed()
            assert answer.success, answer.message
            self.wait(self.is_charging, "charge current")

    def ask(self, name: str, **fields: Any) -> None:
        """Call a service until it succeeds; it may still be finishing another task."""
        answers: list[str] = []

        def done() -> bool:
            answer = self.client.call(name, **fields)
            answers.append(answer.message)
            return bool(answer.success)

        end = time.monotonic() + PATIENCE
        while not done():
            assert time.monotonic() < end, f"{name} {fields or ''}: {list(dict.fromkeys(answers))}"

    def is_charging(self) -> bool:
        """Whether the contactor is closed and current flows."""
        return self.world.circuit.closed and self.world.circuit.current > 0.5

    def is_moving(self, since: float) -> bool:
        """Whether all goals have changed since `since` (s of the world)."""
        return min(self.world.turned) > since

    def restore(self) -> None:
        """Clear the effects of a failed cell, so that the next one begins normally."""
        self.client.stop_renewing()
        self.faults.clear()
        self.wait(lambda: any(self.client.servo.valid), "a servo to answer")
        self.ask("set_contactor", close=False)
        self.ask("set_torque", data=False)
        if any(self.client.servo.hardware_error) or not all(self.client.servo.valid):
            self.ask("reboot_servos")
        if not self.client.frame.tared:
            self.tare()
        self.client.untrue.clear()

    def tare(self) -> None:
        """Tare in free air, from any position."""
        if self.world.mechanics.contact_force > 0.0:
            self.ask("set_torque", data=True)
            self.client.send([(0.3, self._angles(_FAR))], _PULL)
            self.wait(lambda: self.world.mechanics.position[2] < _FAR + 0.01, "the arm off the magnets")
        self.ask("tare")
        self.wait(lambda: self.client.frame.tared, "tared frames")

    def _angles(self, z: float) -> Sequence[float]:
        return self._kinematics.inverse(0.0, 0.0, z)

    def _shuttle(self) -> None:
        """Move to and fro in free air for the duration of a cell."""
        middle, swing = 0.5 * (_NEAR + _FAR), 0.5 * (_FAR - _NEAR)
        times = np.arange(0.3, _LINE, 0.05)
        places = middle + swing * np.sin((times - 0.3) * 2.0 * math.pi / _PERIOD)
        since = self.world.time
        self.client.send([(float(at), self._angles(float(z))) for at, z in zip(times, places, strict=True)])
        self.wait(lambda: self.is_moving(since + 0.1), "the arm to move")

    def _is_pressed(self) -> bool:
        return np.allclose(self.world._reference, self._angles(_PRESSED), atol=0.002)

    def _press(self) -> None:
        self.client.send([(0.4, self._angles(_PRESSED))])
        self.wait(self._is_pressed, "the goal behind the target's face")
        self.wait(lambda: np.nanmax(self.client.taxels()) >= _TOUCH, "the pads to measure the target")
        self.wait(self._rests(), "the arm at rest")

    def _rests(self) -> Callable[[], bool]:
        """Return a condition: the arm has been at rest for `_RESTS`; an instant is also the end of a bounce."""
        moved = self.world.time

        def rests() -> bool:
            nonlocal moved
            if max(map(abs, self.world.mechanics.rates)) >= _AT_REST:
                moved = self.world.time
            return self.world.time - moved > _RESTS

        return rests


def contactor_opened(bench: Bench, mark: Mark) -> float:
    """Return when the contactor first opened after a mark, s of the world after it; inf if it did not."""
    opened = bench.world.since(mark.events, CONTACTOR, False)
    return opened[0].time - mark.world if opened else math.inf
