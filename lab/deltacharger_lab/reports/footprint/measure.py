# SPDX-License-Identifier: Apache-2.0
"""Measures one scene, started in one way, once."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deltacharger.msg import ServoState, TactileFrame
from rclpy.context import Context
from rclpy.qos import QoSProfile, qos_profile_sensor_data

from deltacharger_bringup.scenes.node_table import NODES
from deltacharger_bringup.scenes.scene import Scene, SceneError, SceneGoal, load_scene, packaged_scenes
from deltacharger_core.ros import messages, outcomes
from deltacharger_core.ros.client import ChargerClient, ClientError

if TYPE_CHECKING:
    import psutil


@dataclass(frozen=True)
class Usage:
    """Total resources of some processes.

    Attributes:
        processes: their number.
        threads: of all.
        cpu: s of processor time so far, ended children included.
        pss: bytes; shared memory divided among its processes.
        rss: bytes; shared memory counted in each process.
    """

    processes: int
    threads: int
    cpu: float
    pss: int
    rss: int


def unsupported() -> str:
    """Return why nothing can be measured on this computer; '' if it can."""
    return "" if sys.platform == "linux" else "only Linux reports what a process uses; measure there"


def family(roots: Iterable[int]) -> list[psutil.Process]:
    """Return the processes `roots` and all running processes that they started.

    Raises:
        psutil.NoSuchProcess: one of `roots` has ended.
    """
    import psutil

    found: dict[int, psutil.Process] = {}
    for root in map(psutil.Process, roots):
        found |= {process.pid: process for process in (root, *root.children(recursive=True))}
    return list(found.values())


def usage(roots: Iterable[int]) -> Usage:
    """Return the resources of the processes `roots` and of those that they started.

    Raises:
        psutil.NoSuchProcess: one of `roots` has ended.
    """
    import psutil

    roots = list(roots)
    each = []
    for process in family(roots):
        try:
            with process.oneshot():
                if process.status() == psutil.STATUS_ZOMBIE:
                    raise psutil.ZombieProcess(process.pid)
                cpu, memory = sum(process.cpu_times()[:4]), process.memory_full_info()
                each.append((process.num_threads(), cpu, memory.pss, memory.rss))
        except psutil.NoSuchProcess:
            if process.pid in roots:
                raise  # for another process, its parent has the processor time
    threads, cpu, pss, rss = (sum(values) for values in zip(*each, strict=True))
    return Usage(len(each), threads, cpu, pss, rss)


ONE, SEPARATE = "one process", "separate processes"
WAYS = (ONE, SEPARATE)
_PORTS_WITHIN = 30.0  # s until emulated hardware has its ports
_END_WITHIN = 15.0  # s that a process may take to reach a safe state
_HARDWARE = "simulated hardware"
COMMAND = "deltacharger up"

_CLI = "import sys; from deltacharger_bringup.cli.main import main; sys.exit(main())"
_NODE = "import sys; from {module} import main; sys.exit(main())"


class CannotRun(Exception):
    """A scene does not run here; the message states why."""


@dataclass
class Started:
    """A scene's processes.

    Attributes:
        began: start of the first, s, monotonic.
        processes: by name, in the order of starting.
        folder: with their output.
    """

    folder: Path
    began: float = 0.0
    processes: dict[str, subprocess.Popen[bytes]] = field(default_factory=dict)

    @property
    def pids(self) -> list[int]:
        """The process ids."""
        return [process.pid for process in self.processes.values()]

    def start(self, name: str, code: str, *words: str) -> None:
        """Start a process that runs `code` with a command line."""
        with (self.folder / f"{name}.log").open("wb") as log:
            command = [sys.executable, "-c", code, *words]
            self.processes[name] = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def check(self) -> None:
        """Raise CannotRun if a process has ended."""
        for name, process in self.processes.items():
            if process.poll() is not None:
                raise CannotRun(f"{name} ended with {process.returncode}: {self.last_line(name)}")

    def last_line(self, name: str) -> str:
        """Return the last line that a process wrote, with paths relative to its folder: pages quote it."""
        last = next((line for line in reversed(self.lines(name)) if line), "it printed nothing")
        return last.replace(f"{self.folder}/", "")

    def is_ready(self, name: str) -> bool:
        """Return whether a process has printed that it is ready."""
        return "ready" in self.lines(name)

    def end(self) -> None:
        """End all, commanding processes first."""
        for process in reversed(self.processes.values()):
            if process.poll() is None:
                process.terminate()
                try:
                    process.wait(_END_WITHIN)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()

    def lines(self, name: str) -> list[str]:
        """Return the lines that a process wrote."""
        text = (self.folder / f"{name}.log").read_text("utf-8", "replace")
        return [line.strip() for line in text.split("\n")]


@contextlib.contextmanager
def hardware(scene: Scene, folder: Path) -> Iterator[dict[str, str]]:
    """Serve emulated hardware for a scene on separate ports, and return them; the scene's figures exclude it.

    Raises:
        CannotRun: it does not start.
    """
    with _processes(folder) as started:
        yield _simulate(started, "simulated", folder)


@contextlib.contextmanager
def _processes(folder: Path) -> Iterator[Started]:
    """Yield processes that log into a folder, created here; they end with the context."""
    folder.mkdir()
    started = Started(folder, began=time.monotonic())
    try:
        yield started
    finally:
        started.end()


def _simulate(started: Started, scene: str, folder: Path) -> dict[str, str]:
    """Start `deltacharger simulate`, wait for its ports, and return them as it prints them."""
    started.start(_HARDWARE, _CLI, "simulate", "--scene", scene, "--directory", str(folder))
    deadline = time.monotonic() + _PORTS_WITHIN
    while not started.is_ready(_HARDWARE):
        started.check()
        if time.monotonic() > deadline:
            raise CannotRun(f"no emulated ports within {_PORTS_WITHIN:.0f} s")
        time.sleep(0.01)
    printed = dict(line.split(" ", 1) for line in started.lines(_HARDWARE) if " " in line)
    return {name: printed[name] for name in ("servo", "board")}


@contextlib.contextmanager
def charger(scene: Scene, way: str, ports: dict[str, str], folder: Path) -> Iterator[Started]:
    """Start a scene.

    Args:
        scene: to start.
        way: `ONE`, by `deltacharger up`, or `SEPARATE`, each node and the simulated hardware, as launch does.
        ports: emulated ones of a scene on hardware; empty for another.
        folder: for logs, created here.

    Raises:
        CannotRun: it does not start.
    """
    with _processes(folder) as started:
        if way == ONE:
            used = sorted({NODES[name].port for name in scene.nodes} & set(ports))
            words = [word for name in used for word in (f"--{name}-port", ports[name])]
            started.start(COMMAND, _CLI, "up", "--scene", scene.file, *words)
        else:
            _start_nodes(started, scene, ports)
        yield started


def _start_nodes(started: Started, scene: Scene, ports: dict[str, str]) -> None:
    if scene.simulation is not None:
        ports = _simulate(started, scene.file, started.folder)
    for name in scene.start_order():
        file = started.folder / f"{name}.yaml"
        file.write_text(json.dumps({"/**": {"ros__parameters": scene.node_parameters(name, ports)}}), "utf-8")
        words = ("--ros-args", "--params-file", str(file)) if scene.node_parameters(name, ports) else ()
        started.start(name, _NODE.format(module=NODES[name].module), *words)


@dataclass(frozen=True)
class FootprintPlan:
    """One report.

    Attributes:
        scenes: to measure, by name.
        left_out: reason for each scene that is not measured.
        ways: of starting.
        repeats: of each scene and way.
        settle_s: after the start, before anything is measured.
        rest_s: duration of the measurement at rest.
        docking_limit_s: after which a docking counts as failed.
        quick: whether it is the short plan.
    """

    scenes: dict[str, Scene]
    left_out: dict[str, str] = field(default_factory=dict)
    ways: tuple[str, ...] = WAYS
    repeats: int = 3
    settle_s: float = 3.0
    rest_s: float = 15.0
    docking_limit_s: float = 120.0
    quick: bool = False


def make_plan(names: Sequence[str] = (), quick: bool = False, repeats: int | None = None) -> FootprintPlan:
    """Return the plan.

    Args:
        names: of packaged scenes, or YAML files; none takes all packaged ones.
        quick: once and shorter.
        repeats: of each scene and way; None = as planned.

    Raises:
        SceneError: a requested scene does not exist or is refused.
    """
    scenes, left_out = {}, {}
    for name in names or packaged_scenes():
        try:
            scene = load_scene(name)
        except SceneError as error:
            if names:
                raise
            left_out[name] = str(error)
            continue
        reason = missing(scene)
        if reason:
            left_out[scene.name] = reason
        else:
            scenes[scene.name] = scene
    if quick:
        return FootprintPlan(scenes, left_out, repeats=repeats or 1, settle_s=1.0, rest_s=3.0, quick=True)
    return FootprintPlan(scenes, left_out, repeats=repeats or 3)


def missing(scene: Scene) -> str:
    """Return what a scene needs beyond emulators; '' for nothing."""
    if "camera_node" in scene.nodes:
        return "camera_node needs an OAK-D camera"
    return ""


def electrodes(scene: Scene) -> outcomes.Pose | None:
    """Return the pose of the electrodes in a scene's goal; None if its camera finds them.

    A scene on hardware gets the emulated target of the scene `simulated`, at the pose of its goal.
    """
    goal: SceneGoal | None = load_scene("simulated").goal if scene.touches_hardware else scene.goal
    return None if goal is None else outcomes.Pose(goal.x, goal.y, goal.z, goal.roll)


TOPICS = ("tactile_frame", "servo_state")
_POLL = 0.02  # s
_GONE_WITHIN = 30.0  # s until the previous charger has left the graph


class Watcher:
    """A client that runs before the charger starts, and counts its messages.

    Args:
        client: its node listens until it is closed.
    """

    def __init__(self, client: ChargerClient) -> None:
        self._client = client
        self._stamps: dict[str, list[float]] = {name: [] for name in TOPICS}
        kinds = ((TactileFrame, qos_profile_sensor_data), (ServoState, QoSProfile(depth=10)))
        for (name, stamps), (kind, qos) in zip(self._stamps.items(), kinds, strict=True):
            client.node.create_subscription(kind, name, partial(_keep, stamps), qos)

    def is_ready(self, scene: Scene) -> bool:
        """Return whether goals would be accepted now; for a scene without goals, whether all its nodes are there."""
        if "docking_node" in scene.nodes:
            return self._client.is_ready()
        there = {name for name, _ in self._client.node.get_node_names_and_namespaces()}
        return all({name, NODES[name].stands_in_for} & there for name in scene.nodes)

    def count(self) -> Callable[[], dict[str, float]]:
        """Start to count messages; the returned call gives their number per second of their stamps, NaN for too few."""
        begin = {name: len(each) for name, each in self._stamps.items()}
        return lambda: {name: _rate(self._stamps[name][begin[name] :]) for name in TOPICS}

    def is_gone(self) -> bool:
        """Return whether no node serves or publishes a charger's names."""
        node = self._client.node
        return not self._client.answers() and not any(node.count_publishers(name) for name in TOPICS)

    def wait_until_gone(self) -> bool:
        """Wait until the charger has left the graph; False if it does not."""
        deadline = time.monotonic() + _GONE_WITHIN
        while not self.is_gone():
            if time.monotonic() > deadline:
                return False
            time.sleep(_POLL)
        return True

    def dock(self, electrodes: outcomes.Pose | None, deadline: float) -> str:
        """Dock and return why it failed; '' if the robot charges."""
        try:
            outcome = self._client.dock(outcomes.DockRequest(electrodes), deadline=deadline)
        except ClientError as error:
            return str(error)
        return "" if outcome.success else f"{outcome.error_name}: {outcome.error_message}"


