# SPDX-License-Identifier: Apache-2.0
"""A node as a process, as `ros2 run` starts it, ends with 2 and a reason if it is configured wrongly.

Their docking, and their ends with 0: test_stops.py.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from deltacharger_scenes.scene import parse_scene

from ..chargers import Process
from ..running_charger import node_command as arguments

pytestmark = [pytest.mark.ros, pytest.mark.rest]

MINE = {
    "nodes": ["servo_node", "tactile_node", "kinematics_node"],
    "ports": {"servo": "/dev/no_servo", "board": "/dev/no_board"},
}


@pytest.mark.parametrize(
    ("name", "words", "expected"),
    [
        ("servo_node", (), "/dev/no_servo: there is no such port"),
        ("tactile_node", (), "/dev/no_board: there is no such port"),
        ("kinematics_node", ("-p", "no_such_parameter:=1"), "no_such_parameter"),
        ("kinematics_node", ("-r", "__ns:=/bad name"), "ROS refuses"),
        ("kinematics_node", ("--no-such-flag",), "no-such-flag"),
    ],
)
def test_a_wrong_configuration_ends_a_node_with_2_and_its_reason(
    start: Callable[..., Process], namespace: str, name: str, words: tuple[str, ...], expected: str
) -> None:
    process = start(*arguments(parse_scene(MINE, "mine"), name, namespace), *words)
    assert process.end() == 2
    assert any(expected in line for line in process.err), process.err
    assert not any("Traceback" in line for line in process.err)


def test_an_invalid_ros_domain_ends_a_node_with_2(
    start: Callable[..., Process], namespace: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "233")
    process = start(*arguments(parse_scene(MINE, "mine"), "kinematics_node", namespace))
    assert process.end() == 2
    (line,) = process.err
    assert "0 to 232" in line
