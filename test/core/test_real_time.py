# SPDX-License-Identifier: Apache-2.0
"""A process with deadlines has real-time priority in all its threads, or says what to permit."""

import errno
import importlib
import os
from typing import Any

import pytest

from deltacharger_bringup.scenes.node_table import NODES
from deltacharger_core import real_time


def test_without_permission_the_process_goes_on_and_says_what_to_permit(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*arguments: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    told = real_time.take_priority()
    assert all(word in told for word in ("not permitted", "LimitRTPRIO=1", "USER - rtprio 1", "--ulimit rtprio=1"))


@pytest.mark.ros
def test_the_nodes_that_keep_the_contactor_closed_ask_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: set[str] = set()

    def run(factory: Any, args: Any = None, has_deadlines: bool = False) -> int:
        asked.update([name] if has_deadlines else [])
        return 0

    monkeypatch.setattr("deltacharger_core.ros.node_support.run", run)
    for name in ("servo_node", "tactile_node", "docking_node", "misalignment_node", "kinematics_node", "mission_node"):
        assert importlib.import_module(NODES[name].module).main() == 0
    assert asked == {"servo_node", "tactile_node", "docking_node"}
