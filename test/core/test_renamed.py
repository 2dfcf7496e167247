# SPDX-License-Identifier: Apache-2.0
"""A name of an earlier version is refused by the name that replaces it, wherever it stands."""

from __future__ import annotations

import dataclasses
import re

import pytest

from deltacharger_core.parameters import ParameterError, from_mapping
from deltacharger_core.renamed import RENAMED
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.keys import known_keys
from deltacharger_lab.campaigns.scene import packaged_campaigns, parse_campaign_scene

PARAMETERS = {each.name for each in dataclasses.fields(DockingParameters)}


def test_what_replaces_a_name_exists_and_the_name_does_not() -> None:
    known = PARAMETERS | set(packaged_campaigns()) | {each.split(".")[0] for each in known_keys()}
    for old, new in RENAMED.items():
        assert old not in known
        assert set(new.split(" and ")) <= known


@pytest.mark.parametrize("old", sorted(set(RENAMED) - {"unmeasured"}))
def test_an_old_parameter_is_refused_by_the_new_name(old: str) -> None:
    new = re.escape(RENAMED[old])
    with pytest.raises(ParameterError, match=new):
        from_mapping({old: 1.0}, DockingParameters)
    with pytest.raises(ParameterError, match=new):
        parse_campaign_scene({"docking": {old: 1.0}}, "mine")


def test_an_old_key_of_a_campaign_is_refused_by_the_new_name() -> None:
    with pytest.raises(ParameterError, match="it is assumed"):
        parse_campaign_scene({"told": {"servo_stiffness": 2.0}}, "mine")


def test_a_campaign_based_on_an_old_one_is_refused_by_the_new_name() -> None:
    with pytest.raises(ParameterError, match="assumed_stiffness"):
        parse_campaign_scene({"based_on": "unmeasured"}, "mine")
