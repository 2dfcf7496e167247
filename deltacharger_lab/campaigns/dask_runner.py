# SPDX-License-Identifier: Apache-2.0
"""A campaign on the workers of a Dask scheduler; only this process writes."""

from __future__ import annotations

import itertools
import uuid
from typing import Any

from deltacharger_lab.campaigns.batch import Record, Row, Stop, batches, run_batch
from deltacharger_lab.campaigns.settings import CampaignError
from deltacharger_lab.campaigns.store import Store

_CONNECT = 15.0  # s
_POLL = 0.3  # s until an interruption is seen
_AHEAD = 2  # batches per thread of a worker that are handed out
_LOST = 5  # workers that a batch may lose before it is given up


def run_on_dask(store: Store, address: str, batch: int, record: Record, stop: Stop) -> None:
    """Run the dockings that the store lacks on the workers of a scheduler.

    A batch whose worker dies is run by another one; its rows come once, and are the same.

    Args:
        store: open.
        address: of the scheduler, e.g. tcp://host:8786.
        batch: dockings written at once, 0 = as suits.
        record: told the rows of each batch.
        stop: whether to end.

    Raises:
        CampaignError: Dask is missing, nobody answers there, no worker is there, or one has other versions.
    """
    try:
        import distributed
    except ModuleNotFoundError as error:
        raise CampaignError("Dask is not installed; install deltacharger[dask]") from error
    try:
        client = distributed.Client(address, timeout=_CONNECT, set_as_default=False)
    except (OSError, ValueError, distributed.TimeoutError) as error:
        raise CampaignError(f"no Dask scheduler answers at {address}: {error}") from error
    with client, client.as_current():
        threads = sum(client.nthreads().values())
        if not threads:
            raise CampaignError(f"the scheduler at {address} has no workers; start `dask worker {address}` somewhere")
        _hand_out(distributed, client, store, batches(store.missing(), batch, threads), threads, record, stop)


def _hand_out(
    distributed: Any,
    client: Any,
    store: Store,
    left: list[list[int]],
    threads: int,
    record: Record,
    stop: Stop,
) -> None:
    text, run = store.settings.to_json(), uuid.uuid4().hex
    rest, running = iter(left), set[Any]()
    while True:
        for numbers in itertools.islice(rest, 0 if stop() else _AHEAD * threads - len(running)):
            key = f"docking-{run}-{numbers[0]}"
            running.add(client.submit(run_batch, text, numbers, key=key, pure=False, retries=_LOST))
        if not running:
            return
        if stop():
            client.cancel(list(running))
            return
        try:
            found = distributed.wait(running, timeout=_POLL, return_when="FIRST_COMPLETED")
        except distributed.TimeoutError:
            continue
        running = set(found.not_done)
        for future in found.done:
            record(_rows(distributed, future))


def _rows(distributed: Any, future: Any) -> list[Row]:
    try:
        rows: list[Row] = future.result()
    except distributed.KilledWorker as error:
        raise CampaignError(f"workers died again and again: {error}; the same command goes on") from error
    except ModuleNotFoundError as error:
        raise CampaignError(f"a worker lacks {error.name}; install deltacharger there, in the same version") from error
    return rows
