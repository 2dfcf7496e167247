# SPDX-License-Identifier: Apache-2.0
"""Campaigns: a docking depends only on seed and number, not on the worker or on earlier dockings."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from deltacharger_bringup.cli.main import main
from deltacharger_lab.campaigns import batch, docking
from deltacharger_lab.campaigns.batch import batches, run_batch
from deltacharger_lab.campaigns.compare import compare_campaigns
from deltacharger_lab.campaigns.docking import RESULTS, columns, dock_once
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.runner import run_missing
from deltacharger_lab.campaigns.settings import CampaignError, CampaignRefused
from deltacharger_lab.campaigns.store import Store, read_results
from deltacharger_lab.campaigns.summary import summarise, wilson
from deltacharger_lab.campaigns.virtual_charger import TICK, VirtualCharger

from ..chargers import Process, wait_until
from ..marks import rest
from .campaigns import QUICK, comparable, scene, settings, stored

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra campaign)")


WORDS = (sys.executable, "-m", "deltacharger_bringup.cli", "campaign")


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any], str]:
    capsys.readouterr()
    code = main(["campaign", *words, "--json"])
    captured = capsys.readouterr()
    return code, json.loads(captured.out), captured.err


@pytest.fixture
def quick(tmp_path: Path) -> str:
    path = tmp_path / "quick.yaml"
    path.write_text(yaml.safe_dump(QUICK), encoding="utf-8")
    return str(path)


def test_a_docking_depends_only_on_seed_and_number() -> None:
    text = settings(4).to_json()
    forward = run_batch(text, [0, 1, 2, 3])
    backward = run_batch(text, [3, 2]) + run_batch(text, [1, 0])
    assert comparable(forward) == comparable(backward)
    assert len({row["seed"] for row in forward}) == 4
    other = run_batch(settings(4, seed=4).to_json(), [0])
    assert comparable(other) != comparable(forward[:1])


def test_a_row_has_every_column_and_its_type() -> None:
    row = dock_once(scene(), 3, 0, "guarded")
    known = columns(scene())
    assert set(row) == set(known)
    assert all(isinstance(row[name], kind) for name, (kind, _) in known.items()), row
    assert row["charged"]
    assert row["world.servo.stiffness"] == pytest.approx(15.0, abs=1.0)
    assert row["place_x"] == pytest.approx(row["target.x"])
    assert abs(row["goal_x"] - row["place_x"]) < 0.003


def test_workers_make_no_difference(capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: str) -> None:
    common = ("-n", "6", "--seed", "3", "--scenes", quick)
    code, alone, err = run(capsys, *common, "--out", str(tmp_path / "runs" / "one"))
    assert (code, alone["n"], alone["complete"]) == (0, 6, True)
    assert "100 %  6 of 6 dockings" in err
    code, shared, _ = run(capsys, *common, "--out", str(tmp_path / "two"), "--workers", "2", "--batch", "1")
    assert code == 0
    assert stored(tmp_path / "runs" / "one") == stored(tmp_path / "two")
    assert {**alone, "out": ""} == {**shared, "out": ""}
    contract = {"n", "charged", "refused", "shorts", "energised_unsafe", "aligned", "time", "moves"}
    assert contract | {"final_misalignment", "peak_push", "time_above_band"} <= set(alone)


def test_after_kill_9_the_same_command_completes_every_docking_once(
    start: Callable[..., Process], capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: str
) -> None:
    out = tmp_path / "killed"
    common = ("-n", "14", "--seed", "3", "--scenes", quick, "--batch", "2")
    process = start(*WORDS, *common, "--out", str(out))
    wait_until(lambda: len(list(out.glob("part-*.parquet"))) >= 2, "two parts")
    process.process.kill()
    process.end()
    before = stored(out)
    assert 4 <= len(before) < 14
    code, summary, err = run(capsys, *common, "--out", str(out), "--workers", "2")
    assert (code, summary["n"]) == (0, 14)
    assert "of 14 dockings exist already" in err
    rows = stored(out)
    assert [row["number"] for row in rows] == list(range(14))
    assert rows == comparable(run_batch(settings(14).to_json(), range(14)))


def children(parent: int) -> set[int]:
    """Return the processes that `parent` has started (Linux)."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent and fields[0] != "Z":
                found.add(int(path.parent.name))
    return found


