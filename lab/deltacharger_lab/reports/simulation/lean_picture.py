# SPDX-License-Identifier: Apache-2.0
"""Picture of the remaining lean at rest."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from deltacharger_lab.plotting import picture
from deltacharger_lab.reports.formats import tens
from deltacharger_lab.reports.simulation.lean import COMPLIANCES, CONTACTS, TARGET_STEP
from deltacharger_lab.reports.simulation.plan import MUJOCO
from deltacharger_lab.reports.simulation.scenes import LIGHT
from deltacharger_records.plotting import BLUE, FAINT, GREEN, ORANGE, PURPLE

_COLOURS = dict(zip(COMPLIANCES, (FAINT, BLUE, GREEN, PURPLE), strict=True))


def remaining_yaw(results: dict[str, Any], path: Path) -> None:
    """Draw the yaw and the left pad's share at rest over the target's yaw, with the reference's cases."""
    about = "docked, without friction of the gears; lines: light model at 10 ms, by compliance in rad/(N·m)"
    model = MUJOCO if MUJOCO in results["models"] else LIGHT
    marks = f"{model}, {1000.0 * results['lean'][0]['finest']:g} ms"
    with picture(path, 10.0, 6.6, "Remaining yaw at rest", about) as figure:
        for column, contact in enumerate(CONTACTS):
            top, bottom = figure.add_subplot(2, 2, column + 1), figure.add_subplot(2, 2, column + 3)
            for line in (row for row in results["lean_remains"] if row["contact"] == contact):
                yaws = [point["yaw"] for point in line["yaws"]]
                colour = _COLOURS[line["compliance"]]
                for axes, key, scale in ((top, "rest", 1.0), (bottom, "share", 100.0)):
                    values = [scale * point[key] for point in line["yaws"]]
                    axes.plot(yaws, values, color=colour, linewidth=1.5, label=f"{line['compliance']:g}")
            for row in results["lean"]:
                if row["contact"] == contact and row["pitch"] == 0.0 and row["step"] == TARGET_STEP:
                    known = row["reference"]
                    rest = row["yaw"] - math.degrees(known["tilt"][1])
                    for axes, value in ((top, rest), (bottom, 100.0 * known["share"])):
                        axes.plot(row["yaw"], value, "o", color=ORANGE, markersize=4)
            top.plot([], [], "o", color=ORANGE, markersize=4, label=marks)
            top.set(title=f"{tens(contact)} N/m per electrode", ylabel="yaw at rest, °" if not column else "")
            bottom.set(xlabel="yaw of the target, °", ylabel="force on the left pad, %" if not column else "")
            if not column:
                top.legend(fontsize=8, loc="upper left")
