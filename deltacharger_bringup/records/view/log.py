# SPDX-License-Identifier: Apache-2.0
"""Log plain values as Rerun entities; defines each entity's content, unit and colours, and the layout of the screen.

Every value is logged on two timelines: `run`, s since the first message, and `clock`, the time of day.
"""

import math
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_bringup.records.replay.picture import BAND, BLUE, GREEN, ORANGE, PURPLE, RED
from deltacharger_bringup.records.view import shapes as view_scene
from deltacharger_bringup.records.view.shapes import FULL, Boxes
from deltacharger_kinematics.geometry import DeltaGeometry

RUN, CLOCK = "run", "clock"
_TRAIL = 400  # points
_TRAIL_STEP = 0.0005  # m between two of them
_STILL = 2e-4  # rad; smaller changes are noise: an encoder's step is 1.5e-3
_JPEG = 80
_GREY = "#8a94a0"
_SERIES: dict[str, tuple[tuple[str, ...], tuple[str, ...], tuple[float, ...]]] = {
    "plots/height": (("z, mm",), (BLUE,), (2.0,)),
    "plots/contact/measured": (("servo_state, A",), (ORANGE,), (1.2,)),
    "plots/contact/reported": (("reported, A",), (RED,), (2.2,)),
    "plots/contact/band": (("0.4 A", "0.5 A"), (GREEN, GREEN), (1.5, 1.5)),
    "plots/servos": (("limb 0, A", "limb 1, A", "limb 2, A"), (BLUE, ORANGE, PURPLE), (1.2, 1.2, 1.2)),
    "plots/misalignment/horizontal": (("horizontal, mm", "− σ", "+ σ"), (BLUE,) * 3, (2.0, 0.7, 0.7)),
    "plots/misalignment/vertical": (("vertical, mm", "− σ", "+ σ"), (ORANGE,) * 3, (2.0, 0.7, 0.7)),
    "plots/angle": (("angle, °", "− σ", "+ σ"), (PURPLE,) * 3, (2.0, 0.7, 0.7)),
    "plots/pads": (("left pad, N", "right pad, N"), (PURPLE, RED), (1.5, 1.5)),
    "plots/charge/current": (("charge current, A",), (GREEN,), (2.2,)),
    "plots/charge/voltages": (("target, V", "battery, V"), (BLUE, _GREY), (1.5, 1.5)),
    "plots/energy": (("energy, J",), (GREEN,), (2.0,)),
}
_STATES = {
    "idle": 0x8A94A0FF, "locate": 0x5B7DB1FF, "approach": 0x3F8FD2FF, "back_off": 0xD98A4AFF, "contact": 0xE0B13CFF,
    "measure": 0x9A78D0FF, "align": 0x3FA796FF, "energise": 0xE06C8AFF, "charging": 0x3DA35DFF, "retract": 0xA5886BFF,
}  # fmt: skip
_LANES = {"docking": "state/1_docking", "docked": "state/2_docked", "contactor": "state/3_contactor"}
_EYE = (0.25, 0.14, 0.215)  # m in charger_base: from its left, above and beside the target
_LOOK = (0.0, 0.0, -0.02)
_SCALE = f"0–{FULL:.0f} N"
_LEVELS = {"refused": "ERROR", "interrupted": "ERROR", "stuck": "ERROR", "blind": "WARN", "again": "WARN"}


