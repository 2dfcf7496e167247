# SPDX-License-Identifier: Apache-2.0
"""Common style of all pictures: white paper, grey frames, few colours.

The five colours stay distinct for colour-blind readers, by a test.
"""

from __future__ import annotations

from typing import Any

INK, FAINT, PAPER = "#22303c", "#51606e", "#f6f7f8"
BLUE, ORANGE, GREEN, PURPLE, RED = "#1a70e8", "#df8712", "#14b377", "#5c1d8c", "#981018"
STYLE: Any = {
    "font.size": 9.0,
    "axes.edgecolor": "#9aa5b1",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10.0,
    "axes.facecolor": PAPER,
    "axes.axisbelow": True,
}
BAND = (0.4, 0.5)
"""Contact current (A) that the paper holds at the dock."""
