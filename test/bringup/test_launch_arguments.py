# SPDX-License-Identifier: Apache-2.0
"""A slip in a launch file's arguments is refused by name, but not where another file includes it."""

from __future__ import annotations

import sys
from pathlib import Path

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


def test_a_file_of_the_same_name_in_another_package_is_not_this_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_robot", "charger.launch.py", *SLIPS])
    refuse_slips("/opt/share/launch/charger.launch.py", SLIPS, KNOWN)


def test_a_file_that_is_named_by_its_path_is_this_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "charger.launch.py"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", file.name, *SLIPS])
    with pytest.raises(ValueError, match="'servo_prot'"):
        refuse_slips(str(file), SLIPS, KNOWN)
