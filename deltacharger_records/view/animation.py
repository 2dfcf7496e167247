# SPDX-License-Identifier: Apache-2.0
"""A docking as an animated picture (GIF): the arm, what the pads measure and the contact current.

It has the same interface as `ViewLog`, so that a `ViewFeed` fills either.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deltacharger_core.arrays import Array
from deltacharger_core.machine import COLUMNS, ROWS
from deltacharger_kinematics.geometry import DeltaGeometry
from deltacharger_records.plotting import BAND, FAINT, GREEN, INK, PAPER, RED, STYLE
from deltacharger_records.view import shapes
from deltacharger_records.view.shapes import Boxes, Color, Picture, pad_picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RATE = 8.0
"""Frames per second."""
_LONGEST = 240  # frames; for longer dockings, only every second, third … moment is drawn
_HOLD = 2.0  # s that the last frame is shown
_COLOURS, _SAMPLED = 64, 8  # colours of the palette, and frames sampled to choose them
_EYE, _UP = (0.90, 0.40, -0.14), (0.0, 1.0, 0.0)
_SIZE = (9.0, 4.3)  # in, of 100 dots
_TARGET: Color = (120, 150, 190)
_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
_FACES = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
_AMBIENT = 0.62  # share of its colour that an unlit face shows
_LIGHT = np.array([0.4, 0.8, -0.45]) / np.linalg.norm([0.4, 0.8, -0.45])


def _nothing() -> Picture:
    return pad_picture(np.zeros(ROWS * COLUMNS), ROWS, COLUMNS)


@dataclass(frozen=True, eq=False)
class Moment:
    """Values drawn in one frame: s since the first message, rad, m, A."""

    time: float = 0.0
    angles: tuple[float, ...] = ()
    position: tuple[float, ...] = ()
    left: Picture = field(default_factory=_nothing)
    right: Picture = field(default_factory=_nothing)
    phase: str = ""
    contactor: str = "open"
    charge: float = math.nan


class Animation:
    """Collects a docking's values, and draws them.

    Args:
        geometry: of the arm.
    """

    def __init__(self, geometry: DeltaGeometry) -> None:
        self._geometry = geometry
        self._begin: int | None = None
        self._now = Moment()
        self._moments: list[Moment] = []
        self._contact: list[tuple[float, float]] = []
        self._goal: tuple[Sequence[float], float] | None = None
        self._target: tuple[Sequence[float], float] | None = None

    def at(self, time_ns: int) -> None:
        """Set the time of the following values, ns since 1970."""
        if self._begin is None:
            self._begin = time_ns
        time = 1e-9 * (time_ns - self._begin)
        due = self._moments[-1].time + 1.0 / RATE if self._moments else 0.0
        if time >= due and self._now.angles and self._now.phase not in ("", "idle"):
            self._moments.append(replace(self._now, time=time))
        self._now = replace(self._now, time=time)

    def arm(self, angles: Sequence[float], position: Sequence[float]) -> None:
        """Take arm angles (rad) and position (m in charger_base)."""
        self._now = replace(self._now, angles=tuple(angles), position=tuple(position))

    def contact(self, current: float, servos: Sequence[float]) -> None:
        """Take the contact current, A."""
        self._contact.append((self._now.time, current))

    def pads(self, left: Picture, right: Picture, forces: tuple[float, float]) -> None:
        """Take both pads as pictures."""
        self._now = replace(self._now, left=left, right=right)

    def misalignment(self, values: Mapping[str, tuple[float, float]]) -> None:
        """Take the measured pose of the target; it is drawn at the last measurement."""
        along, across, angle = (values[name][0] for name in ("horizontal", "vertical", "angle"))
        if self._now.position and math.isfinite(along + across + angle):
            x, y, z = self._now.position
            self._target = ((x + along, y + across, z), angle)

    def power(self, current: float, target: float, battery: float, energy: float) -> None:
        """Take the charge current, A."""
        self._now = replace(self._now, charge=current)

    def state(self, name: str, value: str) -> bool:
        """Take the phase of docking and the contactor's state; return whether one changed."""
        before = self._now
        if name == "docking":
            self._now = replace(before, phase=value)
        elif name == "contactor":
            self._now = replace(before, contactor=value)
        return self._now.phase != before.phase or self._now.contactor != before.contactor

    def target(self, name: str, position: Sequence[float], roll: float) -> None:
        """Take the electrodes' pose: given by the goal or seen by the camera."""
        self._goal = (position, roll)

    def reported(self, current: float) -> None:
        """Ignore docking_node's contact current."""

    def line(self, text: str, kind: str = "", level: str = "") -> None:
        """Ignore decisions."""

    def status(self, text: str) -> None:
        """Ignore the state page."""

    def picture(self, name: str, pixels: NDArray[np.uint8]) -> None:
        """Ignore camera images."""

    def save(self, path: Path, progress: Callable[[int, int], None] = lambda done, of: None) -> None:
        """Write the animation.

        Args:
            path: of the GIF.
            progress: called after each frame with the frames drawn and their total.

        Raises:
            ValueError: the messages include no docking.
            ImportError: matplotlib is missing.
            OSError: the file cannot be written.
        """
        moments = self._moments[:: 1 + len(self._moments) // _LONGEST]
        if not moments:
            raise ValueError("the messages contain no docking, so there is nothing to draw")
        from PIL import Image

        some = np.linspace(0, len(moments) - 1, _SAMPLED).astype(int)
        palette = Image.fromarray(np.concatenate([self._draw(moments[index]) for index in some])).quantize(_COLOURS)
        pictures = []
        for moment in moments:
            pictures.append(Image.fromarray(self._draw(moment)).quantize(palette=palette, dither=Image.Dither.NONE))
            progress(len(pictures), len(moments))
        between = round(1e3 / RATE)
        pictures[0].save(
            path, save_all=True, append_images=pictures[1:], loop=0, optimize=True,
            duration=[between] * (len(pictures) - 1) + [round(1e3 * _HOLD)],
        )  # fmt: skip

    def _draw(self, moment: Moment) -> NDArray[np.uint8]:
        """Return one frame (height, width, 3) RGB."""
        import matplotlib

        matplotlib.use("Agg")
        from matplotlib import rc_context
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        with rc_context(STYLE):
            figure = Figure(figsize=_SIZE, dpi=100, facecolor="white")
            canvas = FigureCanvasAgg(figure)
            self._mechanism(figure, moment)
            _pads(figure, moment)
            self._current(figure, moment)
            figure.text(0.02, 0.945, _headline(moment), fontsize=13, fontweight="bold", color=INK, va="center")
            passed = f"{moment.time - self._moments[0].time:.1f} s"
            figure.text(0.98, 0.945, passed, fontsize=11, color=FAINT, va="center", ha="right")
            canvas.draw()  # type: ignore[no-untyped-call]
            return np.array(canvas.buffer_rgba())[..., :3]  # type: ignore[no-untyped-call]

    def _mechanism(self, figure: Figure, moment: Moment) -> None:
        from matplotlib.collections import PolyCollection

        axes = figure.add_axes((0.0, 0.0, 0.58, 0.9))
        faces, colours = self._solids(moment).seen(_EYE, _UP)
        axes.add_collection(PolyCollection(list(faces), facecolors=colours, edgecolors="none", antialiased=True))
        axes.set_xlim(-0.15, 0.22)
        axes.set_ylim(-0.155, 0.165)
        for x, y, name in ((-0.145, -0.145, "target"), (0.085, -0.145, "charger")):
            axes.text(x, y, name, fontsize=9, color=FAINT)
        axes.set_aspect("equal")
        axes.set_axis_off()

    def _solids(self, moment: Moment) -> Solids:
        solids = Solids()
        ring = shapes.ring(self._geometry)
        solids.add(shapes.base(self._geometry))
        solids.add_bars(np.stack([ring[:-1], ring[1:]], axis=1), 0.004, shapes.ORANGE)
        arms, rods = shapes.moving(self._geometry, moment.angles, moment.position)
        solids.add_bars(arms, shapes.ARM_RADIUS, shapes.ORANGE)
        solids.add_bars(rods, shapes.ROD_RADIUS, shapes.ALUMINIUM)
        solids.add(shapes.platform(self._geometry), moment.position)
        place = self._target or self._goal
        if place is not None:
            solids.add(shapes.target(_TARGET), *place)
        return solids

    def _current(self, figure: Figure, moment: Moment) -> None:
        axes = figure.add_axes((0.645, 0.13, 0.335, 0.34))
        begin, end = self._moments[0].time, self._moments[-1].time
        table: Array = np.array([each for each in self._contact if begin <= each[0] <= end])
        axes.axhspan(*BAND, color=GREEN, alpha=0.25, linewidth=0)
        if len(table):
            passed = table[table[:, 0] <= moment.time]
            axes.plot(passed[:, 0] - begin, passed[:, 1], color=RED, linewidth=1.6)
        axes.set_xlim(0.0, end - begin)
        axes.set_ylim(-0.3, 0.75)
        axes.set_title("contact current, A; good: 0.4 to 0.5", loc="left", fontsize=9)
        axes.set_xlabel("s", labelpad=1)


def _pads(figure: Figure, moment: Moment) -> None:
    for left, name, picture in ((0.645, "left pad, 0 to 9 N", moment.left), (0.82, "right pad", moment.right)):
        axes = figure.add_axes((left, 0.57, 0.155, 0.29), facecolor=PAPER)
        axes.imshow(picture, interpolation="nearest")
        axes.set_title(name, loc="left", fontsize=9)
        axes.set_xticks([])
        axes.set_yticks([])


def _headline(moment: Moment) -> str:
    charge = f"  {moment.charge:.1f} A" if moment.contactor == "closed" and moment.charge > 0.05 else ""
    return f"{moment.phase.replace('_', ' ')}{charge}"


class Solids:
    """Coloured faces with four corners.

    Attributes:
        corners: (n, 4, 3) m.
        colours: (n, 3), red, green, blue, 0 to 1.
    """

    def __init__(self) -> None:
        self.corners: Array = np.empty((0, 4, 3))
        self.colours: Array = np.empty((0, 3))

    def add(self, boxes: Boxes, place: Sequence[float] = (0.0, 0.0, 0.0), turn: float = 0.0) -> None:
        """Add the boxes of a frame at `place` (m), turned about z by `turn` (rad)."""
        centres, sizes = np.asarray(boxes.centres, dtype=float), np.asarray(boxes.sizes, dtype=float)
        quaternions = np.asarray(boxes.turns, dtype=float)
        angles = 2.0 * np.arctan2(quaternions[:, 2], quaternions[:, 3])
        local = 0.5 * sizes[:, None, :] * _SIGNS
        points = _about_z(_about_z(local, angles) + centres[:, None, :], np.full(len(centres), turn))
        self._append(points + np.asarray(place), boxes.colours)

    def add_bars(self, lines: Array, radius: float, colour: Color) -> None:
        """Add bars of square section (2 `radius` wide, m) along lines (n, 2, 3) m."""
        lines = np.asarray(lines, dtype=float)
        along = lines[:, 1] - lines[:, 0]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        least = np.eye(3)[np.argmin(np.abs(along), axis=1)]
        aside = np.cross(along, least)
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        third = np.cross(along, aside)
        middle, half = lines.mean(axis=1), 0.5 * np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
        axes = np.stack([radius * aside, radius * third, half[:, None] * along], axis=1)
        self._append(middle[:, None, :] + _SIGNS @ axes, [colour] * len(lines))

    def seen(self, eye: Sequence[float], up: Sequence[float]) -> tuple[Array, Array]:
        """Return the projected faces (n, 4, 2) m, the farthest first, and their colours (n, 3).

        Args:
            eye: direction to the viewer, who is far away.
            up: vertical direction of the picture.
        """
        toward = np.asarray(eye, dtype=float) / np.linalg.norm(eye)
        right = np.cross(up, toward)
        right /= np.linalg.norm(right)
        basis = np.stack([right, np.cross(toward, right), toward])
        points = self.corners @ basis.T
        normals = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 3] - self.corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= np.where(normals @ toward < 0.0, -1.0, 1.0)[:, None]
        light = _AMBIENT + (1.0 - _AMBIENT) * np.clip(normals @ _LIGHT, 0.0, 1.0)
        order = np.argsort(points[:, :, 2].mean(axis=1), kind="stable")
        return points[order, :, :2], np.clip(self.colours * light[:, None], 0.0, 1.0)[order]

    def _append(self, points: Array, colours: Sequence[Color]) -> None:
        """Add boxes by their eight corners (n, 8, 3)."""
        self.corners = np.concatenate([self.corners, points[:, _FACES].reshape(-1, 4, 3)])
        self.colours = np.concatenate([self.colours, np.repeat(np.asarray(colours) / 255.0, len(_FACES), axis=0)])


def _about_z(points: Array, angles: Array) -> Array:
    """Return points (n, m, 3), turned about z by `angles` (n,) rad."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)
