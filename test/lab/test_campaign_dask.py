# SPDX-License-Identifier: Apache-2.0
"""A campaign on Dask workers: every docking once and unchanged, although a worker is killed."""

from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from deltacharger_lab.campaigns.batch import run_batch
from deltacharger_lab.campaigns.runner import run_missing
from deltacharger_lab.campaigns.settings import CampaignError
from deltacharger_lab.campaigns.store import Store

from .campaigns import comparable, settings, stored

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra campaign)")
distributed = pytest.importorskip("distributed", reason="Dask is not installed (extra dask)")


@pytest.mark.rest
def test_a_killed_worker_loses_and_doubles_no_row(tmp_path: Path) -> None:
    numbers: list[int] = []
    killed = threading.Event()
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    ) as cluster:
        victims = [worker.pid for worker in cluster.workers.values()]

        def report(rows: list[dict[str, object]]) -> None:
            numbers.extend(int(str(row["number"])) for row in rows)
            if not killed.is_set():
                killed.set()
                os.kill(victims[0], signal.SIGKILL)

        with Store(tmp_path / "d", settings(16)) as store:
            run_missing(store, 1, cluster.scheduler_address, 2, report, lambda: False, print)
            assert store.missing() == []
    assert sorted(numbers) == list(range(16))
    assert stored(tmp_path / "d") == comparable(run_batch(settings(16).to_json(), range(16)))


def test_a_stopped_campaign_keeps_written_rows_and_continues(tmp_path: Path) -> None:
    written: list[int] = []
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=2, processes=False, dashboard_address=":0", silence_logs=50
        ) as cluster,
        Store(tmp_path / "d", settings(12)) as store,
    ):

        def report(rows: list[dict[str, object]]) -> None:
            written.append(len(rows))

        run_missing(store, 1, cluster.scheduler_address, 1, report, lambda: bool(written), print)
        assert 0 < len(store.done) < 12
        run_missing(store, 1, cluster.scheduler_address, 1, report, lambda: False, print)
        assert store.missing() == []
    assert sum(written) == 12
    assert stored(tmp_path / "d") == comparable(run_batch(settings(12).to_json(), range(12)))


def test_a_missing_scheduler_or_one_without_workers_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from deltacharger_lab.campaigns import runner

    monkeypatch.setattr(runner, "_CONNECT", 0.5)
    with Store(tmp_path / "d", settings(1)) as store:
        with pytest.raises(CampaignError, match="no Dask scheduler answers"):
            run_missing(store, 1, "tcp://127.0.0.1:9", 0, lambda rows: None, lambda: False, print)
        with (
            distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as cluster,
            pytest.raises(CampaignError, match="has no workers"),
        ):
            run_missing(store, 1, cluster.scheduler_address, 0, lambda rows: None, lambda: False, print)
