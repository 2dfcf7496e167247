# SPDX-License-Identifier: Apache-2.0
"""A running charger for tests: its nodes in this process or in others, its emulators recorded here, and a client."""

from __future__ import annotations

import contextlib
import json
import math
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any

from deltacharger.msg import ChargerPower, DockingState, ServoState, TactileFrame
from rclpy.parameter import Parameter

from deltacharger_bringup.scenes import composition, node_table
from deltacharger_bringup.scenes.scene import Ports, Scene
from deltacharger_core.ros import client, on_demand, outcomes, qos
from deltacharger_docking.ros import services as docking_services

from .chargers import DEADLINE, Process, new_namespace, patience, wait_until
from .sim.fault_world import CONTACTOR, RecordedCharger, RecordedWorld

GOAL = outcomes.DockRequest(outcomes.Pose(0.0, 0.0, 0.080))
_LOOK = 1.0  # s between docking_node's checks for second sources while it rests

CommandLine = Callable[[Path, str], Sequence[str]]
"""Returns the command line that starts a charger from a scene's file in a namespace."""


def up(file: Path, namespace: str) -> Sequence[str]:
    """Return the command line of `deltacharger up`."""
    command = (sys.executable, "-m", "deltacharger_bringup.cli", "up")
    return (*command, "--scene", str(file), "--namespace", namespace)


def node_command(scene: Scene, name: str, namespace: str) -> list[str]:
    """Return the command line of one node of a scene, as `ros2 run` starts it."""
    words = [sys.executable, "-c", f"import sys; from {node_table.NODES[name].module} import main; sys.exit(main())"]
    words += ["--ros-args", "-r", f"__ns:=/{namespace}"]
    for key, value in scene.node_parameters(name, {}).items():
        words += ["-p", f"{key}:={value if isinstance(value, str) else json.dumps(value)}"]
    return words


