# SPDX-License-Identifier: Apache-2.0
"""A simulated charger with each node in a separate process that may be killed, stopped and restarted."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
import time
from typing import Any

from deltacharger.msg import DockingState, ServoState, TactileFrame
from rclpy.qos import DurabilityPolicy, QoSProfile

from deltacharger_ros import qos
from deltacharger_ros.client import ChargerClient, ClientError
from deltacharger_ros.on_demand import LatestMessage
from deltacharger_ros.outcomes import DockRequest, Outcome, Pose, Progress
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.scene import parse_scene

from ..chargers import DEADLINE, Process, wait_until
from ..sim.fault_pulse import Pulse
from ..sim.fault_world import CONTACTOR, RecordedCharger

NODE_NAMES = ("servo_node", "tactile_node", "misalignment_node", "kinematics_node", "docking_node")
OLDEST = 1.5  # s of permitted age, so that a loaded computer does not look like a broken cable
SCENE = {
    "nodes": [*NODE_NAMES, "mock_detector_node"],
    "simulation": {"seed": 1, "rig_seed": 1, "world": {"servo": {"damping": 0.3}, "target": {"x": 0.006, "y": 0.006}}},
    "parameters": {
        # Steps are large and waits short, but slow enough that a phase still lasts when it has been published.
        "docking_node": {
            "servo_damping": 0.3,
            "home_z": 0.05,
            "standoff": 0.008,
            "coarse_step": 0.004,
            "search_speed": 0.05,
            "press_speed": 0.05,
            "lift": 0.008,
            "travel_speed": 0.1,
            "overlap_loss_max": 0.006,
            "landing_limit": 0.006,
            "charge_stable_time": 0.5,
            "servo_age_max": OLDEST,
            "tactile_age_max": OLDEST,
            "power_age_max": OLDEST,
        }
    },
}
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Rig:
    """The charger's bytes in this process, its nodes in others, and a client of both actions.

    Attributes:
        state: latest docking_state.
        outcome: of the current goal; None before its end.
        error: why the client has abandoned the goal; '' = it has not.
    """

    def __init__(self, context: Any, namespace: str) -> None:
        self._namespace = namespace
        self._scene = parse_scene(SCENE, "killed")
        self.charger = RecordedCharger.build(self._scene, namespace)
        self.pulse = Pulse()
        self._processes: dict[str, Process] = {}
        self._sent: dict[str, int] = {}  # the last signal of each node
        self.state = DockingState()  # until the first message
        self.outcome: Outcome | None = None
        self.error = ""
        self.phase = ""
        self._goal: threading.Thread | None = None
        self._give_up = threading.Event()
        self.charger.start()
        for name in self._scene.start_order():
            self.start(name)
        self.client = ChargerClient(namespace, context)
        self.client.node.create_subscription(DockingState, "docking_state", self._on_state, LATCHED)
        self._inputs = [
            LatestMessage(self.client.node, TactileFrame, "tactile_frame", qos.SENSOR),
            LatestMessage(self.client.node, ServoState, "servo_state", qos.LATEST),
        ]
        self.ready()

    def start(self, name: str) -> None:
        """Start a node."""
        ports = {"servo": self.charger.servo_port, "board": self.charger.board_port}
        words = [sys.executable, "-c", f"import sys; from {NODES[name].module} import main; sys.exit(main())"]
        words += ["--ros-args", "-r", f"__ns:=/{self._namespace}"]
        for key, value in self._scene.node_parameters(name, ports).items():
            words += ["-p", f"{key}:={value if isinstance(value, str) else json.dumps(value)}"]
        self._processes[name] = Process(*words)

    def ready(self) -> None:
        """Wait until all nodes are present and publish: a killed one stays in the graph for a while."""
        errors = {name: each.err[-3:] for name, each in self._processes.items()}
        assert self.client.wait_until_ready(DEADLINE), errors
        for service in ("set_torque", "probe", "predict_misalignment", "detect_electrodes"):
            wait_until(lambda service=service: self._serves(service), service)  # type: ignore[misc]
        for topic in self._inputs:
            topic.take()
            wait_until(topic.take, "inputs of docking")

    def _serves(self, name: str) -> bool:
        known = {each for each, _ in self.client.node.get_service_names_and_types()}
        return f"/{self._namespace}/{name}" in known

    def send(self, name: str, number: int) -> float:
        """Send a signal to a node and return when, s of the world."""
        at = self.charger.world.time
        self._sent[name] = number
        os.kill(self._processes[name].process.pid, number)
        return at

    def restart(self, name: str) -> None:
        """Start a killed node again, or continue a stopped one."""
        process = self._processes[name].process
        if self._sent.pop(name, None) == signal.SIGKILL:
            self.reap(name)
        process.send_signal(signal.SIGCONT)
        if process.poll() is not None:
            self.start(name)

    def reap(self, name: str) -> None:
        """Wait until a killed node has ended."""
        self._processes[name].process.wait(DEADLINE)

    def begin(self, phase: str) -> None:
        """Send goals until one has reached a phase; charging and retract begin after a docking.

        On a loaded computer a goal may end earlier, and docking may discover a restarted node later than this client.
        """
        end = time.monotonic() + DEADLINE
        while True:
            self._dock(phase)
            if phase in ("charging", "retract"):
                wait_until(lambda: self.outcome or self.error, "the end of docking")
                reached = self.outcome is not None and self.outcome.success
            else:
                reached = not (self.outcome or self.error)
            if reached:
                break
            assert time.monotonic() < end, self.outcome or self.error
            self.go_home()
        if phase == "retract":
            self.outcome, self.phase = None, ""
            self._run(lambda: self.client.undock(on_progress=self._on_progress))
            wait_until(lambda: self.phase == phase, phase)

    def _dock(self, phase: str) -> None:
        """Send a goal, and wait for a phase or for its end."""
        self.outcome, self.error, self.phase = None, "", ""
        request = DockRequest(None if phase == "locate" else Pose(0.0, 0.0, 0.080))
        self._run(lambda: self.client.dock(request, self._on_progress, give_up=self._give_up))
        wait_until(lambda: self.phase == phase or self.outcome or self.error, phase)

    def _run(self, act: Any) -> None:
        def work() -> None:
            try:
                self.outcome = act()
            except ClientError as error:
                self.error = str(error)

        if self._goal is not None:
            self._goal.join(DEADLINE)
        self._give_up.clear()
        self._goal = threading.Thread(target=work, daemon=True)
        self._goal.start()

    def give_up(self) -> None:
        """Stop waiting for the goal: its server has ended."""
        self._give_up.set()
        if self._goal is not None:
            self._goal.join(DEADLINE)

    def opened(self, since: float) -> float:
        """Return the time (s of the world) from an instant until the contactor opened, once it has."""
        events = self.charger.world.events
        times = wait_until(
            lambda: [event.time for event in list(events) if event.time >= since and event[1:3] == (CONTACTOR, False)],
            "an open contactor",
            10.0,
        )
        return float(times[0] - since)

    def wait(self, seconds: float) -> None:
        """Wait for some seconds of the world."""
        end = self.charger.world.time + seconds
        wait_until(lambda: self.charger.world.time >= end, "the world to go on")

    @property
    def place(self) -> tuple[float, float, float]:
        x, y, z = self.charger.world.snapshot().position
        return x, y, z

    def assert_never_hurt(self) -> None:
        record = self.charger.world.record
        assert record.energised_shorts == 0
        assert record.energised_unsafe == 0.0
        assert record.parted_live == 0
        assert record.unpowered_live == 0

    def go_home(self) -> None:
        """Undock until that works, as a fleet would, and check that everything is safe."""
        messages: list[str] = []

        def done() -> bool:
            outcome = self.client.undock(deadline=DEADLINE)
            messages.append(outcome.error_message)
            return outcome.success

        wait_until(done, f"the arm home {messages}")
        wait_until(lambda: not any(self.charger.world.torque), "no torque", 5.0)
        assert not self.charger.world.circuit.closed

    def close(self) -> None:
        self._give_up.set()
        for each in self._processes.values():
            if each.process.poll() is None:
                each.process.send_signal(signal.SIGCONT)
                each.process.kill()
                each.process.wait(DEADLINE)
        self.client.close()
        self.charger.stop()
        self.pulse.close()

    def _on_progress(self, progress: Progress) -> None:
        self.phase = progress.phase

    def _on_state(self, message: DockingState) -> None:
        self.state = message
