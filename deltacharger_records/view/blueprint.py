# SPDX-License-Identifier: Apache-2.0
"""Screen layout of a view."""

from __future__ import annotations

from typing import Any

from deltacharger_records.view.log import RUN
from deltacharger_records.view.pictures import FULL

_EYE = (0.25, 0.14, 0.215)  # m in charger_base: from its left, above and beside the target
_LOOK = (0.0, 0.0, -0.02)
_SCALE = f"0–{FULL:.0f} N"


def blueprint(live: bool) -> Any:
    """Return the layout as a rerun.blueprint.Blueprint.

    Args:
        live: follow new data; False = play from the beginning.
    """
    import rerun.blueprint as rrb
    from rerun.blueprint.encodings import TextLogColumn, TextLogColumnKind

    kinds = TextLogColumnKind
    columns = rrb.TextLogColumns(text_log_columns=[TextLogColumn(kinds.LogLevel), TextLogColumn(kinds.Body)])
    left = rrb.Vertical(
        rrb.Spatial3DView(
            origin="charger",
            name="charger",
            background=(236, 240, 244),
            line_grid=False,
            eye_controls=rrb.EyeControls3D(position=_EYE, look_target=_LOOK, eye_up=(0.0, 1.0, 0.0)),
        ),
        rrb.StateTimelineView(origin="state", name="states"),
        rrb.TextLogView(origin="log", name="decisions", columns=columns),
        row_shares=(3.0, 1.15, 1.3),
    )
    touch = rrb.Horizontal(
        rrb.Spatial2DView(origin="pads/left", name=f"left pad, {_SCALE}"),
        rrb.Spatial2DView(origin="pads/right", name=f"right pad, {_SCALE}"),
        rrb.Tabs(
            rrb.Spatial2DView(origin="camera/detection", name="electrodes found"),
            rrb.Spatial2DView(origin="camera/color", name="camera"),
            rrb.TextDocumentView(origin="status", name="status"),
        ),
        column_shares=(1.0, 1.0, 1.3),
    )
    right = rrb.Vertical(
        touch,
        rrb.Horizontal(
            _plot("plots/contact", "contact current, 0.4–0.5 A", (-0.2, 0.8)), _plot("plots/servos", "servo currents")
        ),
        rrb.Horizontal(
            _plot("plots/misalignment", "misalignment ± σ", (-15.0, 15.0)),
            _plot("plots/angle", "angle ± σ", (-15.0, 15.0)),
        ),
        rrb.Horizontal(
            _plot("plots/height", "z"),
            rrb.Tabs(
                _plot("plots/charge/current", "charge current"),
                _plot("plots/charge/voltages", "voltages"),
                _plot("plots/energy", "energy"),
                _plot("plots/pads", "pad forces"),
            ),
        ),
        row_shares=(1.2, 1.0, 1.0, 1.0),
    )
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=(1.0, 1.15)),
        rrb.TimePanel(timeline=RUN, state="collapsed", play_state="following" if live else "playing"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _plot(origin: str, name: str, span: tuple[float, float] | None = None) -> Any:
    import rerun.blueprint as rrb

    axis = None if span is None else rrb.ScalarAxis(range=span)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis, plot_legend=rrb.Corner2D.LeftTop)