class ViewLog:
    """Writes entities to a Rerun recording.

    Args:
        rr: the module rerun.
        recording: a rerun.RecordingStream.
        geometry: of the arm.
        camera: (4, 4) camera_color_optical_frame in charger_base.
    """

    def __init__(self, rr: Any, recording: Any, geometry: DeltaGeometry, camera: NDArray[np.float64]) -> None:
        self._rr = rr
        self._recording = recording
        self._geometry = geometry
        self._begin: int | None = None
        self._second: int | None = None
        self._band_due = True
        self._angles: NDArray[np.float64] | None = None
        self._trail: deque[tuple[float, float, float]] = deque(maxlen=_TRAIL)
        self._pads: dict[str, bytes] = {}
        self._states: dict[str, str] = {}
        self._still(camera)

    def at(self, time_ns: int) -> None:
        """Set the time of the following values, ns since 1970."""
        if self._begin is None:
            self._begin = time_ns
        second = time_ns // 10**9
        self._band_due |= second != self._second
        self._second = second
        self._recording.set_time(RUN, duration=1e-9 * (time_ns - self._begin))
        self._recording.set_time(CLOCK, timestamp=np.datetime64(time_ns, "ns"))

    def arm(self, angles: Sequence[float], position: Sequence[float]) -> None:
        """Show the mechanism at arm angles (rad) and position (m in charger_base), if it moved."""
        self._scalars("plots/height", 1e3 * position[2])
        now = np.asarray(angles, dtype=float)
        if self._angles is not None and np.abs(now - self._angles).max() < _STILL:
            return
        self._angles = now
        arms, rods = view_scene.moving(self._geometry, angles, position)
        rr = self._rr
        self._log("charger/arms", rr.LineStrips3D(arms, radii=view_scene.ARM_RADIUS, colors=view_scene.ORANGE))
        self._log("charger/rods", rr.LineStrips3D(rods, radii=view_scene.ROD_RADIUS, colors=view_scene.ALUMINIUM))
        self._log("charger/platform", rr.Transform3D(translation=list(position)))
        if not self._trail or math.dist(self._trail[-1], position) >= _TRAIL_STEP:
            self._trail.append((position[0], position[1], position[2]))
            trail = rr.LineStrips3D([list(self._trail)], radii=0.0006, colors=view_scene.TRAIL)
            self._log("charger/trail", trail)

    def contact(self, current: float, servos: Sequence[float]) -> None:
        """Show contact current (A) from servo_state, its band, and the servos' currents (A)."""
        self._scalars("plots/contact/measured", current)
        if self._band_due:  # straight lines need few points
            self._band_due = False
            self._scalars("plots/contact/band", *BAND)
        self._scalars("plots/servos", *servos)

    def reported(self, current: float) -> None:
        """Show docking_node's contact current, A."""
        self._scalars("plots/contact/reported", current)

    def pads(self, left: NDArray[np.uint8], right: NDArray[np.uint8], forces: tuple[float, float]) -> None:
        """Show changed pads as pictures, and their total forces (N)."""
        for name, picture in (("left", left), ("right", right)):
            pixels = picture.tobytes()
            if self._pads.get(name) != pixels:
                self._pads[name] = pixels
                self._log(f"pads/{name}", self._rr.Image(picture))
        self._scalars("plots/pads", *forces)

    def misalignment(self, values: Mapping[str, tuple[float, float]]) -> None:
        """Show horizontal and vertical (m) and angle (rad), each with its standard deviation; NaN = not measured."""
        for name, scale in (("horizontal", 1e3), ("vertical", 1e3), ("angle", math.degrees(1.0))):
            value, sigma = (scale * number for number in values[name])
            where = "plots/angle" if name == "angle" else f"plots/misalignment/{name}"
            self._scalars(where, value, value - sigma, value + sigma)

    def power(self, current: float, target: float, battery: float, energy: float) -> None:
        """Show charge current (A), voltages (V) and energy since the docking began (J)."""
        self._scalars("plots/charge/current", current)
        self._scalars("plots/charge/voltages", target, battery)
        self._scalars("plots/energy", energy)

    def state(self, name: str, value: str) -> bool:
        """Show a state named `docking`, `contactor` or `docked`; return whether it changed."""
        if self._states.get(name) == value:
            return False
        self._states[name] = value
        self._log(_LANES[name], self._rr.StateChange(state=value))
        return True

    def line(self, text: str, kind: str = "", level: str = "") -> None:
        """Append a line to the log; its level depends on the kind of decision unless given."""
        self._log("log", self._rr.TextLog(text, level=level or _LEVELS.get(kind, "INFO")))

    def status(self, text: str) -> None:
        """Show a page of Markdown."""
        self._log("status", self._rr.TextDocument(text, media_type="text/markdown"))

    def target(self, name: str, position: Sequence[float], roll: float) -> None:
        """Show the target as `given` or `seen`: midpoint of its electrodes (m in charger_base) and roll (rad)."""
        colour = view_scene.GIVEN if name == "given" else view_scene.SEEN
        turn = self._rr.RotationAxisAngle(axis=(0.0, 0.0, 1.0), angle=self._rr.Angle(rad=roll))
        self._log(f"charger/target/{name}", self._rr.Transform3D(translation=list(position), rotation=turn))
        self._boxes(f"charger/target/{name}/terminal", view_scene.target(colour), lines=True)

    def picture(self, name: str, pixels: NDArray[np.uint8]) -> None:
        """Show a camera image (H, W, 3) RGB or (H, W): `detection`, annotated by the detector, or `color`."""
        self._log(f"camera/{name}", self._rr.Image(pixels).compress(jpeg_quality=_JPEG))

    def _still(self, camera: NDArray[np.float64]) -> None:
        """Log static entities."""
        rr = self._rr
        self._log("charger", rr.ViewCoordinates.LUF, static=True)
        self._boxes("charger/base", view_scene.base(self._geometry), static=True)
        ring = rr.LineStrips3D([view_scene.ring(self._geometry)], radii=0.004, colors=view_scene.ORANGE)
        self._log("charger/base/ring", ring, static=True)
        self._boxes("charger/platform/body", view_scene.platform(self._geometry), static=True)
        pose = rr.Transform3D(translation=camera[:3, 3], mat3x3=camera[:3, :3])
        self._log("charger/camera", pose, static=True)
        self._boxes("charger/camera/body", view_scene.camera(), static=True)
        for entity, (names, colors, widths) in _SERIES.items():
            lines = rr.SeriesLines(names=list(names), colors=[_rgb(each) for each in colors], widths=list(widths))
            self._log(entity, lines, static=True)
        labels = [name.replace("_", " ") for name in _STATES]
        states = rr.StateConfiguration(values=list(_STATES), labels=labels, colors=list(_STATES.values()))
        self._log(_LANES["docking"], states, static=True)
        self._switch("contactor", "open", "closed", 0xE05A4AFF)
        self._switch("docked", "no", "docked", 0x3DA35DFF)

    def _switch(self, name: str, off: str, on: str, colour: int) -> None:
        switch = self._rr.StateConfiguration(
            values=[off, on], labels=[f"{name}: {off}", on], colors=[0x59616BFF, colour]
        )
        self._log(_LANES[name], switch, static=True)

    def _boxes(self, entity: str, boxes: Boxes, static: bool = False, lines: bool = False) -> None:
        mode = self._rr.components.FillMode
        shapes = self._rr.Boxes3D(
            centers=boxes.centres,
            sizes=boxes.sizes,
            quaternions=[self._rr.Quaternion(xyzw=turn) for turn in boxes.turns],
            colors=boxes.colours,
            fill_mode=mode.MajorWireframe if lines else mode.Solid,
        )
        self._log(entity, shapes, static=static)

    def _scalars(self, entity: str, *values: float) -> None:
        self._log(entity, self._rr.Scalars(values))

    def _log(self, entity: str, what: Any, static: bool = False) -> None:
        self._recording.log(entity, what, static=static)


def _rgb(text: str) -> tuple[int, int, int]:
    return int(text[1:3], 16), int(text[3:5], 16), int(text[5:7], 16)


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
