# SPDX-License-Identifier: Apache-2.0
"""The remedy for each error in the code is the beginning of the one in docs/errors.md."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from deltacharger_docking.codes import REMEDIES, Code

PAGE = Path(__file__).resolve().parents[2] / "docs" / "errors.md"
ROWS = re.findall(r"^\| (\d+) \| (\w+) \|[^|]*\|[^|]*\| ?([^|]*?) ?\|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
TEXTS = {(Code(int(number)), name): text for number, name, text in ROWS if int(number) in set(Code)}


def test_the_page_holds_every_code() -> None:
    assert set(TEXTS) == {(code, code.name) for code in Code}


@pytest.mark.parametrize("code", Code)
def test_the_page_begins_with_the_remedy(code: Code) -> None:
    text = TEXTS[code, code.name]
    assert text.startswith(REMEDIES[code])
    assert bool(text) == bool(REMEDIES[code])
