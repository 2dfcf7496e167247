# SPDX-License-Identifier: Apache-2.0
"""Runs the missing dockings of a campaign: in this process, or in local ones."""

from __future__ import annotations

import contextlib
import itertools
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.store import CampaignError, Store, scene_of

BATCH_MOST = 50  # dockings of a batch, some seconds of work; kill -9 loses at most this of each worker
_AHEAD = 2  # batches per worker submitted ahead
_POLL = 0.2  # s until an interruption is seen
_BATCHES = 8  # per worker at least, so that no worker waits long for the last one
_halt: Any = None  # event of the process that started this worker

Row = dict[str, Any]
Record = Callable[[list[Row]], None]
Stop = Callable[[], bool]


def batches(numbers: Sequence[int], size: int, workers: int) -> list[list[int]]:
    """Return the numbers in batches of `size`; 0: such that every worker gets several."""
    suited = math.ceil(len(numbers) / (_BATCHES * workers)) if numbers else 1
    most = size or max(1, min(BATCH_MOST, suited))
    return [list(numbers[start : start + most]) for start in range(0, len(numbers), most)]


def run_batch(text: str, numbers: Sequence[int], stop: Callable[[], bool] | None = None) -> list[Row]:
    """Run the dockings of these numbers and return their rows; fewer if stopped.

    Args:
        text: settings of the campaign from `CampaignSettings.to_json`.
        numbers: of the dockings.
        stop: called before each docking; None = the event of the starting process.
    """
    settings, scene = scene_of(text)
    halted = stop or (lambda: _halt is not None and _halt.is_set())
    rows = []
    for number in numbers:
        if halted():
            break
        rows.append(dock_once(scene, settings.seed, number, settings.exact))
    return rows


def begin_worker(halt: Any) -> None:
    """Prepare a worker process: ignore Ctrl-C, which its parent handles, and end with the parent.

    Args:
        halt: event after which no docking starts.
    """
    global _halt
    _halt = halt
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


_TRIES = 3  # restarts with the remaining dockings after worker processes died

Report = Callable[[Sequence[Row]], None]


def run_missing(
    store: Store, workers: int, report: Report, stop: Stop, log: Callable[[str], None], batch: int = 0
) -> None:
    """Run and write the dockings that the store lacks, until all are there or `stop` returns true.

    Args:
        store: open.
        workers: local processes; 1 = this process.
        report: called with the rows of every written batch.
        stop: whether to end.
        log: called with messages about workers.
        batch: dockings per write, 0 = automatic.

    Raises:
        CampaignError: workers died repeatedly.
    """

    def record(rows: list[Row]) -> None:
        if rows:
            store.add(rows)
            report(rows)

    if workers == 1:
        _run_here(store, batch, record, stop)
    else:
        _run_with_restarts(store, workers, batch, record, stop, log)


def _run_here(store: Store, batch: int, record: Record, stop: Stop) -> None:
    text = store.settings.to_json()
    for numbers in batches(store.missing(), batch, 1):
        record(run_batch(text, numbers, stop))
        if stop():
            return


def _run_with_restarts(
    store: Store, workers: int, batch: int, record: Record, stop: Stop, log: Callable[[str], None]
) -> None:
    """Run in local processes; if one dies, all restart with the dockings that are not written."""
    for _ in range(_TRIES):
        try:
            _run_local(store, workers, batch, record, stop)
            return
        except BrokenProcessPool:
            if stop():
                return
            log("a worker process died; its unwritten dockings start again")
    raise CampaignError(f"worker processes died {_TRIES} times; check the free memory. The same command continues")


def _run_local(store: Store, workers: int, batch: int, record: Record, stop: Stop) -> None:
    text = store.settings.to_json()
    rest, running = iter(batches(store.missing(), batch, workers)), set[Future[list[Row]]]()
    context = multiprocessing.get_context("spawn")
    halt = context.Event()
    with _one_thread_each(), ProcessPoolExecutor(workers, context, begin_worker, (halt,)) as pool:
        try:
            while True:
                for numbers in itertools.islice(rest, 0 if stop() else _AHEAD * workers - len(running)):
                    with _without_ctrl_c():
                        running.add(pool.submit(run_batch, text, numbers))
                if not running:
                    return
                if stop():
                    halt.set()
                    running -= {future for future in running if future.cancel()}
                done, running = wait(running, _POLL, FIRST_COMPLETED)
                for future in done:
                    record(future.result())
        except BaseException:
            halt.set()
            pool.shutdown(cancel_futures=True)
            raise


@contextlib.contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Make processes started in this context ignore Ctrl-C, which a terminal sends to all; this one gets it later."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Make processes that start in this context use one thread for linear algebra, unless the user chose otherwise."""
    names: list[str] = [name for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS") if name not in os.environ]
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name in names:
            os.environ.pop(name, None)