class RunningCharger:
    """A charger from its start to `close`, used in a `with` block; ready when the constructor returns.

    The emulators of a simulated scene run in this process and record their world, wherever the nodes run.

    Args:
        scene: what to start.
        context: a running rclpy context.
        apart: nodes that run in a process each; the others run in this one.
        command: of one process that runs all nodes, such as `up`; None = as `apart` says.
        namespace: of the charger; '' = a new one.

    Attributes:
        scene: with the emulators' ports, if it is simulated.
        emulators: the simulated hardware; None = the scene has none.
        composition: the nodes in this process; None = there are none.
        processes: the others by name of the node; "charger" = all nodes.
        client: of both actions; its node can have more subscriptions.
        states: every docking_state so far.
        phase: of the running goal, from its feedback.
    """

    def __init__(
        self,
        scene: Scene,
        context: Any,
        apart: Collection[str] = (),
        command: CommandLine | None = None,
        namespace: str = "",
    ) -> None:
        self.namespace = namespace or new_namespace()
        self.emulators: RecordedCharger | None = None
        self.composition: composition.Composition | None = None
        self.processes: dict[str, Process] = {}
        self.states: list[DockingState] = []
        self.phase = ""
        self._latest: dict[type[Any], Any] = {}
        self._awaited: tuple[str, Callable[[], None]] = ("", lambda: None)
        self.struck: dict[str, int] = {}  # the last signal of each node that was not restarted since
        self._restarted = False
        with contextlib.ExitStack() as opened:
            opened.enter_context(patience(docking_services))
            self.scene = self._on_ports(scene, opened)
            opened.callback(self._kill)
            if command is not None:
                self.processes["charger"] = Process(*command(self._file(opened), self.namespace))
            for name in self.scene.start_order() if command is None else ():
                if name in apart:
                    self.processes[name] = Process(*node_command(self.scene, name, self.namespace))
            if command is None and not set(apart) >= set(scene.nodes):
                part = replace(self.scene, nodes=tuple(name for name in scene.nodes if name not in apart))
                self.composition = opened.enter_context(composition.Composition(part, context, self.namespace))
            self.client = opened.enter_context(client.ChargerClient(self.namespace, context))
            node = self.client.node
            self._topics = {
                kind: on_demand.LatestMessage(node, kind, name, quality)
                for kind, name, quality in (
                    (ServoState, "servo_state", qos.LATEST),
                    (TactileFrame, "tactile_frame", qos.SENSOR),
                    (ChargerPower, "charger_power", qos.LATEST),
                )
            }
            node.create_subscription(DockingState, "docking_state", self.states.append, qos.STATE)
            self.wait_until_ready()
            self._opened = opened.pop_all()

    def __enter__(self) -> RunningCharger:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """End everything; processes that still run are killed. Safe to call twice."""
        self._opened.close()

    # Its state

    @property
    def world(self) -> RecordedWorld:
        """The simulated world with its events: the truth, which docking does not know."""
        assert self.emulators is not None
        return self.emulators.world

    @property
    def is_closed(self) -> bool:
        """Whether the contactor is truly closed."""
        if self.emulators is not None:
            return self.world.circuit.closed
        if self.composition is not None:
            return bool(self.node("mock_tactile_node").contactor_closed)
        return bool(self._newest(ChargerPower).contactor_closed)

    @property
    def state(self) -> DockingState:
        """The latest docking_state."""
        return self.states[-1]

    @property
    def servos(self) -> Any:
        """The latest servo_state."""
        return self._newest(ServoState)

    def _newest(self, kind: type[Any]) -> Any:
        if (message := self._topics[kind].take()) is not None:
            self._latest[kind] = message
        return self._latest.get(kind)

    def node(self, name: str) -> Any:
        """Return a node of this process by its executable's name."""
        assert self.composition is not None
        return self.composition.node(name)

    def set(self, name: str, **parameters: Any) -> None:
        """Set parameters of a node of this process, such as the fault of a mock."""
        for result in self.node(name).set_parameters(
            [Parameter(key, value=value) for key, value in parameters.items()]
        ):
            assert result.successful, result.reason

    def wait_until_ready(self) -> None:
        """Wait until every node serves and publishes, and docking_node knows of no second source.

        A killed node stays in the graph for 5 s. Docking itself waits for services and topics of nodes that it has not
        discovered yet, so the next goal needs no second attempt.
        """
        ready = self.client.wait_until_ready(DEADLINE)
        assert ready, {name: (each.process.poll(), each.err[-3:]) for name, each in self.processes.items()}
        services = ["set_torque", "probe", "set_contactor", "dock/_action/send_goal"]
        if "misalignment_node" in self.scene.nodes:
            services.append("predict_misalignment")
        for name in services:
            wait_until(lambda name=name: self.client.node.count_services(name) == 1, name)  # type: ignore[misc]
        for kind in self._topics:
            self._newest(kind)
        self._latest.clear()
        wait_until(lambda: all(map(self._newest, self._topics)) and self.states, "every topic")
        if self._restarted:
            self.wait_until_single()

    def wait_until_single(self) -> None:
        """Wait until docking_node has looked again and found no second source."""
        since = time.monotonic()

        def single() -> bool:
            nonlocal since
            if self.state.duplicate_sources:
                since = time.monotonic()
            return time.monotonic() - since > 2.0 * _LOOK

        wait_until(single, "one source of each message")

    # Goals

    def dock(self, request: outcomes.DockRequest = GOAL, on_progress: Any = None, **options: Any) -> outcomes.Outcome:
        """Send one goal and return its outcome."""
        return self.client.dock(request, self._noting(on_progress), **({"deadline": DEADLINE} | options))

    def undock(self, **options: Any) -> outcomes.Outcome:
        """Undock, and return the outcome."""
        return self.client.undock(on_progress=self._noting(None), **({"deadline": DEADLINE} | options))

    def charge(self, request: outcomes.DockRequest = GOAL) -> outcomes.Outcome:
        """Dock, which must succeed, and return the outcome."""
        outcome = self.dock(request)
        assert outcome.success, outcome
        assert self.is_closed, self.state.error_message
        return outcome

    def go_home(self) -> None:
        """Undock, which must succeed, and check that everything is safe."""
        outcome = self.undock()
        assert outcome.success, outcome
        self.assert_safe()

    def begin(
        self, phase: str, act: Callable[[], outcomes.Outcome] | None = None, then: Callable[[], None] = lambda: None
    ) -> Future[outcomes.Outcome]:
        """Dock, or act, in another thread until the goal reaches a phase; return the future of its outcome.

        A phase may last for milliseconds only: `then` is called in the client's thread as soon as it is reported.
        """
        future: Future[outcomes.Outcome] = Future()
        reached = threading.Event()

        def note() -> None:
            if not reached.is_set():
                then()
                reached.set()

        def work() -> None:
            try:
                future.set_result((act or self.dock)())
            except BaseException as error:
                future.set_exception(error)

        self._awaited = phase, note
        threading.Thread(target=work, daemon=True).start()
        wait_until(lambda: reached.is_set() or future.done(), phase)
        assert reached.is_set(), future.result()
        return future

    def _noting(self, on_progress: Any) -> Callable[[outcomes.Progress], None]:
        def note(progress: outcomes.Progress) -> None:
            self.phase = progress.phase
            if self._awaited[0] == progress.phase:
                self._awaited[1]()
            if on_progress is not None:
                on_progress(progress)

        return note

    # Signals, and what they must not harm

    def signal(self, number: int, *names: str) -> float:
        """Send a signal to processes, all by default, and return when, s of the world."""
        at = self.world.time if self.emulators is not None else math.nan
        for name in names or self.processes:
            self.struck[name] = number
            self.processes[name].process.send_signal(number)
        return at

    def restart(self, name: str) -> None:
        """Start a killed node again after it has left the graph, or continue a stopped one."""
        self._restarted = True
        if self.struck.pop(name) == signal.SIGKILL:
            self.processes[name].process.wait(DEADLINE)
            here = node_table.NODES[name].stands_in_for or name, f"/{self.namespace}"
            wait_until(lambda: here not in self.client.node.get_node_names_and_namespaces(), f"the end of {name}")
            if name == "docking_node":
                self.states.clear()
            self.processes[name] = Process(*node_command(self.scene, name, self.namespace))
        else:
            self.processes[name].process.send_signal(signal.SIGCONT)

    def opened(self, since: float) -> float:
        """Return the time (s of the world) from an instant until the contactor was open, once it is."""

        def times() -> list[float]:
            found = [event for event in list(self.world.events) if event[1:3] == (CONTACTOR, False)]
            return [event.time - since for event in found if event.time >= since]

        return wait_until(times, "an open contactor", 10.0)[0]

    def assert_unharmed(self) -> None:
        """Check that nothing was shorted, parted or unpowered while it was live."""
        record = self.world.record
        assert (record.energised_shorts, record.energised_unsafe) == (0, 0.0)
        assert (record.parted_live, record.unpowered_live) == (0, 0)

    def assert_safe(self) -> None:
        """Check that the contactor is open, the torque is going off, and nothing was harmed."""
        wait_until(lambda: not self.is_closed, "an open contactor", 10.0)
        if self.emulators is None:
            wait_until(lambda: not any(self.servos.torque_enabled), "no torque", 10.0)
            return
        wait_until(lambda: not any(self.world.torque), "no torque", 10.0)
        self.assert_unharmed()

    # Its parts

    def _on_ports(self, scene: Scene, opened: contextlib.ExitStack) -> Scene:
        """Start the emulators, and return a scene whose nodes open their ports."""
        if scene.simulation is None:
            return scene
        self.emulators = RecordedCharger.build(scene, self.namespace)
        opened.callback(self.emulators.stop)
        self.emulators.start()
        ports = Ports(self.emulators.servo_port, self.emulators.board_port)
        parameters = {name: scene.node_parameters(name, {}) for name in scene.nodes}
        return replace(scene, simulation=None, ports=ports, parameters=parameters)

    def _file(self, opened: contextlib.ExitStack) -> Path:
        """Return the scene as a file."""
        file = Path(opened.enter_context(tempfile.TemporaryDirectory()), "running.yaml")
        ports = {name: path for name, path in vars(self.scene.ports).items() if path}
        content = {"nodes": list(self.scene.nodes), "parameters": dict(self.scene.parameters), "ports": ports}
        file.write_text(json.dumps(content), encoding="utf-8")
        return file

    def _kill(self) -> None:
        for each in self.processes.values():
            if each.process.poll() is None:
                each.process.send_signal(signal.SIGCONT)
                each.process.kill()
                each.process.wait(DEADLINE)
