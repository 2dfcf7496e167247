# SPDX-License-Identifier: Apache-2.0
"""Measures one scene, started in one way, once."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.context import Context

from deltacharger_lab.reports.footprint import process
from deltacharger_lab.reports.footprint.client import TOPICS, Watcher
from deltacharger_lab.reports.footprint.plan import FootprintPlan, electrodes
from deltacharger_lab.reports.footprint.start import COMMAND, ONE, CannotRun, Started, charger, hardware
from deltacharger_ros.client import ChargerClient
from deltacharger_scenes.scene import Scene

_READY_WITHIN = 60.0  # s
_POLL = 0.02  # s
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
            libraries = process.mapped(started.pids)
        found["libraries"] = sorted(libraries | started.libraries)
        found["modules"] = len(started.modules)
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
) -> tuple[Any, process.Usage, dict[str, float]]:
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


def _use(started: Started) -> process.Usage:
    import psutil

    started.check()
    try:
        return process.usage(started.pids)
    except psutil.NoSuchProcess as error:
        started.check()
        raise CannotRun(f"a process ended while it was measured ({error})") from error
