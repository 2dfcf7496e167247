# SPDX-License-Identifier: Apache-2.0
"""A slip in a launch file's arguments is refused by name, but not where another file includes it."""

from __future__ import annotations

import sys

import pytest

from deltacharger_bringup.launch_arguments import refuse_slips

KNOWN = {"scene": "", "servo_port": ""}
SLIPS = ["scene:=bench", "servo_prot:=/dev/ttyUSB1"]


def test_a_slip_is_refused_with_the_nearest_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "deltacharger", "charger.launch.py", *SLIPS])
    with pytest.raises(ValueError, match="'servo_prot'; did you mean 'servo_port'"):
        refuse_slips("/opt/share/launch/charger.launch.py", SLIPS, KNOWN)
    refuse_slips("/opt/share/launch/charger.launch.py", ["scene:=bench", "launch-prefix:=gdb", "-d"], KNOWN)


def test_arguments_of_a_file_that_includes_it_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "fleet", "robot.launch.py", *SLIPS])
    refuse_slips("/opt/share/launch/charger.launch.py", SLIPS, KNOWN)
