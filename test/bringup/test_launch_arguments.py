# SPDX-License-Identifier: Apache-2.0
"""An unknown argument of a launch file is refused by name, but not if another file includes it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from deltacharger_bringup.launch_arguments import refuse_unknown_arguments

KNOWN = {"scene": "", "servo_port": ""}
ARGUMENTS = ["scene:=bench", "servo_prot:=/dev/ttyUSB1"]


def test_an_unknown_argument_is_refused_with_the_nearest_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "deltacharger", "charger.launch.py", *ARGUMENTS])
    with pytest.raises(ValueError, match="'servo_prot'; did you mean 'servo_port'"):
        refuse_unknown_arguments("/opt/share/launch/charger.launch.py", ARGUMENTS, KNOWN)
    refuse_unknown_arguments("/opt/share/launch/charger.launch.py", ["scene:=bench", "launch-prefix:=gdb", "-d"], KNOWN)


def test_arguments_of_an_including_file_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "fleet", "robot.launch.py", *ARGUMENTS])
    refuse_unknown_arguments("/opt/share/launch/charger.launch.py", ARGUMENTS, KNOWN)


def test_a_file_with_this_name_in_another_package_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", "my_robot", "charger.launch.py", *ARGUMENTS])
    refuse_unknown_arguments("/opt/share/launch/charger.launch.py", ARGUMENTS, KNOWN)


def test_a_file_started_by_its_path_is_recognised(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "charger.launch.py"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", file.name, *ARGUMENTS])
    with pytest.raises(ValueError, match="'servo_prot'"):
        refuse_unknown_arguments(str(file), ARGUMENTS, KNOWN)
