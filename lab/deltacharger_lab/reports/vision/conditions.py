# SPDX-License-Identifier: Apache-2.0
"""Conditions of the vision report: rows of images of one kind, and the camera that the detector assumes.

The same generator state draws the same view; additions are drawn last, so that views of one seed are comparable.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_lab.reports.vision.drawing import KINDS, draw_obstruction, draw_room, hidden_share
from deltacharger_vision.images import Intrinsics, project
from deltacharger_vision.rendering.camera import OAK_D
from deltacharger_vision.rendering.scene import Box, CameraParameters, RenderedScene
from deltacharger_vision.terminal import Terminal, turn

Random = np.random.Generator

MOUNT_PITCH = math.atan2(0.12, 0.20)
"""Pitch of the default mount, which sees the docked terminal from above, rad."""
DOCK, APPROACH, EVERYWHERE = (0.15, 0.35), (0.35, 0.8), (0.15, 1.0)
"""Ranges, m."""
MOST_HIDDEN = 0.5
"""Largest share of the bars' faces that an obstruction hides by default."""
_MARGIN = 6.0  # px between the terminal and the image's border
_NEAREST = 0.05  # m
_TRIES = 1000


@dataclass(frozen=True)
class DrawnView:
    """Scene before a camera.

    Attributes:
        scene: the scene.
        pose: (4, 4) camera_T_terminal.
        camera: the camera's defects.
    """

    scene: RenderedScene
    pose: Array
    camera: CameraParameters

    def changed(
        self, camera: Mapping[str, Any] | None = None, scene: Mapping[str, Any] | None = None, **parts: Any
    ) -> DrawnView:
        """Return the view with other parameters of the camera and of the scene, and other parts of the scene."""
        parameters = dataclasses.replace(self.scene.parameters, **(scene or {}))
        return DrawnView(
            dataclasses.replace(self.scene, **{"parameters": parameters, **parts}),
            self.pose,
            dataclasses.replace(self.camera, **(camera or {})),
        )


def draw_pose(away: float, random: Random, intrinsics: Intrinsics = OAK_D) -> Array:
    """Return (4, 4) of a terminal at `away` m, inside the picture, upright within 25°, seen from 3° below to 31° above.

    Raises:
        ValueError: no pose at that range shows the complete terminal.
    """
    for _ in range(_TRIES):
        roll, yaw = math.radians(random.uniform(-25.0, 25.0)), math.radians(random.normal(0.0, 8.0))
        # The camera is above and looks down; the angle falls with the range.
        pitch = random.uniform(-0.1, 1.0) * min(MOUNT_PITCH, math.asin(min(1.0, 0.12 / away)))
        pose = np.eye(4)
        pose[:3, :3] = about(0, pitch) @ about(1, yaw) @ about(2, roll) @ np.diag([-1.0, -1.0, 1.0])
        ray = np.array([random.uniform(-0.5, 0.5), random.uniform(-0.3, 0.3), 1.0])
        pose[:3, 3] = away * ray / np.linalg.norm(ray)
        if is_inside(pose, intrinsics):
            return pose
    raise ValueError(f"no pose at {away} m shows the complete terminal")


def is_inside(pose: Array, intrinsics: Intrinsics) -> bool:
    """Return whether a terminal at (4, 4) `pose` lies completely in the picture."""
    corners = Terminal().corners().reshape(-1, 3) @ pose[:3, :3].T + pose[:3, 3]
    if np.any(corners[:, 2] <= _NEAREST):
        return False
    pixels = project(corners, intrinsics)
    size = np.array([intrinsics.width, intrinsics.height]) - 1.0 - _MARGIN
    return bool(np.all(pixels > _MARGIN) and np.all(pixels < size))


def about(axis: int, angle: float) -> Array:
    """Return the (3, 3) rotation by `angle` (rad) about an axis."""
    return turn(angle * np.eye(3)[axis])


