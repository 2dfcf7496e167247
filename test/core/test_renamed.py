# SPDX-License-Identifier: Apache-2.0
"""A name of an earlier version is refused by the name that replaces it, wherever it stands."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_core.renamed import RENAMED
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.keys import known_keys
from deltacharger_lab.campaigns.scene import packaged_campaigns, parse_campaign_scene


def test_what_replaces_a_name_exists_and_the_name_does_not() -> None:
    known = {each.name for each in dataclasses.fields(DockingParameters)} | set(packaged_campaigns())
    known |= {each.split(".")[0] for each in known_keys()}
    for old, new in RENAMED.items():
        assert old not in known
        assert set(new.split(" and ")) <= known


@pytest.mark.parametrize(
    ("content", "new"),
    [
        *(({"docking": {old: 1.0}}, RENAMED[old]) for old in sorted(set(RENAMED) - {"unmeasured"})),
        ({"told": {"servo_stiffness": 2.0}}, "assumed"),
        ({"based_on": "unmeasured"}, "assumed_stiffness"),
    ],
)
def test_an_old_name_is_refused_by_the_new_one(content: dict[str, Any], new: str) -> None:
    with pytest.raises(ParameterError, match=new):
        parse_campaign_scene(content, "mine")
    for old in content.get("docking", {}):
        with pytest.raises(ParameterError, match=new):
            from_mapping({old: 1.0}, DockingParameters)
