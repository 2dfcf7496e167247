# SPDX-License-Identifier: Apache-2.0
"""Campaigns: a docking depends only on seed and number, not on the worker or earlier dockings; comparisons."""

import contextlib
import json
import math
import signal
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from deltacharger_bringup.cli.main import main
from deltacharger_lab.campaigns import compare, docking, runner
from deltacharger_lab.campaigns.draw import draw
from deltacharger_lab.campaigns.store import CampaignError, CampaignRefused, Store, read_results
from deltacharger_lab.campaigns.summary import summarise, wilson
from test.chargers import Process, wait_until
from test.marks import night, rest

from .campaigns import QUICK, comparable, scene, settings, stored

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


def expected(count: int) -> list[dict[str, Any]]:
    return comparable(runner.run_batch(settings(count).to_json(), range(count)))


def test_a_docking_depends_only_on_seed_and_number() -> None:
    text = settings(2).to_json()
    forward = runner.run_batch(text, [0, 1])
    assert comparable(forward) == comparable(runner.run_batch(text, [1]) + runner.run_batch(text, [0]))
    assert forward[0]["seed"] != forward[1]["seed"]
    assert comparable(runner.run_batch(settings(2, seed=4).to_json(), [0])) != comparable(forward[:1])


@pytest.mark.parametrize(("workers", "count"), [(1, 2), rest(2, 6)])
def test_a_stopped_campaign_continues_with_what_is_missing(tmp_path: Path, workers: int, count: int) -> None:
    written: list[int] = []

    def report(rows: Sequence[dict[str, Any]]) -> None:
        written.extend(row["number"] for row in rows)

    for goes_on in (False, True):
        with Store(tmp_path, settings(count)) as store:
            stop = lambda goes_on=goes_on: not goes_on and bool(written)  # noqa: E731
            runner.run_missing(store, workers, report, stop, print, 1)
            assert goes_on == (store.missing() == [])
    assert sorted(written) == list(range(count))
    assert stored(tmp_path) == expected(count)


@pytest.mark.rest
def test_the_command_reports_progress_and_figures(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, quick: str
) -> None:
    words = ("-n", "2", "--seed", "3", "--scenes", quick, "--out", str(tmp_path / "runs" / "one"))
    code, figures, err = run(capsys, *words)
    assert (code, figures["n"], figures["complete"], "100 %" in err) == (0, 2, True, True)
    assert {"charged", "refused", "shorts", "energised_unsafe", "aligned", "time", "moves", "peak_push"} <= set(figures)
    code, answer, _ = run(capsys, *words, "--exact")
    assert (code, "exact" in answer["error"]) == (2, True)


def children(parent: int, program: str = "") -> set[int]:
    """Return the living processes that `parent` has started (Linux)."""
    found = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent and fields[0] != "Z" and program in path.with_name("cmdline").read_text():
                found.add(int(path.parent.name))
    return found


@pytest.mark.night
@pytest.mark.parametrize("workers", ["1", "2"])
@pytest.mark.parametrize(("number", "code"), [(signal.SIGKILL, -9), (signal.SIGINT, 130)])
def test_a_killed_or_stopped_command_leaves_a_resumable_file_and_no_worker(
    start: Callable[..., Process], tmp_path: Path, quick: str, workers: str, number: int, code: int
) -> None:
    out = tmp_path / "killed"
    words = ("-n", "2000", "--seed", "3", "--scenes", quick, "--workers", workers, "--json")
    process = start(*WORDS, *words, "--out", str(out))
    wait_until(lambda: list(out.glob("part-*.parquet")), "a part")
    started = children(process.process.pid)
    assert len(started) >= int(workers) - 1
    assert process.end(number) == code
    if code == 130:
        answer = json.loads(process.out[-1])
        assert (answer["success"], answer["complete"]) == (False, False)
    wait_until(lambda: not any(Path(f"/proc/{each}/fd/0").exists() for each in started), "the workers' end")
    count = len(stored(out))
    with Store(out, settings(2000)) as store:
        assert len(store.missing()) == 2000 - count
    known = dict(enumerate(expected(3)))
    assert all(row == known.get(row["number"], row) for row in stored(out))


