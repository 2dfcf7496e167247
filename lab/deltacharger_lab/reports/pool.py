# SPDX-License-Identifier: Apache-2.0
"""Work in two processes, with a report of the time left; an interruption ends it at once."""

import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

PROCESSES = 2
_REPORT_PERIOD = 5.0  # s, at most


@dataclass(frozen=True)
class ReportTask:
    """A module function and its arguments; it must be importable by name.

    Attributes:
        name: of the result.
        run: the function.
        arguments: of the call.
        weight: approximate duration relative to the others.
    """

    name: str
    run: Callable[..., Any]
    arguments: tuple[Any, ...]
    weight: float = 1.0


class ReportFailed(RuntimeError):
    """A part of a report could not be measured; the message has the trace of the process that tried."""


def work(tasks: Sequence[ReportTask], progress: Callable[[str], None]) -> dict[str, list[Any]]:
    """Run all tasks and return their results by name, in the order of the tasks.

    Raises:
        KeyboardInterrupt: interrupted; all processes have ended.
        ModuleNotFoundError: a task needs a library that is not installed.
        ReportFailed: a task raised something else.
    """
    order = sorted(range(len(tasks)), key=lambda index: -tasks[index].weight)
    found: dict[int, Any] = {}
    total, done, started, reported = sum(task.weight for task in tasks), 0.0, time.monotonic(), 0.0
    with _quiet_pool(min(PROCESSES, len(tasks))) as pool:
        for index, result in pool.imap_unordered(_run, [(index, tasks[index]) for index in order]):
            found[index] = result
            done += tasks[index].weight
            now = time.monotonic()
            if now - reported >= _REPORT_PERIOD or len(found) == len(tasks):
                reported = now
                left = (now - started) * (total - done) / done
                progress(f"{100.0 * done / total:3.0f} %  {tasks[index].name}, about {left:.0f} s left")
    results: dict[str, list[Any]] = {}
    for index, task in enumerate(tasks):
        results.setdefault(task.name, []).append(found[index])
    return results


def _quiet_pool(processes: int) -> Any:
    """Return a pool whose processes ignore interruptions, which this one handles, and use one thread each."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"  # inherited; libraries read it at import
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        return multiprocessing.get_context("spawn").Pool(processes)
    finally:
        signal.signal(signal.SIGINT, before)


def _run(numbered: tuple[int, ReportTask]) -> tuple[int, Any]:
    index, task = numbered
    try:
        return index, task.run(*task.arguments)
    except ModuleNotFoundError:
        raise  # the command prints how to install it
    except Exception:  # many cannot be sent to another process, which would wait forever
        raise ReportFailed(f"{task.name}{task.arguments!r:.200}: {traceback.format_exc()}") from None


def joined(parts: Iterable[Sequence[Any]]) -> list[Any]:
    """Return the items of all parts in one list."""
    return [each for part in parts for each in part]
