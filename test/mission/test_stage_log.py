# SPDX-License-Identifier: Apache-2.0
"""A mission's log: a line for each stage and each failure, and none without a change."""

from __future__ import annotations

from deltacharger_docking.codes import Code
from deltacharger_mission.dialogue import MissionStatus, Stage
from deltacharger_mission.places import Place
from deltacharger_mission.stage_log import StageLog


def test_each_stage_and_each_failure_is_logged_once() -> None:
    log = StageLog()
    log.begin("charge_robot order-1")
    status = MissionStatus()
    assert log.lines(status) == []
    status.stage, status.elapsed = Stage.DRIVE, 0.5
    assert log.lines(status) == ["charge_robot order-1: wait → drive after 0.5 s"]
    status.elapsed, status.place = 3.0, Place(1.0, 2.0, 0.5, "map")
    assert log.lines(status) == []
    status.stage, status.elapsed, status.views = Stage.SEARCH, 4.5, 1
    (line,) = log.lines(status)
    assert line.startswith(
        "charge_robot order-1: drive → search after 4.0 s, base at (1.00, 2.00) m, yaw 0.50 rad of map"
    )
    assert line.endswith("views 1")
    status.code, status.message = Code.ELECTRODES_NOT_FOUND, "nothing there"
    assert log.lines(status) == ["charge_robot order-1: search, 201 ELECTRODES_NOT_FOUND: nothing there"]
    status.stage, status.elapsed = Stage.RETURN, 6.0
    (line,) = log.lines(status)
    assert line.startswith("charge_robot order-1: search → return after 1.5 s")
    assert "201" not in line
