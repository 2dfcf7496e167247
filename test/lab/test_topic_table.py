# SPDX-License-Identifier: Apache-2.0
"""The page of topics and the policies match the nodes, and the page matches the interface files."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from deltacharger_lab.pages import policies
from deltacharger_lab.pages.interface_text import Interface, read
from deltacharger_lab.pages.parameters import every_node
from deltacharger_lab.pages.topics import document

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
FILES = sorted(path for folder in ("msg", "srv", "action") for path in (ROOT / folder).glob(f"*.{folder}"))


def test_page_and_policies_match_the_nodes(context: Any, namespace: str) -> None:
    pytest.importorskip("cv2", reason="electrode_detector_node needs deltacharger[vision]")
    committed = (ROOT / "docs" / "topics.md").read_text(encoding="utf-8")
    if "nav2_msgs/" in committed:
        pytest.importorskip("nav2_msgs.action", reason="mission_node drives only where Nav2's messages are installed")
    with every_node(context, namespace) as nodes:
        found, allowed = document(nodes), policies.documents(nodes)
    assert committed == found, "python -m deltacharger_lab.pages.topics > docs/topics.md"
    granted = {path.name: path.read_text(encoding="utf-8") for path in policies.FOLDER.iterdir()}
    assert granted == allowed, "python -m deltacharger_lab.pages.policies"


@pytest.mark.parametrize(
    ("grant", "name", "who"),
    [
        ("topics[@publish]/topic", "joint_trajectory", {"docking_node", "workshop", "recording_player_node"}),
        ("topics[@publish]/topic", "charger_power", {"tactile_node", "recording_player_node"}),
        ("services[@request]/service", "set_contactor", {"docking_node", "servo_node", "workshop"}),
        ("services[@request]/service", "docking_node/get_parameters", {"docking_recorder_node", "fleet", "workshop"}),
        ("services[@request]/service", "misalignment_node/set_parameters", {"workshop"}),
        ("services[@request]/service", "docking_node/set_parameters_atomically", {"workshop"}),
        ("topics[@publish]/topic", "battery", {"tactile_node"}),
        ("topics[@subscribe]/topic", "target_battery", {"fleet", "workshop"}),
        ("services[@request]/service", "set_torque", {"docking_node", "workshop"}),
        ("services[@reply]/service", "predict_misalignment", {"misalignment_node"}),
        ("actions[@execute]/action", "dock", {"docking_node"}),
        ("actions[@call]/action", "dock", {"mission_node", "fleet", "workshop"}),
    ],
)
def test_a_policy_allows_exactly_what_is_needed(grant: str, name: str, who: set[str]) -> None:
    profiles = {path.stem: ElementTree.parse(path) for path in policies.FOLDER.glob("*.xml")}
    granted = {each for each, tree in profiles.items() if name in {item.text for item in tree.findall(grant)}}
    assert granted == who


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_is_read_as_the_generator_of_code_reads_it(path: Path) -> None:
    """rosidl's own Python classes have the same fields and constants, part by part."""
    import importlib

    interface = read(path)
    kind = getattr(importlib.import_module(f"deltacharger.{path.suffix[1:]}"), path.stem, None)
    if kind is None:
        pytest.fail(f"{path.name} is not built; install the package again")
    for part in interface.parts:
        generated = getattr(kind, part.name) if part.name else kind
        assert [each.name for each in part.fields] == list(generated.get_fields_and_field_types()), part.name
        for constant in part.constants:
            name, value = constant.split()
            assert getattr(generated, name) == int(value)


def test_a_comment_may_continue_on_the_next_line(tmp_path: Path) -> None:
    file = tmp_path / "Twice.msg"
    file.write_text(
        "# What it is.\n# And more.\n\nfloat64 x 1.5   # m along x,\n                # of end_effector\nuint8 A=3\n"
    )
    interface = read(file)
    assert interface.text == "What it is. And more."
    (field,) = interface.parts[0].fields
    assert (field.name, field.type, field.default) == ("x", "float64", "1.5")
    assert field.text == "m along x, of end_effector"
    assert interface.parts[0].constants == ["A 3"]


@pytest.mark.parametrize("text", ["float64\n", "float64 x\n---\nfloat64 y\n"], ids=["no name", "a part too many"])
def test_invalid_interface_files_are_refused(tmp_path: Path, text: str) -> None:
    def read_it() -> Interface:
        file = tmp_path / "Odd.msg"
        file.write_text(text)
        return read(file)

    with pytest.raises(ValueError, match=r"Odd\.msg"):
        read_it()