def draw_light(random: Random) -> tuple[float, float, float]:
    """Return a direction toward the light from before the terminal."""
    return float(random.normal(0.0, 0.6)), float(random.uniform(0.0, 1.0)), float(-random.uniform(0.3, 1.0))


def plain(random: Random, nearest: float, farthest: float, intrinsics: Intrinsics = OAK_D) -> DrawnView:
    """Return a terminal alone before its wall."""
    light = draw_light(random)
    return DrawnView(
        RenderedScene(light=light), draw_pose(random.uniform(nearest, farthest), random, intrinsics), CameraParameters()
    )


def in_clutter(random: Random, nearest: float, farthest: float) -> DrawnView:
    """Return a terminal with boxes around it."""
    return plain(random, nearest, farthest).changed(background=boxes(random, 8, (0.05, 0.6), 0.5))


def in_room(random: Random, nearest: float, farthest: float) -> DrawnView:
    """Return a terminal in a drawn room: other materials, light and wall, boxes, and decoys of electrodes."""
    view = plain(random, nearest, farthest)
    return dataclasses.replace(view, scene=draw_room(random, clutter=8, decoys=3))


def covered(random: Random, share: float, both: bool = False) -> DrawnView:
    """Return a terminal at 0.2–0.6 m with a dark or bright box just before one end of one bar, or of both."""
    view = plain(random, 0.2, 0.6)
    end, bar = random.choice([-1.0, 1.0]), random.choice([-1.0, 1.0])
    whole, height = Terminal().bar_length, Terminal().bar_height
    length = whole * share + 0.03
    pose = np.eye(4)
    # The camera looks past the box's edge at a slant, so it hides a little more or less than `share`.
    across = 0.0 if both else bar * (Terminal().spacing / 2 + 0.002)
    pose[:3, 3] = [end * (whole / 2 - whole * share + length / 2), across, -0.004]
    size = (length, 0.06 if both else height + 0.0064, 0.002)
    return view.changed(foreground=(Box(pose, size, (float(random.uniform(0.02, 0.4)),) * 3),))


def without(random: Random) -> DrawnView:
    """Return boxes of all kinds and, in every other view, parallel metal bars that do not belong to a terminal."""
    view = plain(random, 0.2, 0.8)
    background = boxes(random, 14, (-0.05, 0.6), 0.3)
    background += rows_of_bars(random) if random.random() < 0.5 else ()
    return view.changed(background=background, target=False)


def decoys(random: Random) -> DrawnView:
    """Return a drawn room with six things that resemble electrodes, among them terminals of another size."""
    view = plain(random, 0.2, 0.8)
    return dataclasses.replace(view, scene=draw_room(random, clutter=6, decoys=6, target=False))


def other_size(random: Random) -> DrawnView:
    """Return a terminal 0.75 or 1.3 times the size."""
    view = plain(random, 0.25, 0.7)
    scale = float(random.choice([0.75, 1.3]))
    t = Terminal()
    return view.changed(
        terminal=Terminal(t.bar_length * scale, t.bar_height * scale, t.gap * scale, t.bar_thickness * scale)
    )


def boxes(random: Random, count: int, depth: tuple[float, float], spread: float) -> tuple[Box, ...]:
    """Return bright and dark, metal and matte boxes around the line of sight, many long and thin as bars are.

    Args:
        random: draws them.
        count: how many.
        depth: m behind the touched faces.
        spread: m to either side.
    """
    found = []
    for _ in range(count):
        pose = np.eye(4)
        turned = [
            about(axis, random.uniform(-math.pi, math.pi) if axis == 2 else random.normal(0.0, 0.4))
            for axis in range(3)
        ]
        pose[:3, :3] = turned[0] @ turned[1] @ turned[2]
        pose[:3, 3] = [random.uniform(-spread, spread), random.uniform(-spread, spread), random.uniform(*depth)]
        size = (random.uniform(0.02, 0.2), random.uniform(0.005, 0.08), random.uniform(0.005, 0.05))
        grey = float(random.uniform(0.02, 0.9))
        red, green, blue = (float(np.clip(grey * random.uniform(0.7, 1.3), 0.0, 1.0)) for _ in range(3))
        found.append(Box(pose, size, (red, green, blue), metal=bool(random.random() < 0.4)))
    return tuple(found)


