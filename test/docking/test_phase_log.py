# SPDX-License-Identifier: Apache-2.0
"""Docking's log: every phase once and in order, every failure with its code, the contactor, and no other line."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace
from typing import Any

import pytest

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import Command, DockingStatus, Observation
from deltacharger_docking.ros.reports import PhaseLog
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

from .dockings import quick_charger

PASSAGE = re.compile(r"^dock order-1: (\w+) → (\w+)( after \d+\.\d s)?(, |$)")


def passages(lines: list[str]) -> list[tuple[str, str]]:
    return [(found[1], found[2]) for line in lines if (found := PASSAGE.match(line))]


@pytest.fixture
def logged(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Log lines of all virtual chargers, each stepped as docking_node steps its machine."""
    lines: list[str] = []
    log, follow = PhaseLog(), VirtualCharger._follow
    log.begin("dock order-1")

    def followed(run: Any, command: Command) -> None:
        follow(run, command)
        lines.extend(log.lines(run.machine.status, command.states, run.observe()))

    monkeypatch.setattr(VirtualCharger, "_follow", followed)
    return lines


def test_a_docking_is_logged_phase_by_phase_with_its_contactor(logged: list[str]) -> None:
    run = quick_charger(1.0, -1.0, 1.0)
    assert run.dock().success
    run.run(1.0)
    assert run.undock().success
    run.run(0.1)
    found = passages(logged)
    assert found[0] == ("idle", "approach")
    assert all(left[1] == right[0] for left, right in itertools.pairwise(found)), found
    assert found[-1][1] == "idle"
    assert {"contact", "measure", "energise", "charging", "retract"} <= {after for _, after in found}
    assert [line.split(",")[0] for line in logged if "contactor" in line] == [
        "dock order-1: contactor closed",
        "dock order-1: contactor open",
    ]
    assert len(logged) == len(found) + 2, "a line for each change, and none for a tick"
    assert "nan" not in "".join(logged)


def status(state: State, code: Code = Code.NONE, message: str = "") -> DockingStatus:
    return DockingStatus(state=state, code=code, message=message)


@pytest.mark.parametrize(
    ("before", "code", "is_lost"),
    [
        (State.CHARGING, Code.NO_CONTACT, True),
        (State.IDLE, Code.NO_CONTACT, True),  # it rests, with electrodes wired to the battery or without current
        (State.CHARGING, Code.CANCELED, False),
        (State.CHARGING, Code.NONE, False),  # undocked, or full
        (State.ENERGISE, Code.SHORT_CIRCUIT, False),
    ],
)
def test_a_charge_that_a_failure_ends_is_told_as_lost(before: State, code: Code, is_lost: bool) -> None:
    log = PhaseLog()
    log.begin("dock order-1")
    entered = (State.CONTACT, State.ENERGISE, before)
    log.lines(replace(status(before), docked=True), entered, Observation(1.0))
    ended = replace(status(State.RETRACT, code, "why"), docked=True)
    (line,) = log.lines(ended, (State.RETRACT,), Observation(3.0))
    assert log.lost == (line if is_lost else "")
