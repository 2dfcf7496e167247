# SPDX-License-Identifier: Apache-2.0
"""launch/view.launch.py publishes the xacro's model, with the given files."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.geometry_file import save_geometry

launch = pytest.importorskip("launch", reason="launch comes with a ROS installation, not from PyPI")
pytest.importorskip("launch_ros", reason="launch_ros comes with a ROS installation, not from PyPI")
pytest.importorskip("xacro", reason="`pip install xacro`, or a ROS installation")

FILE = Path(__file__).resolve().parents[2] / "launch" / "view.launch.py"


def wired(argv: list[str] | None = None, **arguments: str) -> list[Any]:
    spec = importlib.util.spec_from_file_location("view_launch", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    context = launch.LaunchContext(argv=argv)
    for argument in module.generate_launch_description().get_launch_arguments():
        default = "".join(part.perform(context) for part in argument.default_value)
        context.launch_configurations[argument.name] = arguments.get(argument.name, default)
    found: list[Any] = module._wire(context)
    return found


def test_rviz_starts_unless_disabled(tmp_path: Path) -> None:
    names = [node.node_executable for node in wired()]
    assert names == ["robot_state_publisher", "passive_joints_node", "rviz2"]
    assert [node.node_executable for node in wired(rviz="false")] == names[:2]


def text_of(node: Any) -> str:
    """Return the parameters of a node."""
    return str([getattr(value, "value", value) for value in node._Node__parameters[0].values()])


@pytest.mark.parametrize("argument", ["geometry_file", "mount_file"])
def test_an_unreadable_file_is_reported_in_one_line(argument: str, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.yaml"
    for noun in ("No such file", "armm"):
        with pytest.raises(ValueError, match=rf"^{argument}: .*{wrong}.*{noun}[^\n]*$"):
            wired(**{argument: str(wrong)})
        wrong.write_text("armm: 0.1\n", encoding="utf-8")


def test_a_misspelt_argument_is_refused_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["ros2", "launch", str(FILE), "geometri_file:=arm.yaml"])
    with pytest.raises(ValueError, match="'geometri_file'"):
        wired(argv=["geometri_file:=arm.yaml"])


@pytest.mark.parametrize(
    ("argument", "prefix", "link", "joint"),
    [
        ("joint_prefix", "left_", "charger_base", "left_limb_0"),
        ("frame_prefix", "l/", "l/charger_base", "limb_0"),
    ],
)
def test_a_prefix_reaches_the_model_and_its_joint_states(argument: str, prefix: str, link: str, joint: str) -> None:
    publisher, joints, _ = wired(**{argument: prefix})
    assert f'link name="{link}"' in text_of(publisher)
    assert f'joint name="{joint}_arm_joint"' in text_of(publisher)
    parameters = {"".join(part.text for part in key): value for key, value in joints._Node__parameters[0].items()}
    assert yaml.safe_load("".join(part.text for part in parameters[argument])) == prefix


def test_a_calibrated_geometry_reaches_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_geometry(DeltaGeometry(arm=0.1234), tmp_path / "arm.yaml")
    monkeypatch.chdir(tmp_path)  # base of relative paths
    for file in (str(tmp_path / "arm.yaml"), "arm.yaml"):
        assert "0.1234" in text_of(wired(geometry_file=file)[0])
