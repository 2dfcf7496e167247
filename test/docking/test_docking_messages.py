# SPDX-License-Identifier: Apache-2.0
"""What docking says on joint_trajectory, and that motion ends with whoever says it."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from builtin_interfaces.msg import Time

from deltacharger_docking.motion import Planner
from deltacharger_docking.observation import Waypoint
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.ros import messages as io
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.geometry import Vector
from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.messages import seconds
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import load_scene
from deltacharger_sim.charger.simulated_charger import SimulatedCharger

from ..chargers import DEADLINE, Process, wait_until

pytestmark = pytest.mark.ros

SPEED = 0.02  # m/s; the way to the standoff then takes 5 s, of which most is left when the sender is struck
STRUCK_AT = 0.015  # m


def test_a_line_is_sent_with_positions_velocities_and_efforts_and_ends_at_rest() -> None:
    waypoints = Planner(DockingParameters(), DeltaGeometry()).line((0.0, 0.0, 0.0), (0.0, 0.0, 0.06), 0.12)
    message = io.trajectory(waypoints, Time(sec=7))
    assert message.header.stamp.sec == 7
    assert list(message.joint_names) == list(io.JOINTS)
    assert len(message.points) == len(waypoints)
    for point, waypoint in zip(message.points, waypoints, strict=True):
        assert tuple(point.positions) == waypoint.angles
        assert tuple(point.velocities) == waypoint.velocities
        assert tuple(point.effort) == waypoint.torque_bound
        assert abs(seconds(point.time_from_start) - waypoint.time) < 1e-8
    assert list(message.points[-1].velocities) == [0.0, 0.0, 0.0]
    assert max(message.points[len(message.points) // 2].velocities) > 0.5


def test_a_goal_without_velocities_is_sent_without_and_no_points_mean_hold() -> None:
    (point,) = io.trajectory([Waypoint(0.0, (0.1, 0.2, 0.3), (1.0, 1.0, 1.0))], Time()).points
    assert list(point.velocities) == []
    assert not io.trajectory((), Time()).points


_CHILD = "DELTACHARGER_KILLS_NODES"
in_a_child = pytest.mark.skipif(_CHILD not in os.environ, reason="run by test_motion_ends_with_its_nodes")


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.timeout(400)
def test_motion_ends_with_its_nodes() -> None:
    """Run the tests below in a process of their own: rclpy has crashed in a client whose action server was killed."""
    command = [sys.executable, "-m", "pytest", "-q", "-k", "motion_dies or without_touch", __file__]
    for _ in range(2):
        child = subprocess.run(command, env=os.environ | {_CHILD: "1"}, capture_output=True, text=True, timeout=180)
        if child.returncode >= 0:  # else a signal ended it, not a law that was broken
            break
    assert child.returncode == 0, child.stdout[-4000:] + child.stderr[-2000:]


class Rig:
    """The simulated charger's bytes, its nodes as processes, and a goal under way."""

    def __init__(self, start: Callable[..., Process], context: Any, namespace: str) -> None:
        scene = load_scene("simulated")
        self.charger = SimulatedCharger(scene.simulation).start()
        ports = {"servo": self.charger.servo_port, "board": self.charger.board_port}
        self.nodes: dict[str, Process] = {}
        for name in ("servo_node", "tactile_node", "docking_node"):
            parameters = scene.node_parameters(name, ports)
            if name == "docking_node":
                parameters["travel_speed"] = SPEED
            words = [sys.executable, "-c", f"import sys; from {NODES[name].module} import main; sys.exit(main())"]
            words += ["--ros-args", "-r", f"__ns:=/{namespace}"]
            for key, value in parameters.items():
                words += ["-p", f"{key}:={value if isinstance(value, str) else json.dumps(value)}"]
            self.nodes[name] = start(*words)
        self.client = ChargerClient(namespace, context)
        self.outcome: Outcome | None = None
        self._struck, self._given_up = threading.Event(), threading.Event()
        self._docking = threading.Thread(target=self._dock, daemon=True)

    @property
    def place(self) -> Vector:
        """Where the platform truly is, m."""
        x, y, z = self.charger.world.snapshot().position
        return x, y, z

    def dock_until_moving(self) -> None:
        assert self.client.wait_until_ready(DEADLINE), {name: each.err for name, each in self.nodes.items()}
        self._docking.start()
        wait_until(lambda: self.place[2] > STRUCK_AT, "a moving arm")

    def strike(self, name: str, number: int) -> None:
        self._struck.set()
        self.nodes[name].process.send_signal(number)

    def travels(self, seconds: float) -> tuple[float, float]:
        """Return how far forward and how far in all (m) it goes in the `seconds` to come."""
        before, end = self.place, time.monotonic() + seconds
        forward = far = 0.0
        while time.monotonic() < end:
            place = self.place
            forward, far = max(forward, place[2] - before[2]), max(far, math.dist(before, place))
            time.sleep(0.005)
        return forward, far

    def close(self) -> None:
        self._given_up.set()
        for each in self.nodes.values():
            if each.process.poll() is None:
                each.process.send_signal(signal.SIGCONT)
                each.process.kill()
        self._docking.join(DEADLINE)
        self.client.close()
        self.charger.stop()

    def _dock(self) -> None:
        """Dock; a goal that a process which starts late has ended is sent again, as a fleet would."""
        request = DockRequest(Pose(0.0, 0.0, 0.080))
        try:
            while not (self._struck.is_set() or self._given_up.is_set()):
                outcome = self.client.dock(request, deadline=DEADLINE, give_up=self._given_up)
                if self._struck.is_set():
                    self.outcome = outcome
        except ClientError:
            return  # the node that was to answer is dead


@pytest.fixture
def rig(start: Callable[..., Process], context: Any, namespace: str) -> Iterator[Rig]:
    rig = Rig(start, context, namespace)
    try:
        yield rig
    finally:
        rig.close()


@in_a_child
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_motion_dies_with_docking_node(rig: Rig, number: int) -> None:
    rig.dock_until_moving()
    rig.strike("docking_node", number)
    _, far = rig.travels(0.5)
    assert far < 0.3 * SPEED, "a fifth of a second of the line, and a loaded machine's pauses"
    _, creep = rig.travels(1.0)
    assert creep < 0.15 * SPEED, "the line would have gone on at full speed"


@in_a_child
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_the_arm_does_not_approach_without_touch(rig: Rig, number: int) -> None:
    rig.dock_until_moving()
    rig.strike("tactile_node", number)
    forward, _ = rig.travels(1.0)
    assert forward < 0.4 * SPEED
    outcome = wait_until(lambda: rig.outcome, "the goal's end")
    assert outcome.error_name == "TACTILE_STALE", outcome