def _keep(stamps: list[float], message: Any) -> None:
    stamps.append(messages.seconds(message.header.stamp))


def _rate(stamps: list[float]) -> float:
    long = len(stamps) > 2 and stamps[-1] > stamps[0]
    return (len(stamps) - 1) / (stamps[-1] - stamps[0]) if long else math.nan


_READY_WITHIN = 60.0  # s
_MEGA = 1e6  # bytes


def measure(scene: Scene, way: str, plan: FootprintPlan, context: Context, folder: Path) -> dict[str, Any]:
    """Return the resources that a scene uses.

    Args:
        scene: to start.
        way: of starting.
        plan: durations.
        context: a running rclpy context.
        folder: empty, for ports and logs.

    Raises:
        CannotRun: it does not start, or one of its processes ends.
    """
    with contextlib.ExitStack() as stack:
        ports = stack.enter_context(hardware(scene, folder / "hardware")) if scene.touches_hardware else {}
        watcher = Watcher(stack.enter_context(ChargerClient(context=context)))
        if not watcher.wait_until_gone():
            raise CannotRun("a charger already answers in this ROS domain; stop it, or set another ROS_DOMAIN_ID")
        with charger(scene, way, ports, folder / "charger") as started:
            found: dict[str, Any] = _wait_until_ready(watcher, scene, started, way)
            time.sleep(plan.settle_s)
            _, at_rest, rest = _measured_during("rest", watcher, started, partial(time.sleep, plan.rest_s))
            del rest["rest_s"]  # the plan's
            found |= {"processes": at_rest.processes, "threads": at_rest.threads, **rest}
            found |= _docking(watcher, scene, started, plan)
            after = _use(started)
            found["pss_mb"], found["rss_mb"] = after.pss / _MEGA, after.rss / _MEGA
        return found


