# SPDX-License-Identifier: Apache-2.0
"""`deltacharger calibrate kinematics --measure …` with an operator and a running charger of mocks."""

import json
import math
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.calibration.data import plan, read_measurements

from ..chargers import DEADLINE, Process, wait_until
from ..marks import night, rest

pytestmark = pytest.mark.ros

NOMINAL = DeltaGeometry()
WITNESS = pytest.param(signal.SIGINT, marks=pytest.mark.witness)


class Operator(Process):
    """`--measure` with an operator at its terminal."""

    def __init__(self, *words: str) -> None:
        super().__init__(*words, stdin=subprocess.PIPE)
        self._answered = 0

    def wait_for_question(self) -> None:
        wait_until(lambda: self._questions() > self._answered or self.process.poll() is not None, "a question")
        assert self._questions() > self._answered, self.err

    def _questions(self) -> int:
        return sum(line.endswith(":") for line in list(self.err))

    def answer(self, text: str | Callable[[], str]) -> None:
        self.wait_for_question()
        self._answered += 1
        assert self.process.stdin is not None
        print(text if isinstance(text, str) else text(), file=self.process.stdin, flush=True)


@pytest.fixture(scope="module")
def charger(quick_scene: Any, context: Any) -> Iterator[Any]:
    from ..running_charger import RunningCharger

    with RunningCharger(quick_scene, context) as charger:
        yield charger


def position(charger: Any) -> np.ndarray:
    return np.asarray(Delta(NOMINAL).forward(np.array(charger.servos.position)).position)


def torque(charger: Any) -> bool:
    return any(charger.servos.torque_enabled)


@pytest.fixture
def measured(tmp_path: Path) -> Path:
    """The file of measurements; the first planned poses are clear of the mock's target."""
    return tmp_path / "measured.csv"


@pytest.fixture
def operator(charger: Any, measured: Path) -> Iterator[Callable[..., Operator]]:
    running: list[Operator] = []

    def begin(*words: str) -> Operator:
        command = (sys.executable, "-m", "deltacharger_bringup.cli", "calibrate", "kinematics", "--measure")
        running.append(Operator(*command, str(measured), "--namespace", charger.namespace, *words))
        return running[-1]

    yield begin
    for each in running:
        if each.process.poll() is None:
            each.process.kill()
            each.process.wait(DEADLINE)
    wait_until(lambda: not torque(charger), "torque off")


def place(charger: Any) -> Callable[[], str]:
    """Return a function that reads the position of the arm, as an operator types it."""
    return lambda: " ".join(f"{1000 * value:.3f}" for value in position(charger))


@pytest.mark.rest
def test_measured_poses_are_recorded_one_by_one_and_resumed(
    operator: Callable[..., Operator], charger: Any, measured: Path
) -> None:
    user = operator("--json")
    user.answer("what?")
    user.answer("1 2")
    user.wait_for_question()
    first = position(charger)
    assert torque(charger)
    user.answer("900 0 0")  # a typing error; the question is repeated
    user.answer(place(charger))
    user.answer("s")
    user.answer(place(charger))
    user.answer("q")
    assert user.end() == 0, user.err
    found = json.loads(user.out[0])
    assert (found["measured"], found["skipped"], found["remaining"], found["written"]) == (2, 1, 34, str(measured))
    rows = read_measurements(measured)
    assert np.allclose(rows.positions[0], first, atol=1e-4)
    assert np.allclose(rows.positions, Delta(NOMINAL).forward(rows.angles).position, atol=1e-4)
    assert np.allclose(rows.positions[0], plan(NOMINAL)[0].position, atol=3e-3)
    wait_until(lambda: not torque(charger), "torque off")
    assert math.dist(position(charger), (0.0, 0.0, 0.0)) < 0.01

    again = operator()
    again.answer(place(charger))
    again.answer("q")
    assert again.end() == 0, again.err
    assert any("pose 2, 1 of 34" in line for line in again.err), "the skipped one"
    assert len(read_measurements(measured)) == 3


@pytest.mark.parametrize("how", [WITNESS, night(signal.SIGTERM), night(signal.SIGHUP), rest("end of input")])
def test_after_any_end_the_torque_is_off_and_measurements_are_kept(
    operator: Callable[..., Operator], charger: Any, measured: Path, how: signal.Signals | str
) -> None:
    user = operator("--json")
    user.wait_for_question()
    assert torque(charger)
    user.answer(place(charger))
    user.wait_for_question()
    if isinstance(how, signal.Signals):
        assert user.end(how) == 130, user.err
    else:
        user.process.stdin.close()
        assert user.end() == 1, user.err
    assert json.loads(user.out[0])["success"] is False
    wait_until(lambda: not torque(charger), "torque off")
    assert len(read_measurements(measured)) == 1
