# SPDX-License-Identifier: Apache-2.0
"""The table of what is watched, in docs/docking.md: python -m deltacharger_lab.pages.watches docs/docking.md."""

from __future__ import annotations

import sys
from pathlib import Path

from deltacharger_docking.codes import State
from deltacharger_docking.watch import WATCHES

PHASES = tuple(state for state in sorted(State) if state is not State.BACK_OFF)  # which docking never enters
BEGIN, END = "<!-- watches: written by make pages -->\n", "<!-- watches end -->\n"


def table() -> str:
    """Return the rows of each sense: in which phases who notices, in what time, with which codes."""
    lines = ["| what | phases | who | within | codes |", "|---|---|---|---|---|"]
    for row in sorted(WATCHES, key=lambda each: each.sense):
        codes = ", ".join(str(int(code)) for code in row.codes)
        lines.append(f"| {row.sense} | {_phases(row.phases)} | {row.who} | {row.within} | {codes} |")
    return "\n".join(lines) + "\n"


def _phases(phases: tuple[State, ...]) -> str:
    if {*PHASES} == {*phases}:
        return "all"
    return ", ".join("docked" if state is State.IDLE else state.name for state in PHASES if state in phases)


if __name__ == "__main__":
    page = Path(sys.argv[1])
    head, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    page.write_text(f"{head}{BEGIN}{table()}{END}{rest.partition(END)[2]}", encoding="utf-8")