def _wait_until_ready(watcher: Watcher, scene: Scene, started: Started, way: str) -> dict[str, float]:
    """Return the start's duration (s): to its ready message, if any, and until a client in this process finds it."""
    seen: dict[str, float] = {} if way == ONE else {"reports_ready_s": math.nan}
    while len(seen) < 2:
        started.check()
        elapsed = time.monotonic() - started.began
        if watcher.is_ready(scene):
            seen.setdefault("ready_s", elapsed)
        if way == ONE and started.is_ready(COMMAND):
            seen.setdefault("reports_ready_s", elapsed)
        if elapsed > _READY_WITHIN:
            name = list(started.processes)[-1]
            raise CannotRun(f"not ready within {_READY_WITHIN:.0f} s; {name} printed: {started.last_line(name)}")
        time.sleep(_POLL)
    return seen


def _measured_during(
    when: str, watcher: Watcher, started: Started, act: Callable[[], Any]
) -> tuple[Any, Usage, dict[str, float]]:
    """Return a call's result, the usage after it, and the time, CPU and message rates while it runs."""
    before, begin, counting = _use(started), time.monotonic(), watcher.count()
    result = act()
    after, elapsed = _use(started), time.monotonic() - begin
    found = {f"{when}_percent": 100.0 * (after.cpu - before.cpu) / elapsed, f"{when}_s": elapsed}
    return result, after, found | {f"{when}_{name}_hz": value for name, value in counting().items()}


def _docking(watcher: Watcher, scene: Scene, started: Started, plan: FootprintPlan) -> dict[str, Any]:
    """Return the cost of a docking, NaN if none succeeds, and its problem."""
    keys = ("docking_percent", "docking_s", *(f"docking_{name}_hz" for name in TOPICS))
    found, problem = dict.fromkeys(keys, math.nan), ""
    if "docking_node" in scene.nodes:
        dock = partial(watcher.dock, electrodes(scene), plan.docking_limit_s)
        problem, _, measured = _measured_during("docking", watcher, started, dock)
        found = found if problem else measured
    return {**found, "docking_problem": problem}


def _use(started: Started) -> Usage:
    import psutil

    started.check()
    try:
        return usage(started.pids)
    except psutil.NoSuchProcess as error:
        started.check()
        raise CannotRun(f"a process ended while it was measured ({error})") from error
