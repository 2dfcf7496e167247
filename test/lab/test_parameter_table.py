# SPDX-License-Identifier: Apache-2.0
"""The page of parameters matches the nodes' declarations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deltacharger_core.parameters import declared
from deltacharger_lab.pages.parameters import document, every_node
from deltacharger_scenes.node_table import NODES
from deltacharger_scenes.parameter_check import tables

pytestmark = pytest.mark.ros


def test_the_page_matches_the_nodes_declarations(context: Any, namespace: str) -> None:
    pytest.importorskip("cv2", reason="electrode_detector_node needs deltacharger[vision]")
    pytest.importorskip("mcap", reason="docking_recorder_node needs deltacharger[record]")
    page = Path(__file__).parents[2] / "docs" / "parameters.md"
    with every_node(context, namespace) as nodes:
        assert page.read_text(encoding="utf-8") == document(nodes)
        own = {"use_sim_time", "start_type_description_service"}
        declares = {node.get_name(): set(node._parameters) - own for node in nodes}
    for name in NODES.keys() & declares.keys():
        listed = {each.name for table in tables(name) for each in declared(table)}
        found = {parameter for parameter in declares[name] if not parameter.startswith("qos_overrides.")}
        assert listed == found, f"the table of nodes lists other parameters of {name} than it declares"
