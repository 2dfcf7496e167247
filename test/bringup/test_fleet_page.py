# SPDX-License-Identifier: Apache-2.0
"""docs/fleet.md matches the code: the levels of codes, its command lines, and its example client."""

import json
import re
import signal
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from deltacharger_bringup.scenes.composition import Composition
from deltacharger_bringup.scenes.scene import Scene
from deltacharger_docking.codes import Code
from deltacharger_docking.mission.dialogue import Stage

from ..chargers import Process

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
CLIENT = ROOT / "examples" / "charge_robot.py"
CODES = (ROOT / "docs" / "errors.md").read_text(encoding="utf-8")
_ROW = re.compile(r"^\| (\d+) \| ([A-Z_]+) \| .* \| (WARNING|FATAL|–) \|$", re.MULTILINE)
_GOAL = re.compile(r'ros2 action send_goal (\S+) deltacharger/action/(\S+) "([^"]+)"')


def test_page_client_and_codes_agree() -> None:
    rows = _ROW.findall(CODES)
    assert [(int(number), name) for number, name, _ in rows] == [(int(code), code.name) for code in Code]
    fatal = re.search(r"^FATAL = \(([^)]*)\)", CLIENT.read_text(encoding="utf-8"), re.MULTILINE)
    assert fatal is not None
    assert set(re.findall(r"\d+", fatal[1])) == {number for number, _, level in rows if level == "FATAL"}
    assert [stage.name for stage in Stage if len(re.findall(rf"\b{stage.name}\b", PAGE)) < 2] == []


def fill(message: Any, values: dict[str, Any]) -> None:
    """Set the fields of a message as ros2 action does; an unknown field is an error."""
    for name, value in values.items():
        assert name in message.get_fields_and_field_types(), f"{type(message).__name__} has no field {name}"
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


def test_the_command_lines_use_existing_fields() -> None:
    import deltacharger.action

    lines = _GOAL.findall(re.sub(r"\\\n\s*", "", PAGE))
    assert {action for _, action, _ in lines} == {"ChargeRobot", "Dock", "Undock"}
    assert len(lines) == PAGE.count("ros2 action send_goal /")
    for name, action, text in lines:
        assert name == "/" + re.sub(r"(?<=[a-z])(?=[A-Z])", "_", action).lower()
        goal = getattr(deltacharger.action, action).Goal()
        fill(goal, yaml.safe_load(text))
        assert goal.request_id


@pytest.mark.rest
def test_the_client_reports_startcharging_as_vda5050_requires(
    quick_scene: Scene, context: Any, namespace: str, start: Callable[..., Process]
) -> None:
    scene = replace(quick_scene, nodes=(*quick_scene.nodes, "mission_node"))
    words = (sys.executable, str(CLIENT), "{}", "--ros-args", "-r", f"__ns:=/{namespace}")
    with Composition(scene, context, namespace) as charger:
        client = start(*(word.format(1) for word in words))
        assert client.end() == 0, (client.out, client.err)
        states = [json.loads(line) for line in client.out]
        statuses = [state["actionStatus"] for state in states]
        assert list(dict.fromkeys(statuses)) == ["WAITING", "RUNNING", "FINISHED"]
        for state in states:
            assert not state["batteryState.charging"] or state["actionStatus"] == "FINISHED"
            assert state["errors"] == []
        charging = [state["batteryState.charging"] for state in states]
        assert (any(charging), charging[-1]) == (True, False)

        client = start(*(word.format(0) for word in words))
        client.wait_for_line('"batteryState.charging": true', client.out)
        assert client.end(signal.SIGINT) == 1
        last = json.loads(client.out[-1])
        assert (last["actionStatus"], last["batteryState.charging"]) == ("FINISHED", False)
        assert [error["errorType"] for error in last["errors"]] == ["CANCELED"]
        assert not charger.node("mock_tactile_node").contactor_closed
