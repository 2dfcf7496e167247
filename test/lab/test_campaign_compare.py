# SPDX-License-Identifier: Apache-2.0
"""Comparing campaigns: equal ones seem to differ no more often than the interval allows, and differences are found."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_lab.campaigns.batch import run_batch
from deltacharger_lab.campaigns.compare import compare_numbers, compare_rates, mcnemar
from deltacharger_lab.campaigns.store import Store

from .campaigns import settings

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra campaign)")


def test_intervals_of_numbers_have_their_nominal_coverage() -> None:
    random = np.random.default_rng(2)
    held = seen = 0
    for trial in range(200):
        common = random.gamma(2.0, 5.0, 80)
        a, b = common + random.normal(0.0, 1.0, 80), common + 0.5 + random.normal(0.0, 1.0, 80)
        found = compare_numbers(a, b, trial)
        low, high = found["interval"]
        held += low <= 0.5 <= high
        seen += low > 0.0
    assert held / 200 == pytest.approx(0.95, abs=0.045)
    assert seen / 200 > 0.8  # unpaired, 14 s of scatter between dockings would hide half a second


def test_intervals_cover_zero_without_a_difference() -> None:
    same = np.linspace(1.0, 9.0, 50)
    found = compare_numbers(same, same)
    assert (found["difference"], found["interval"]) == (0.0, [0.0, 0.0])
    random = np.random.default_rng(4)
    held = sum(
        low <= 0.0 <= high
        for low, high in (
            compare_rates(random.random(150) < 0.9, random.random(150) < 0.9)["interval"] for _ in range(300)
        )
    )
    assert held / 300 == pytest.approx(0.95, abs=0.04)


def test_a_known_difference_of_rates_is_found() -> None:
    a = np.arange(200) % 10 > 0  # 90 %
    b = a.copy()
    b[:20] = False
    found = compare_rates(a, b)
    assert found["difference"] == pytest.approx(-0.09)
    assert found["interval"][1] < 0.0
    assert (found["only_a"], found["only_b"]) == (18, 0)
    assert found["p"] == pytest.approx(2.0**-17)


@pytest.mark.parametrize(
    ("only_a", "only_b", "p"), [(0, 0, 1.0), (1, 0, 1.0), (5, 5, 1.0), (0, 6, 2.0**-5), (2, 8, 0.109375)]
)
def test_mcnemar_exactly(only_a: int, only_b: int, p: float) -> None:
    assert mcnemar(only_a, only_b) == pytest.approx(p)
    assert mcnemar(only_b, only_a) == pytest.approx(p)
    assert mcnemar(40_000, 40_000) == pytest.approx(1.0)


def test_numbers_that_no_pair_has_are_nan() -> None:
    nothing = compare_numbers(np.array([math.nan, 1.0]), np.array([2.0, math.nan]))
    assert nothing["n"] == 0
    assert math.isnan(nothing["difference"])


def test_many_pairs_cost_no_bootstrap_and_give_the_same() -> None:
    random = np.random.default_rng(8)
    a = random.normal(0.0, 1.0, 20_001)
    b = a + random.normal(0.1, 0.5, 20_001)
    low, high = compare_numbers(a, b)["interval"]
    assert low <= 0.1 <= high
    fewer = compare_numbers(a[:20_000], b[:20_000])["interval"]
    assert [low, high] == pytest.approx(fewer, abs=3e-4)


def written(folder: Path, **kind: Any) -> Path:
    with Store(folder, settings(4, **kind)) as store:
        store.add(run_batch(store.settings.to_json(), range(4)))
    return folder


def test_the_command_reports_and_draws_differences(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    a, b = written(tmp_path / "a"), written(tmp_path / "b", approach="paper")
    other = written(tmp_path / "c", seed=9)
    assert main(["campaign", "compare", str(a), str(b), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["pairs"] == 4
    assert found["differs"] == ["approach: guarded → paper"]
    assert found["rates"]["charged"]["difference"] == 0.0
    low, high = found["numbers"]["peak_push"]["interval"]
    assert low <= found["numbers"]["peak_push"]["difference"] <= high
    assert main(["campaign", "compare", str(a), str(other), "--json"]) == 2
    assert "not pairs" in json.loads(capsys.readouterr().out)["error"]
    pytest.importorskip("matplotlib", reason="matplotlib is not installed (extra report)")
    picture = tmp_path / "differences.png"
    assert main(["campaign", "compare", str(a), str(b), "--picture", str(picture)]) == 0
    assert "McNemar" in capsys.readouterr().out
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 20_000
