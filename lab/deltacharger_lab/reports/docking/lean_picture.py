# SPDX-License-Identifier: Apache-2.0
"""Picture of the results of dockings over yaw and pitch of the target's faces."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from deltacharger_lab.plotting import Axes, picture, top_legend
from deltacharger_lab.reports.docking.lean import MAP, MOST
from deltacharger_lab.reports.docking.summary import Columns

NAME = "docking-lean.png"
_KINDS = (
    ("charged, called aligned", "o", "#0072b2"),
    ("charged, not called aligned", "o", "#56b4e9"),
    ("LEANING", "X", "#e69f00"),
    ("another code", "D", "#222222"),
)
"""Colours of Okabe and Ito, which colour-blind people can distinguish."""
_LARGEST = 5000  # marks of a panel


def outcomes(results: dict[str, Any], path: Path) -> None:
    """Draw each docking of `MAP` at its yaw and pitch, marked by its result."""
    rows = {name: results["rows"][name] for name in MAP if name in results["rows"]}
    about = "each mark one simulated docking; right: springs of the electrodes of 3e5 N/m instead of 3e4 and 1e5"
    with picture(path, 11.0, 5.9, "Leaning faces: charged and refused dockings", about) as figure:
        panels = figure.subplots(1, len(MAP), sharex=True, sharey=True)
        for axes, name in zip(panels, MAP, strict=True):
            if name in rows:
                _marks(axes, rows[name])
            ends = (-1.04 * MOST, 1.04 * MOST)
            axes.set(title=name if name in rows else f"{name}: not run", aspect="equal", xlim=ends, ylim=ends)
            axes.set_xlabel("yaw of the faces, °")
        panels[0].set_ylabel("pitch of the faces, °")
        handles = [
            panels[0].plot([], [], mark, color=colour, markersize=5, label=what)[0] for what, mark, colour in _KINDS
        ]
        top_legend(figure, handles, 2)


def _marks(axes: Axes, rows: Columns) -> None:
    yaw, pitch = (np.degrees(rows[f"world.target.tilt_{axis}"].astype(float)) for axis in "yx")
    charged, leaning = rows["charged"].astype(bool), rows["code_name"] == "LEANING"
    aligned = rows["aligned"].astype(bool)
    chosen = (charged & aligned, charged & ~aligned, ~charged & leaning, ~charged & ~leaning)
    every = max(1, len(yaw) // _LARGEST)
    size = 4.5 if len(yaw) < 2000 else 2.2
    for kind, (_, mark, colour) in zip(chosen, _KINDS, strict=True):
        index = np.flatnonzero(kind)
        index = index[:: every if mark != "D" else 1]
        axes.plot(yaw[index], pitch[index], mark, color=colour, markersize=size, markeredgewidth=0.0, alpha=0.8)
