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

from ..marks import night
from .campaigns import settings

pytest.importorskip("pyarrow", reason="pyarrow is not installed (extra campaign)")


@pytest.mark.parametrize("trials", [20, night(200)])
def test_intervals_of_numbers_have_their_nominal_coverage(trials: int) -> None:
    random = np.random.default_rng(2)
    held = seen = 0
    for trial in range(trials):
        common = random.gamma(2.0, 5.0, 80)
        a, b = common + random.normal(0.0, 1.0, 80), common + 0.5 + random.normal(0.0, 1.0, 80)
        found = compare_numbers(a, b, trial)
        low, high = found["interval"]
        held += low <= 0.5 <= high
        seen += low > 0.0
    assert held / trials == pytest.approx(0.95, abs=0.64 / trials**0.5)
    assert seen / trials > 0.7  # unpaired, 14 s of scatter between dockings would hide half a second


def test_intervals_cover_zero_without_a_difference() -> None:
    same = np.linspace(1.0, 9.0, 50)
    found = compare_numbers(same, same)
    assert (found["difference"], found["interval"]) == (0.0, [0.0, 0.0])
    nothing = compare_numbers(np.array([math.nan, 1.0]), np.array([2.0, math.nan]))
    assert (nothing["n"], math.isnan(nothing["difference"])) == (0, True)
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


def written(folder: Path, **kind: Any) -> Path:
    with Store(folder, settings(2, **kind)) as store:
        store.add(run_batch(store.settings.to_json(), range(2)))
    return folder


def test_the_command_reports_differences(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    a, b = str(written(tmp_path / "a")), str(written(tmp_path / "b", approach="paper"))
    assert main(["campaign", "compare", a, b, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["pairs"], found["differs"]) == (2, ["approach: guarded → paper"])
    assert found["rates"]["charged"]["difference"] == 0.0
    low, high = found["numbers"]["peak_push"]["interval"]
    assert low <= found["numbers"]["peak_push"]["difference"] <= high
    assert main(["campaign", "compare", a, str(written(tmp_path / "c", seed=9)), "--json"]) == 2
    assert "pairs" in json.loads(capsys.readouterr().out)["error"]
