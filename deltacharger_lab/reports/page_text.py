# SPDX-License-Identifier: Apache-2.0
"""Markdown of the reports' pages: wrapped prose and tables."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence

_WIDTH = 125


def prose(text: str) -> str:
    """Return text as one paragraph, wrapped between words."""
    return textwrap.fill(" ".join(text.split()), _WIDTH, break_long_words=False, break_on_hyphens=False)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of rows as wide as the head."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)
