# SPDX-License-Identifier: Apache-2.0
"""Generated pages and policies: they are complete. CI generates them and compares them with the committed ones."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from deltacharger_core.parameters import declared
from deltacharger_lab.campaigns.keys import known_keys
from deltacharger_lab.pages import parameters

ROOT = Path(__file__).parents[2]


@pytest.mark.ros
@pytest.mark.rest
def test_the_table_of_nodes_lists_the_parameters_that_they_declare(context: Any, namespace: str) -> None:
    for library, what in (("cv2", "electrode_detector_node needs deltacharger[vision]"), ("mcap", "record")):
        pytest.importorskip(library, reason=what)
    from deltacharger_bringup.scenes.node_table import NODES
    from deltacharger_bringup.scenes.scene import tables
    from deltacharger_lab.pages import parameters, policies, topics

    with parameters.every_node(context, namespace) as nodes:
        written = parameters.document(nodes), topics.document(nodes), *policies.documents(nodes).values()
        declares = {node.get_name(): set(node._parameters) for node in nodes}
    assert all(written)
    own = {"use_sim_time", "start_type_description_service"}
    for name in NODES.keys() & declares.keys():
        listed = {each.name for table in tables(name) for each in declared(table)}
        found = {each for each in declares[name] - own if not each.startswith("qos_overrides.")}
        assert listed == found, f"the table of nodes lists other parameters of {name} than it declares"


def test_every_key_of_a_campaign_has_a_row_with_a_meaning() -> None:
    rows = [row.split(" | ") for row in parameters.sections().splitlines() if row.startswith("| ")]
    names = {row[0].removeprefix("| ") for row in rows if row[-1].removesuffix(" |").strip()}
    parts = ("world.", "tactile.", "second.")
    keys = {name.partition(".")[2] if name.startswith(parts) else name for name in known_keys()}
    assert {key for key in keys if not key.startswith(("docking.", "profile."))} <= names  # nodes' own parameters


@pytest.mark.parametrize(
    ("grant", "name", "who"),
    [
        ("topics[@publish]/topic", "joint_trajectory", "docking_node workshop"),
        ("topics[@publish]/topic", "charger_power", "tactile_node"),
        ("services[@request]/service", "set_contactor", "docking_node servo_node workshop"),
        ("services[@request]/service", "docking_node/get_parameters", "docking_recorder_node fleet workshop"),
        ("services[@request]/service", "docking_node/set_parameters", "workshop"),
        ("actions[@call]/action", "dock", "mission_node fleet workshop"),
    ],
)
def test_a_policy_allows_exactly_what_is_needed(grant: str, name: str, who: str) -> None:
    profiles = {path.stem: ElementTree.parse(path) for path in (ROOT / "config" / "security").glob("*.xml")}
    granted = {each for each, tree in profiles.items() if name in {item.text for item in tree.findall(grant)}}
    assert granted == set(who.split())