def rows_of_bars(random: Random) -> tuple[Box, ...]:
    """Return two to five parallel metal bars of sizes and spacings that differ from the terminal's."""
    height, length = random.uniform(0.004, 0.03), random.uniform(0.03, 0.2)
    spacing = height * random.uniform(1.3, 3.0)
    turned = about(2, random.uniform(-0.5, 0.5))
    found = []
    for row in range(int(random.integers(2, 6))):
        pose = np.eye(4)
        pose[:3, :3] = turned
        pose[:3, 3] = turned @ [random.normal(0.0, 0.002), row * spacing, 0.0] + [0.0, 0.0, random.uniform(0.02, 0.03)]
        found.append(Box(pose, (length, height, 0.006), (0.65, 0.65, 0.65), metal=True))
    return tuple(found)


def obstructed(random: Random, kind: str, most: float = MOST_HIDDEN, least: float = 0.0) -> DrawnView:
    """Return the view of `unobstructed` with something before it that hides some of the bars, or lies beside them.

    Args:
        random: draws it.
        kind: of the obstruction.
        most: share of the bars' faces that it hides at most.
        least: the same at least.
    """
    view = unobstructed(random)
    # Not so near to the camera that it hides everything else.
    terminal, room = view.scene.terminal, min(0.12, 0.4 * float(np.linalg.norm(view.pose[:3, 3])))
    for _ in range(_TRIES):
        boxes = draw_obstruction(random, kind, terminal, room)
        if least <= hidden_share(boxes, terminal, view.pose) <= most:
            return view.changed(foreground=boxes)
    raise ValueError(f"no {kind} hides {least:g} to {most:g} of the bars")


def unobstructed(random: Random) -> DrawnView:
    """Return a terminal at 0.15–1 m in light and exposure of all kinds, every other one in a drawn room."""
    view = plain(random, *EVERYWHERE)
    exposure = float(np.exp(random.uniform(math.log(0.3), math.log(2.5))))
    if random.random() < 0.5:
        view = dataclasses.replace(view, scene=draw_room(random, clutter=6, decoys=1))
    return view.changed(camera={"exposure": exposure})


RANGES = (0.15, 0.17, 0.20, 0.25, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00)
"""m."""
BAND = (0.15, 0.80)
"""Ranges of the targets, m."""
SIZES = ((320, 200), (640, 400), (1280, 800))
ANYWHERE = (0.2, 0.8)
RAYS, MUJOCO = "ray-caster", "MuJoCo"
BY_RANGE, DEFECTS, HIDDEN, ALARMS = "range", "defects", "hidden", "alarms"
INTRINSICS, LENS, SIZE, RENDERERS = "intrinsics", "lens", "size", "renderers"
OBSTRUCTED, CLEAR, HEAVY = "obstructed", "clear", "heavy"
HALF_HIDDEN = "50 % of one bar hidden"
CLUTTER, CLUTTER_FLAT = "clutter, no electrodes", "clutter, no electrodes, no depth"
ALONE = "no depth at all"

Draw = Callable[[np.random.Generator], DrawnView]


@dataclass(frozen=True)
class Condition:
    """One row of a table.

    Attributes:
        name: of the row.
        group: the table.
        draw: draws a view.
        weight: number of images relative to a usual row.
        real: whether there are electrodes.
        takes: the camera that takes the image.
        assumed: camera that the detector assumes.
        color_only: whether there is no depth.
        renderer: RAYS or MUJOCO.
        stream: rows of one stream share their views.
        away: m, if the row has one range.
    """

    name: str
    group: str
    draw: Draw
    weight: float = 1.0
    real: bool = True
    takes: Intrinsics = OAK_D
    assumed: Intrinsics = OAK_D
    color_only: bool = False
    renderer: str = RAYS
    stream: int = 0
    away: float = math.nan


