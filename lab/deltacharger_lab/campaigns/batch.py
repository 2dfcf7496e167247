# SPDX-License-Identifier: Apache-2.0
"""The work of one worker: some dockings of a campaign, in sequence. Importing it starts nothing."""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

from deltacharger_lab.campaigns.docking import dock_once
from deltacharger_lab.campaigns.settings import CampaignError, scene_of, versions

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

    Raises:
        CampaignError: this worker's versions are not those of the campaign.
    """
    settings, scene = scene_of(text)
    ours = versions()
    differing = [
        f"{name} {ours.get(name)} instead of {value}"
        for name, value in settings.versions.items()
        if ours.get(name) != value
    ]
    if differing:
        raise CampaignError(f"a worker has other versions: {', '.join(differing)}; install the same versions there")
    halted = stop or (lambda: _halt is not None and _halt.is_set())
    rows = []
    for number in numbers:
        if halted():
            break
        rows.append(dock_once(scene, settings.seed, number, settings.exact))
    return rows


def hand_out(
    submit: Callable[[list[int]], Future[list[Row]]],
    left: list[list[int]],
    workers: int,
    record: Record,
    stop: Stop,
    halt: Callable[[], None] = lambda: None,
) -> None:
    """Run batches in workers, each with some submitted ahead, until all are done or `stop` returns true.

    Args:
        submit: submits a batch.
        left: remaining batches.
        workers: their number.
        record: called with the rows of each batch.
        stop: whether to end.
        halt: called then, to stop the workers.
    """
    rest, running = iter(left), set[Future[list[Row]]]()
    while True:
        for numbers in itertools.islice(rest, 0 if stop() else _AHEAD * workers - len(running)):
            running.add(submit(numbers))
        if not running:
            return
        if stop():
            halt()
            running -= {future for future in running if future.cancel()}
        done, running = wait(running, _POLL, FIRST_COMPLETED)
        for future in done:
            record(future.result())


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