def test_different_settings_are_refused_and_named(tmp_path: Path) -> None:
    with Store(tmp_path / "s", settings(3)) as store:
        store.add(runner.run_batch(store.settings.to_json(), [0]))
    wider = {**QUICK, "target": {"x": [-0.004, 0.002], "y": [-0.002, 0.002], "roll": [-0.05, 0.05]}}
    for other, named in (
        (settings(3, seed=4), "seed is 4, was 3"),
        (settings(3, exact=True), "exact is true"),
        (settings(2), "n is 2, was 3"),
        (settings(3, content=wider), "scene's target.x"),
        (replace(settings(3), versions={**settings(3).versions, "deltacharger": "0.0.1"}), "version of deltacharger"),
    ):
        with pytest.raises(CampaignRefused, match=named), Store(tmp_path / "s", other):
            pass
    with Store(tmp_path / "s", settings(5)) as store:  # more dockings of the same campaign
        assert store.missing() == [1, 2, 3, 4]


def test_one_folder_has_one_writer_and_no_row_twice(tmp_path: Path) -> None:
    with Store(tmp_path / "s", settings(3)) as store:
        rows = runner.run_batch(store.settings.to_json(), [0, 1])
        assert [store.add(rows), store.add(rows)] == [2, 0]
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
    with pytest.raises(CampaignError, match=r"part-000000009\.parquet"):
        read_results(tmp_path / "s")


def test_a_crash_becomes_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    real = docking.run

    def sometimes(drawn: Any, exact: bool, **more: Any) -> dict[str, Any]:
        if drawn.number == 1:
            raise ZeroDivisionError("no such thing")
        return real(drawn, exact, **more)

    monkeypatch.setattr(docking, "run", sometimes)
    rows = runner.run_batch(settings(3).to_json(), [0, 1, 2])
    assert [row["code_name"] for row in rows] == ["NONE", "CRASHED", "NONE"]
    assert "ZeroDivisionError: no such thing" in rows[1]["error"]
    assert rows[1]["target.x"] == draw(scene(), 3, 1).values["target.x"]
    summary = summarise({name: [row[name] for row in rows] for name in docking.RESULTS | {"number": None}})
    assert (summary["n"], summary["crashed"], summary["refused"]) == (3, 1, {})


def test_wilson_intervals_have_their_nominal_coverage() -> None:
    held = 0.0
    for hits in range(81):
        low, high = wilson(hits, 80)
        held += math.comb(80, hits) * 0.93**hits * 0.07 ** (80 - hits) * (low <= 0.93 <= high)
    assert held == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("trials", [20, night(200)])
def test_intervals_of_numbers_have_their_nominal_coverage(trials: int) -> None:
    random = np.random.default_rng(2)
    held = seen = 0
    for trial in range(trials):
        common = random.gamma(2.0, 5.0, 80)
        a, b = common + random.normal(0.0, 1.0, 80), common + 0.5 + random.normal(0.0, 1.0, 80)
        found = compare.compare_numbers(a, b, trial)
        low, high = found["interval"]
        held += low <= 0.5 <= high
        seen += low > 0.0
    assert held / trials == pytest.approx(0.95, abs=0.64 / trials**0.5)
    assert seen / trials > 0.7  # unpaired, 14 s of scatter between dockings would hide half a second


def test_a_known_difference_of_rates_is_found() -> None:
    a = np.arange(200) % 10 > 0  # 90 %
    b = a.copy()
    b[:20] = False
    found = compare.compare_rates(a, b)
    assert found["difference"] == pytest.approx(-0.09)
    assert found["interval"][1] < 0.0
    assert (found["only_a"], found["only_b"]) == (18, 0)
    assert found["p"] == pytest.approx(2.0**-17)


def test_the_command_reports_differences(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for name, kind in (("a", {}), ("b", {"exact": True}), ("c", {"seed": 9})):
        with Store(tmp_path / name, settings(2, **kind)) as store:
            store.add(runner.run_batch(store.settings.to_json(), range(2)))
    a, b, c = (str(tmp_path / name) for name in "abc")
    code, found, _ = run(capsys, "--compare", a, b)
    assert (code, found["pairs"], found["differs"]) == (0, 2, ["exact: false → true"])
    assert found["rates"]["charged"]["difference"] == 0.0
    low, high = found["numbers"]["peak_push"]["interval"]
    assert low <= found["numbers"]["peak_push"]["difference"] <= high
    code, found, _ = run(capsys, "--compare", a, c)
    assert (code, "pairs" in found["error"]) == (2, True)
