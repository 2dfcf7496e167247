# SPDX-License-Identifier: Apache-2.0
"""docs/fleet.md matches the code: its table of codes, its command lines, and its example client."""

from __future__ import annotations

import ast
import json
import re
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import deltacharger.action
import pytest
import yaml

from deltacharger_docking.codes import Code, DockingError
from deltacharger_mission.dialogue import Stage
from deltacharger_scenes.composition import Composition
from deltacharger_scenes.scene import parse_scene

from ..chargers import Process
from ..docking.mock_docking import MockDocking

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "fleet.md").read_text(encoding="utf-8")
CLIENT = ROOT / "examples" / "charge_robot.py"
_ROW = re.compile(r"^\| (\d+) \| ([A-Z_]+) \| (\S+) \| ([^|]+) \| ([^|]+) \|$", re.MULTILINE)
_GOAL = re.compile(r'ros2 action send_goal (\S+) (\S+)/action/(\S+) "([^"]+)"')
# Classes of a code in the order of definition: the first is the rule, the others are exceptions.
RETRIABLE = {kind.code: kind.retriable for kind in reversed(DockingError.__subclasses__()) if "code" in vars(kind)}


def test_every_code_is_in_the_table_with_the_right_retriable_value() -> None:
    rows = _ROW.findall(PAGE)
    assert [(int(number), name) for number, name, *_ in rows] == [(int(code), code.name) for code in Code]
    for number, name, level, again, who in rows[1:]:
        code = Code(int(number))
        assert level in ("WARNING", "FATAL"), name
        assert who.strip(), name
        assert again.startswith("yes" if RETRIABLE.get(code, False) else "no"), name


def test_the_client_and_the_table_agree_on_fatal_codes() -> None:
    fatal = {int(number) for number, _, level, *_ in _ROW.findall(PAGE) if level == "FATAL"}
    tree = ast.parse(CLIENT.read_text(encoding="utf-8"))
    values = [
        node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FATAL"
    ]
    assert set(ast.literal_eval(values[0])) == fatal


def test_every_stage_is_in_the_page_twice() -> None:
    for stage in Stage:
        assert len(re.findall(rf"\b{stage.name}\b", PAGE)) >= 2, stage.name


def fill(message: Any, values: dict[str, Any]) -> None:
    """Set the fields of a message as ros2 action does; an unknown field is an error."""
    for name, value in values.items():
        assert name in message.get_fields_and_field_types(), f"{type(message).__name__} has no field {name}"
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


def test_the_command_lines_use_existing_fields() -> None:
    lines = _GOAL.findall(re.sub(r"\\\n\s*", "", PAGE))
    assert {action for _, _, action, _ in lines} == {"ChargeRobot", "Dock", "Undock"}
    assert len(lines) == PAGE.count("ros2 action send_goal /")
    for name, package, action, text in lines:
        assert package == "deltacharger"
        assert name == "/" + re.sub(r"(?<=[a-z])(?=[A-Z])", "_", action).lower()
        goal = getattr(deltacharger.action, action).Goal()
        fill(goal, yaml.safe_load(text))
        assert goal.request_id


@pytest.fixture
def docking(context: Any, namespace: str) -> Iterator[MockDocking]:
    """A docking_node for a mission_node that does not drive."""
    node = MockDocking(context, namespace)
    scene = {"nodes": ["mock_detector_node", "mission_node"]}
    with Composition(parse_scene(scene, "standing"), context, namespace):
        yield node
    node.stop()


def states_of(process: Process) -> list[dict[str, Any]]:
    return [json.loads(line) for line in process.out]


def test_the_client_reports_startcharging_as_vda5050_requires(
    docking: MockDocking, namespace: str, start: Callable[..., Process]
) -> None:
    here = ("--ros-args", "-r", f"__ns:=/{namespace}")
    client = start(sys.executable, str(CLIENT), "1", *here)
    assert client.end() == 0, (client.out, client.err)
    states = states_of(client)
    statuses = [state["actionStatus"] for state in states]
    assert list(dict.fromkeys(statuses)) == ["WAITING", "RUNNING", "FINISHED"]
    for state in states:
        assert not state["batteryState.charging"] or state["actionStatus"] == "FINISHED"
        assert state["errors"] == []
    assert any(state["batteryState.charging"] for state in states)
    assert not states[-1]["batteryState.charging"]

    client = start(sys.executable, str(CLIENT), "0", *here)
    client.wait_for_line('"batteryState.charging": true', client.out)
    assert client.end(signal.SIGINT) == 1
    last = states_of(client)[-1]
    assert (last["actionStatus"], last["batteryState.charging"]) == ("FINISHED", False)
    assert [error["errorType"] for error in last["errors"]] == ["CANCELED"]
    assert not docking.docked
    assert docking.undockings == 2