def is_alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.rest
def test_workers_end_with_a_killed_parent(start: Callable[..., Process], tmp_path: Path, quick: str) -> None:
    out = tmp_path / "killed"
    process = start(*WORDS, "-n", "2000", "--scenes", quick, "--batch", "1", "--workers", "2", "--out", str(out))
    wait_until(lambda: list(out.glob("part-*.parquet")), "a part")
    workers = children(process.process.pid)
    assert len(workers) >= 2
    process.process.kill()
    wait_until(lambda: not any(is_alive(worker) for worker in workers), "the workers' end")


@pytest.mark.rest
def test_a_dead_worker_process_loses_and_doubles_no_row(tmp_path: Path) -> None:
    messages: list[str] = []

    def report(rows: Sequence[dict[str, Any]]) -> None:
        if not messages:
            workers = [
                each for each in children(os.getpid()) if "spawn_main" in Path(f"/proc/{each}/cmdline").read_text()
            ]
            messages.append("killed")
            os.kill(workers[0], signal.SIGKILL)

    with Store(tmp_path / "s", settings(12)) as store:
        run_missing(store, 2, "", 1, report, lambda: False, messages.append)
        assert store.missing() == []
    assert "a worker process died" in messages[1]
    assert stored(tmp_path / "s") == comparable(run_batch(settings(12).to_json(), range(12)))


@pytest.mark.parametrize("workers", ["1", rest("2")])
def test_ctrl_c_leaves_a_resumable_file_and_exits_130(
    start: Callable[..., Process], capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: str, workers: str
) -> None:
    out = tmp_path / "stopped"
    common = ("--seed", "3", "--scenes", quick, "--batch", "2", "--out", str(out))
    process = start(*WORDS, "-n", "2000", *common, "--workers", workers, "--json")
    wait_until(lambda: list(out.glob("part-*.parquet")), "a part")
    process.process.send_signal(signal.SIGINT)
    assert process.end() == 130
    answer = json.loads(process.out[-1])
    assert (answer["success"], answer["complete"]) == (False, False)
    assert 0 < answer["n"] < 2000
    code, summary, _ = run(capsys, "-n", "2000", *common, "--approach", "paper")
    assert code == 2
    assert "approach is paper, was guarded" in summary["error"]
    assert len(stored(out)) == answer["n"]


def test_different_settings_are_refused_and_named(tmp_path: Path) -> None:
    with Store(tmp_path / "s", settings(3)) as store:
        store.add(run_batch(store.settings.to_json(), [0]))
    wider = {**QUICK, "target": {"x": [-0.004, 0.002], "y": [-0.002, 0.002], "roll": [-0.05, 0.05]}}
    for other, named in (
        (settings(3, seed=4), "seed is 4, was 3"),
        (settings(3, approach="paper"), "approach is paper, was guarded"),
        (settings(2), "n is 2, was 3"),
        (settings(3, content=wider), "scene's target.x is [-0.004, 0.002], was [-0.002, 0.002]"),
    ):
        with pytest.raises(CampaignRefused) as refusal, Store(tmp_path / "s", other):
            pass
        assert named in str(refusal.value)
    with Store(tmp_path / "s", settings(5)) as store:  # more dockings of the same campaign
        assert store.missing() == [1, 2, 3, 4]


def test_one_folder_has_one_writer_and_no_row_twice(tmp_path: Path) -> None:
    with Store(tmp_path / "s", settings(3)) as store:
        rows = run_batch(store.settings.to_json(), [0, 1])
        assert store.add(rows) == 2
        assert store.add(rows) == 0
        with pytest.raises(CampaignError, match="another process"), Store(tmp_path / "s", settings(3)):
            pass
    (tmp_path / "s" / ".unfinished-9").write_bytes(b"half a file")
    with Store(tmp_path / "s", settings(3)) as store:
        assert store.done == {0, 1}
    assert not (tmp_path / "s" / ".unfinished-9").exists()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").touch()
    with pytest.raises(CampaignRefused, match="other files"), Store(tmp_path / "other", settings(3)):
        pass
    (tmp_path / "s" / "part-000000009.parquet").write_bytes(b"no parquet")
    with pytest.raises(CampaignError, match=r"part-000000009\.parquet cannot be read"):
        read_results(tmp_path / "s")


