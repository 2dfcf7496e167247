# SPDX-License-Identifier: Apache-2.0
"""Common style of all reports' pictures: white paper, grey frames, few colours; maps use viridis."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deltacharger_bringup.records.replay.picture import FAINT, STYLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure
else:
    Axes = Any  # matplotlib is loaded with the first picture

_REPORTS: Any = {
    **STYLE,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "grid.color": "white",
    "grid.linewidth": 1.0,
    **{f"{axis}tick.{which}.size": 3.0 for axis in "xy" for which in ("major", "minor")},
    "legend.frameon": False,
    "legend.fontsize": 8.5,
}


@contextmanager
def picture(path: Path, width: float, height: float, title: str, about: str) -> Iterator[Figure]:
    """Yield a figure of `width` × `height` inches with a title, lay it out, and write it to `path`.

    Raises:
        ImportError: matplotlib is missing.
        OSError: the file cannot be written.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import rc_context
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with rc_context(_REPORTS):
        below_title = ConstrainedLayoutEngine(rect=(0.01, 0.01, 0.98, 0.99 - 0.75 / height))
        figure = Figure(figsize=(width, height), dpi=120, facecolor="white", layout=below_title)
        figure.text(0.4 / width, 1.0 - 0.32 / height, title, fontsize=15, fontweight="bold", va="center")
        figure.text(0.4 / width, 1.0 - 0.60 / height, about, fontsize=9.5, color=FAINT, va="center")
        yield figure
        figure.savefig(path)


def top_legend(figure: Figure, handles: list[Any], columns: int = 3) -> None:
    """Show the legend of all panels in the corner beside the title."""
    figure.legend(handles=handles, loc="upper right", bbox_to_anchor=(0.985, 0.995), ncols=columns)


def note(axes: Axes, text: str, at: tuple[float, float], shift: tuple[float, float], **style: Any) -> None:
    """Annotate a point, `shift` typographic points away."""
    axes.annotate(text, at, shift, textcoords="offset points", **{"fontsize": 8.5, "ha": "center", **style})


def plain_ticks(axes: Axes) -> None:
    """Label a logarithmic y axis with plain numbers, 1, 2 and 5 of each decade."""
    from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
