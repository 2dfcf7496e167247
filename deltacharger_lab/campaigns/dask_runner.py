# SPDX-License-Identifier: Apache-2.0
"""A campaign on the workers of a Dask scheduler; only this process writes."""

from __future__ import annotations

from deltacharger_lab.campaigns.batch import Record, Stop, batches, hand_out, run_batch
from deltacharger_lab.campaigns.settings import CampaignError
from deltacharger_lab.campaigns.store import Store

_CONNECT = 15.0  # s
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
        executor = client.get_executor(pure=False, retries=_LOST)
        text, left = store.settings.to_json(), batches(store.missing(), batch, threads)
        try:
            hand_out(lambda numbers: executor.submit(run_batch, text, numbers), left, threads, record, stop)
        except distributed.KilledWorker as error:
            raise CampaignError(f"workers died again and again: {error}; the same command goes on") from error
        except ModuleNotFoundError as error:
            raise CampaignError(
                f"a worker lacks {error.name}; install deltacharger there, in the same version"
            ) from error