_DOCKED = partial(plain, nearest=DOCK[0], farthest=DOCK[1])
_IN_CLUTTER = partial(in_clutter, nearest=ANYWHERE[0], farthest=ANYWHERE[1])
_IN_ROOM = partial(in_room, nearest=ANYWHERE[0], farthest=ANYWHERE[1])


def _by_range() -> list[Condition]:
    draws = [(away, partial(plain, nearest=away, farthest=away)) for away in RANGES]
    return [
        Condition(f"{away:.2f} m", BY_RANGE, draw, 4 / 3, stream=number, away=away)
        for number, (away, draw) in enumerate(draws, 1)
    ]


def _anywhere(random: np.random.Generator, **changes: Any) -> DrawnView:
    return plain(random, *ANYWHERE).changed(**changes)


def _defect(name: str, **changes: Any) -> Condition:
    return Condition(name, DEFECTS, partial(_anywhere, **changes))


def _defects() -> list[Condition]:
    return [
        _defect("nothing special"),
        *(_defect(f"exposure × {value:g}", camera={"exposure": value}) for value in (0.1, 0.2, 0.5, 1.5, 2.5, 4.0)),
        *(_defect(f"highlight {value:g}", scene={"highlight": value}) for value in (2.0, 4.0, 8.0)),
        _defect("light uneven by ± 50 %", scene={"unevenness": 0.5}),
        *(
            _defect(f"holes: {100 * metal:.0f} % of metal, {100 * else_:.0f} % else",
                    camera={"hole_metal": metal, "hole_matte": else_})
            for metal, else_ in ((0.6, 0.2), (0.9, 0.5))
        ),
        *(_defect(f"disparity noise {value:g} px", camera={"disparity_noise": value}) for value in (0.4, 0.8)),
        *(_defect(f"defocus {value:g} px", camera={"defocus": value}) for value in (1.0, 1.5, 2.5)),
        *(
            _defect(f"motion {value:g} px", camera={"motion_x": 0.75 * value, "motion_y": 0.66 * value})
            for value in (2.0, 4.0, 8.0)
        ),
        Condition("clutter around", DEFECTS, _IN_CLUTTER),
        Condition("drawn room, decoys", DEFECTS, _IN_ROOM),
        Condition(ALONE, DEFECTS, partial(plain, nearest=0.15, farthest=0.6), color_only=True),
    ]  # fmt: skip


_THOUSAND = 20 / 3
_FIXED = (
    Condition("25 % of one bar hidden", HIDDEN, partial(covered, share=0.25)),
    Condition(HALF_HIDDEN, HIDDEN, partial(covered, share=0.5), 2.0),
    Condition("75 % of one bar hidden", HIDDEN, partial(covered, share=0.75)),
    Condition("15 % of both bars hidden", HIDDEN, partial(covered, share=0.15, both=True)),
    Condition("30 % of both bars hidden", HIDDEN, partial(covered, share=0.3, both=True)),
    Condition(CLUTTER, ALARMS, without, _THOUSAND, real=False),
    Condition(CLUTTER_FLAT, ALARMS, without, _THOUSAND, real=False, color_only=True),
    Condition("drawn rooms, decoys alone", ALARMS, decoys, 2.0, real=False),
    Condition("bars 0.75 and 1.3 times the size", ALARMS, other_size, real=False),
)
"""Rows of hidden bars and of false alarms."""


_SHARES = ((RAYS, 0.7), (MUJOCO, 0.3))
"""Share of the images for each renderer."""


