# SPDX-License-Identifier: Apache-2.0
"""`generate --protocol docked`: the paper's dockings by the real movements, in virtual time."""

import dataclasses
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_bringup.cli.main import main
from deltacharger_bringup.cli.output import DONE, FAILED
from deltacharger_docking.codes import DockingError
from deltacharger_lab.campaigns import recording
from deltacharger_lab.campaigns.recording import Protocol, record_paper, record_part
from deltacharger_lab.training import __main__ as training
from deltacharger_lab.training.labels import examples
from deltacharger_sim.pads import generate_continuous
from deltacharger_tactile.classifiers.classifier import TARGETS
from deltacharger_tactile.dataset import SUBSET_ANGLE, Dataset

SMALL = Protocol(rig=880, seed=4, repeat=(6, 1))


def silent(_: str) -> None:
    """Ignore progress."""


@pytest.fixture(scope="module")
def data() -> Dataset:  # 3 s of CPU
    return record_paper(SMALL, silent)


@pytest.mark.rest
def test_a_recording_has_both_sets_with_the_protocols_labels(data: Dataset) -> None:
    assert len(data) == 6 * 6 + 25
    assert [len(examples(data, target)) for target in TARGETS] == [36, 25, 25]
    by_angle = data.subset == SUBSET_ANGLE
    assert np.bincount(np.round(np.degrees(data.angle[by_angle])).astype(int)).tolist() == [6] * 6
    grid = set(itertools.product((-10, -5, 0, 5, 10), repeat=2))
    assert {(round(1e3 * x), round(1e3 * y)) for x, y, _ in commanded(data)[~by_angle]} == grid
    lit = np.concatenate([data.left, data.right])
    assert lit[lit > 0.0].min() >= 1.0
    assert (data.meta["protocol"], data.meta["recorded"], data.simulated) == ("paper", True, True)


def commanded(data: Dataset) -> Any:
    return np.column_stack([data.horizontal, data.vertical, data.angle])


def test_a_docking_that_fails_three_times_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    blind = recording._seen
    monkeypatch.setattr(recording, "_seen", lambda *words: dataclasses.replace(blind(*words), success=False))
    with pytest.raises(DockingError, match=r"angle 2°: a docking failed 3 times, ELECTRODES_NOT_FOUND"):
        record_part(SMALL, SMALL.parts()[2])


def test_the_command_writes_the_data_set_or_names_the_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Protocol] = []
    written = generate_continuous(rigs=(860,), count=10, seed=3, threshold=0.0)

    def record(what: Protocol, _: object) -> Dataset:
        asked.append(what)
        if len(asked) == 1:
            return written
        raise DockingError("angle 2°: a docking failed 3 times")

    monkeypatch.setattr(training, "record_paper", record)
    words = ["generate", "--protocol", "docked", "--first-rig", "880", "--seed", "4", "--rows", "2", "--json"]
    assert main([*words, "--out", str(tmp_path / "data.npz")], training.COMMANDS) == DONE
    assert asked == [Protocol(rig=880, seed=4, rows=2)]
    assert json.loads(capsys.readouterr().out)["n"] == len(written) == len(Dataset.load(tmp_path / "data.npz"))
    assert main([*words, "--out", str(tmp_path / "none.npz")], training.COMMANDS) == FAILED
    assert "failed 3 times" in capsys.readouterr().err
    assert not (tmp_path / "none.npz").exists()