def test_results_of_an_earlier_version_are_compared_and_not_continued(tmp_path: Path) -> None:
    import pyarrow.parquet as parquet

    earlier = replace(settings(2), versions={**settings(2).versions, "deltacharger": "0.0.1"})
    for name, told in (("old", earlier), ("new", settings(2))):
        with Store(tmp_path / name, told) as store:
            store.add(run_batch(settings(2).to_json(), [0, 1]))
    (part,) = (tmp_path / "old").glob("part-*.parquet")
    parquet.write_table(parquet.read_table(part).drop_columns(["bar_heat"]), part)
    with pytest.raises(CampaignRefused, match=r"has no column bar_heat; an earlier version wrote it\. .*another --out"):
        read_results(tmp_path / "old")
    now = settings(2).versions["deltacharger"]
    with pytest.raises(CampaignRefused, match=rf"version of deltacharger is {now}, was 0\.0\.1"):
        Store(tmp_path / "old", settings(2)).__enter__()
    found = compare_campaigns(tmp_path / "old", tmp_path / "new")
    assert (found["pairs"], found["differs"]) == (2, [f"version of deltacharger: 0.0.1 → {now}"])


def test_results_of_a_renamed_key_are_refused_by_the_new_name(tmp_path: Path) -> None:
    earlier = settings(2, content={**QUICK, "docking": {"contact_speed": 0.01}})
    (tmp_path / "_campaign.json").write_text(earlier.to_json())
    with pytest.raises(CampaignError, match=r"_campaign\.json.*docking\.contact_speed.*search_speed and press_speed"):
        read_results(tmp_path)


def test_a_crash_becomes_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    real = docking.run

    def sometimes(drawn: Any, exact: bool) -> dict[str, Any]:
        if drawn.number == 1:
            raise ZeroDivisionError("no such thing")
        return real(drawn, exact)

    monkeypatch.setattr(docking, "run", sometimes)
    rows = run_batch(settings(3).to_json(), [0, 1, 2])
    assert [row["code_name"] for row in rows] == ["NONE", "CRASHED", "NONE"]
    assert "ZeroDivisionError: no such thing" in rows[1]["error"]
    assert rows[1]["target.x"] == draw(scene(), 3, 1, "guarded").values["target.x"]
    summary = summarise({name: [row[name] for row in rows] for name in RESULTS | {"number": None}})
    assert (summary["n"], summary["crashed"], summary["refused"]) == (3, 1, {})


def test_a_worker_with_other_versions_computes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    text = settings(1).to_json()
    others = {"python": "2.7", "numpy": "1", "deltacharger": "0", "code": "x"}
    monkeypatch.setattr(batch, "versions", lambda: others)
    with pytest.raises(CampaignError, match=r"python 2\.7 instead of"):
        run_batch(text, [0])


def test_batches_have_every_number_once_and_suit_the_workers() -> None:
    assert batches([], 0, 2) == []
    assert batches([4, 7, 9], 2, 1) == [[4, 7], [9]]
    shared = batches(range(100), 0, 4)
    assert [number for each in shared for number in each] == list(range(100))
    assert len(shared) >= 4 * 4
    assert max(map(len, batches(range(10**6), 0, 2))) <= 50


def test_wilson_intervals_have_their_nominal_coverage() -> None:
    import random

    draw_one = random.Random(1)
    held = 0
    for _ in range(2000):
        low, high = wilson(sum(draw_one.random() < 0.93 for _ in range(80)), 80)
        held += low <= 0.93 <= high
    assert held / 2000 == pytest.approx(0.95, abs=0.02)


def test_the_commands_refuse_wrong_arguments(capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: str) -> None:
    for words, named in (
        ((), "--out DIR is missing"),
        (("--out", str(Path(quick) / "no" / "where")), "cannot be created"),
        (("--out", str(tmp_path / "x"), "--scenes", "defualt"), "did you mean 'default'"),
        (("--out", str(tmp_path / "x"), "--scheduler", "tcp://127.0.0.1:9", "--workers", "2"), "--workers"),
        (("--out", quick, "--scenes", quick), "is a file"),
        (("compare", str(tmp_path), str(tmp_path)), "has no campaign"),
        (("compare", str(tmp_path), str(tmp_path), "--picture", "a.doc"), "must end in"),
    ):
        code, answer, _ = run(capsys, *words)
        assert (code, answer["success"]) == (2, False), words
        assert named in answer["error"]


def test_without_pyarrow_the_error_names_what_to_install(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    code, answer, _ = run(capsys, "-n", "1", "--out", str(tmp_path / "x"))
    assert code == 1
    assert "install deltacharger[campaign]" in answer["error"]
    assert not (tmp_path / "x").exists()


def test_an_unreached_condition_ends_at_the_limit() -> None:
    charger = VirtualCharger()
    with pytest.raises(TimeoutError, match="state IDLE"):
        charger.until(lambda: False, 0.05)
    with pytest.raises(TimeoutError):
        charger.finish(0.05)
    assert charger.now <= 0.1 + TICK
