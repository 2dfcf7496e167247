# SPDX-License-Identifier: Apache-2.0
"""One look for the pictures of all reports, that of the docking picture: white paper, grey frames, few colours.

Blue, orange, green and purple keep apart for colour-blind eyes in this order of use; maps use viridis.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, PAPER = "#22303c", "#51606e", "#f6f7f8"
BLUE, ORANGE, GREEN, PURPLE, RED = "#1f6fb4", "#d9762b", "#2e9e5b", "#7a52a8", "#c8324b"
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


@contextmanager
def picture(path: Path, width: float, height: float, title: str, about: str) -> Iterator[Figure]:
    """Give a figure of `width` × `height` inches with a title to draw on and write it to `path` afterwards.

    Raises:
        ImportError: matplotlib is missing.
        OSError: the file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(STYLE):
        figure = Figure(figsize=(width, height), dpi=120, facecolor="white")
        figure.text(0.4 / width, 1.0 - 0.32 / height, title, fontsize=15, fontweight="bold", va="center")
        figure.text(0.4 / width, 1.0 - 0.60 / height, about, fontsize=9.5, color=FAINT, va="center")
        yield figure
        figure.savefig(path)


def grid(axes: Axes, *, both: bool = True) -> None:
    """Draw white grid lines below everything."""
    axes.grid(axis="both" if both else "y", which="major", color="white", linewidth=1.0, zorder=0.5)
    axes.tick_params(which="both", length=3)


def plain_ticks(axes: Axes) -> None:
    """Write the ticks of a logarithmic y axis as plain numbers, 1, 2 and 5 of each decade."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
