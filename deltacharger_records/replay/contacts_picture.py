# SPDX-License-Identifier: Apache-2.0
"""Map of contacts: the target's measured offset at each one, and the limits for resting."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from deltacharger_records.plotting import BLUE, FAINT, GREEN
from deltacharger_records.replay.run_record import Run, Touch

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEAST = 5.0  # mm, smallest half width of the map
_SPARE = 1.2  # mm of margin


def draw_contacts(axes: Axes, run: Run) -> None:
    """Draw the target's offset at each contact with one standard deviation, numbered in order.

    Seen along +z at the target, as for the pads: +x to the left, +y up. Each contact's last measurement counts: it was
    made after the holding currents were reduced.
    """
    axes.set_title("target offset at each contact, mm", pad=4)
    axes.axhline(0.0, color="#9aa5b1", linewidth=0.8, zorder=1)
    axes.axvline(0.0, color="#9aa5b1", linewidth=0.8, zorder=1)
    touches = _one_each(run)
    _limits(axes, run)
    places = [(1e3 * touch.horizontal, 1e3 * touch.vertical) for touch in touches]
    axes.plot(*zip(*places, strict=True) if places else ((), ()), color=BLUE, linewidth=0.8, alpha=0.5, zorder=2)
    for touch, (x, y) in zip(touches, places, strict=True):
        last = touch is touches[-1]
        colour = GREEN if last and run.outcome is not None and run.outcome.success else BLUE
        axes.errorbar(
            x, y, 1e3 * touch.vertical_stddev, 1e3 * touch.horizontal_stddev,
            color=colour, marker="o" if touch.sure else "x", markersize=5, elinewidth=0.9, zorder=3,
        )  # fmt: skip
        axes.annotate(
            str(touch.contact), (x, y), xytext=(5, 4), textcoords="offset points", fontsize=8.5,
            fontweight="bold" if last else "normal", color=colour,
        )  # fmt: skip
    reach = max([_LEAST, *(max(abs(x), abs(y)) + _SPARE for x, y in places)])
    axes.set_xlim(reach, -reach)
    axes.set_ylim(-reach, reach)
    axes.set_aspect("equal")
    axes.tick_params(length=2, labelsize=7.5)


def _one_each(run: Run) -> list[Touch]:
    """Return the last complete measurement of each contact."""
    known = [touch for touch in run.touches if math.isfinite(touch.horizontal) and math.isfinite(touch.vertical)]
    return list({touch.contact or index: touch for index, touch in enumerate(known, 1)}.values())


def _limits(axes: Axes, run: Run) -> None:
    from matplotlib.patches import Rectangle

    if run.limits is None:
        return
    x, y = (1e3 * limit for limit in run.limits)
    area: Any = Rectangle((-x, -y), 2 * x, 2 * y, color=GREEN, alpha=0.14, linewidth=0, zorder=0.5)
    axes.add_patch(area)
    axes.annotate(
        f"±{x:g} × ±{y:g}", (-x, -y), xytext=(-2, 3), textcoords="offset points", fontsize=7, ha="right", color=FAINT
    )
