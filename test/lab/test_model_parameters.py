# SPDX-License-Identifier: Apache-2.0
"""The page of parameters matches the declarations of models and campaigns."""

from __future__ import annotations

from pathlib import Path

from deltacharger_lab.campaigns.keys import known_keys
from deltacharger_lab.pages.model_parameters import sections


def test_the_page_matches_the_declarations_of_models_and_campaigns() -> None:
    page = (Path(__file__).parents[2] / "docs" / "parameters.md").read_text(encoding="utf-8")
    assert page.endswith(sections()), "python -m deltacharger_lab.pages.parameters > docs/parameters.md"


def test_every_key_of_a_campaign_has_a_row_with_a_meaning() -> None:
    rows = [row.split(" | ") for row in sections().splitlines() if row.startswith("| ")]
    names = {row[0].removeprefix("| ") for row in rows if row[-1].removesuffix(" |").strip()}
    parts = ("world.", "tactile.", "second.")
    for name in known_keys():
        if not name.startswith("docking."):
            own = name.partition(".")[2] if name.startswith(parts) else name
            assert own in names, name
