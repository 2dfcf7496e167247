# SPDX-License-Identifier: Apache-2.0
"""A campaign on Dask workers: every docking once and unchanged, although a worker is killed."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from deltacharger_lab.campaigns import runner
from deltacharger_lab.campaigns.batch import run_batch
from deltacharger_lab.campaigns.runner import run_missing
from deltacharger_lab.campaigns.settings import CampaignError
from deltacharger_lab.campaigns.store import Store

from .campaigns import comparable, settings, stored

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra campaign)")
distributed = pytest.importorskip("distributed", reason="Dask is not installed (extra dask)")


def cluster(**more: Any) -> Any:
    return distributed.LocalCluster(dashboard_address=":0", silence_logs=50, **more)


@pytest.mark.night
def test_a_killed_worker_loses_and_doubles_no_row(tmp_path: Path) -> None:
    numbers: list[int] = []
    with (
        cluster(n_workers=2, threads_per_worker=1, processes=True) as running,
        Store(tmp_path, settings(16)) as store,
    ):
        victim = next(iter(running.workers.values())).pid

        def report(rows: Sequence[dict[str, Any]]) -> None:
            if not numbers:
                os.kill(victim, signal.SIGKILL)
            numbers.extend(row["number"] for row in rows)

        run_missing(store, 1, running.scheduler_address, 2, report, lambda: False, print)
        assert store.missing() == []
    assert sorted(numbers) == list(range(16))
    assert stored(tmp_path) == comparable(run_batch(settings(16).to_json(), range(16)))


@pytest.mark.rest
def test_a_stopped_campaign_keeps_written_rows_and_continues(tmp_path: Path) -> None:
    written: list[int] = []

    def report(rows: Sequence[dict[str, Any]]) -> None:
        written.append(len(rows))

    with (
        cluster(n_workers=1, threads_per_worker=2, processes=False) as running,
        Store(tmp_path, settings(12)) as store,
    ):
        run_missing(store, 1, running.scheduler_address, 1, report, lambda: bool(written), print)
        assert 0 < len(store.done) < 12
        run_missing(store, 1, running.scheduler_address, 1, report, lambda: False, print)
        assert store.missing() == []
    assert sum(written) == 12
    assert stored(tmp_path) == comparable(run_batch(settings(12).to_json(), range(12)))


def test_a_missing_scheduler_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_CONNECT", 0.1)
    with Store(tmp_path, settings(1)) as store, pytest.raises(CampaignError, match="no Dask scheduler"):
        run_missing(store, 1, "tcp://127.0.0.1:9", 0, lambda rows: None, lambda: False, print)