def _obstructed() -> list[Condition]:
    """Return rows of each obstruction, of none, and of those that hide more than half: 1000, 1000, 200 images."""
    found = []
    for renderer, share in _SHARES:
        for kind in KINDS:
            draw: Draw = partial(obstructed, kind=kind)
            found.append(
                Condition(f"{kind}, {renderer}", OBSTRUCTED, draw, share * _THOUSAND / len(KINDS), renderer=renderer)
            )
        found.append(Condition(f"nothing, {renderer}", CLEAR, unobstructed, share * _THOUSAND, renderer=renderer))
    for kind in ("strap", "hand"):
        draw = partial(obstructed, kind=kind, most=1.0, least=MOST_HIDDEN)
        found.append(Condition(f"{kind}, more than half hidden", HEAVY, draw, 0.1 * _THOUSAND))
    return found


def _intrinsics() -> list[Condition]:
    assumed = {"exact": OAK_D}
    for percent in (-2, -1, 1, 2):
        factor = 1 + percent / 100
        assumed[f"focal length {percent:+d} %"] = dataclasses.replace(OAK_D, fx=OAK_D.fx * factor, fy=OAK_D.fy * factor)
    for axis, shift in itertools.product("xy", (-5, 5)):
        moved = {f"c{axis}": getattr(OAK_D, f"c{axis}") + shift}
        assumed[f"principal point {axis} {shift:+d} px"] = dataclasses.replace(OAK_D, **moved)
    return [Condition(name, INTRINSICS, _DOCKED, assumed=each) for name, each in assumed.items()]


LENSES = {
    "OAK-D's": (6.5, -3.1, 0.0004, -0.0003, 0.9, 6.7, -2.4, 0.6),
    "barrel, k1 = −0.1": (-0.1, 0.01, 0.0, 0.0, 0.0),
    "barrel, k1 = −0.3": (-0.30, 0.12, 0.001, -0.0005, -0.02),
}
"""Distortion by name: rational_polynomial like that of an OAK-D (assumed), plumb_bob mild and strong."""


def _lenses() -> list[Condition]:
    found = []
    for name, distortion in LENSES.items():
        lens = dataclasses.replace(OAK_D, distortion=distortion)
        draw = partial(_DOCKED, intrinsics=lens)
        found.append(Condition(f"{name}, known", LENS, draw, takes=lens, assumed=lens))
        found.append(Condition(f"{name}, ignored", LENS, draw, takes=lens))
    return found


def _sizes() -> list[Condition]:
    draw = partial(plain, nearest=BAND[0], farthest=BAND[1])
    cameras = [OAK_D.scaled(*size) for size in SIZES]
    return [Condition(f"{of.width} × {of.height} px", SIZE, draw, takes=of, assumed=of) for of in cameras]


def _renderers() -> list[Condition]:
    draws: dict[str, Draw] = {
        "docking": _DOCKED,
        "approaching": partial(plain, nearest=APPROACH[0], farthest=APPROACH[1]),
        "exposure × 0.2": partial(_anywhere, camera={"exposure": 0.2}),
        "highlight 4": partial(_anywhere, scene={"highlight": 4.0}),
        "clutter around": _IN_CLUTTER,
        "drawn room, decoys": _IN_ROOM,
        "half of one bar hidden": partial(covered, share=0.5),
    }
    return [
        Condition(f"{name}, {renderer}", RENDERERS, draw, 0.5, renderer=renderer)
        for name, draw in draws.items()
        for renderer in (RAYS, MUJOCO)
    ]


def key(condition: Condition) -> str:
    """Return the key of a condition in CONDITIONS and in the figures."""
    return f"{condition.group}: {condition.name}"


CONDITIONS: dict[str, Condition] = {
    key(condition): condition
    for part in (
        _by_range(),
        _defects(),
        _FIXED,
        _obstructed(),
        _intrinsics(),
        _lenses(),
        _sizes(),
        _renderers(),
    )
    for condition in part
}
"""By group and name."""


def members(group: str) -> list[Condition]:
    """Return the rows of a table."""
    return [condition for condition in CONDITIONS.values() if condition.group == group]


def keys(*groups: str) -> list[str]:
    """Return the keys of the rows of tables."""
    return [key(each) for group in groups for each in members(group)]
