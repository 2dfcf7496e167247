# SPDX-License-Identifier: Apache-2.0
"""Docking's log: every phase once and in order, every failure with its code as a warning, and no other line."""

from __future__ import annotations

import itertools
import re
from types import SimpleNamespace
from typing import Any

from deltacharger_docking.codes import Code, State
from deltacharger_docking.observation import Command
from deltacharger_docking.ros.reports import PhaseLog
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

from .dockings import quick_charger

PASSAGE = re.compile(r"^dock order-1: (\w+) → (\w+)( after \d+\.\d s)?(, |$)")


def logged(run: VirtualCharger) -> tuple[list[str], list[str]]:
    """Return the lines and warnings of a charger from now on, as docking_node logs its machine."""
    lines: list[str] = []
    warnings: list[str] = []
    log, follow = PhaseLog(SimpleNamespace(info=lines.append, warning=warnings.append), State.IDLE), run._follow  # type: ignore[arg-type]
    log.begin("dock order-1")

    def followed(command: Command) -> None:
        follow(command)
        status: Any = run.machine.status
        log.show(status, [] if status.state is log.phase else [status.state], run.now, "z")

    run._follow = followed  # type: ignore[method-assign]
    return lines, warnings


def test_a_docking_is_logged_phase_by_phase_and_its_failure_once() -> None:
    run = quick_charger(1.0, -1.0, 1.0)
    lines, warnings = logged(run)
    assert run.dock().success
    run.run(1.0)
    assert run.undock().success
    assert not warnings
    found = [(match[1], match[2]) for line in lines if (match := PASSAGE.match(line))]
    assert found[0] == ("idle", "approach")
    assert all(left[1] == right[0] for left, right in itertools.pairwise(found)), found
    assert found[-1][1] == "idle"
    assert {"contact", "measure", "energise", "charging", "retract"} <= {after for _, after in found}
    assert len(lines) == 1 + len(found), "a line for each change, and none for a tick"


def test_a_failure_is_a_warning_and_a_cancel_none() -> None:
    lines, warnings = list[str](), list[str]()
    log = PhaseLog(SimpleNamespace(info=lines.append, warning=warnings.append), State.IDLE)  # type: ignore[arg-type]
    log.begin("dock order-1")
    for code in (Code.NO_CONTACT, Code.NO_CONTACT, Code.NONE, Code.CANCELED):
        log.show(SimpleNamespace(code=code, message="why"), (), 0.0)
    assert warnings == ["dock order-1: 302 NO_CONTACT: why"]
    assert lines[1:] == ["dock order-1: 102 CANCELED: why"]
