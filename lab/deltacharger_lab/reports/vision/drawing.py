# SPDX-License-Identifier: Apache-2.0
"""Random scenes of the vision report: rooms with decoys that resemble electrodes, and obstructions before a terminal.

Obstructions are cables, straps, hands and labels, as boxes for both renderers. Each passes through, or ends at, a
random place on the bars or beside them. All ranges are assumed. Frame: the terminal's (x along the bars, y up, z into
the plate, touched faces at z = 0).
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_vision.rendering.scene import DARK, Box, Color, RenderedScene, draw_scene, place_behind, shifted
from deltacharger_vision.terminal import Terminal, transform, turn

Random = np.random.Generator

_LINKS = 8  # straight parts of a cable
_STICKER, _BAND = 0.0002, 0.001  # m, thickness
_ROUND = math.cos(math.pi / 8)  # of two crossed squares, whose outline is almost a circle
_BESIDE = 0.006  # m beside the bars that a place may be
_AXES = np.eye(3)
_ACROSS, _DOWN = 48, 8  # places on a face that are tested for visibility
_METAL: Color = (0.63, 0.64, 0.65)


def draw_room(random: Random, clutter: int, decoys: int, target: bool = True) -> RenderedScene:
    """Return the scene of `draw_scene` with decoys behind the plate."""
    scene = draw_scene(random, clutter, target)
    terminal, p = scene.terminal, scene.parameters
    near, far = terminal.bar_thickness + p.plate_thickness + 0.01, 0.9 * p.wall_distance
    boxes = [box for _ in range(decoys) for box in draw_decoy(random, terminal, place_behind(random, near, far))]
    return dataclasses.replace(scene, background=(*scene.background, *boxes))


def draw_decoy(random: Random, terminal: Terminal, pose: Array) -> list[Box]:
    """Return one thing that resembles electrodes, at (4, 4) `pose` in the terminal's frame.

    A stripe of light paint, a pipe, a single bar, two bars with another spacing, a grille, or a terminal of the right
    proportions but wrong size. In a colour image alone, the last is a terminal at another range.
    """
    kinds: tuple[Callable[[Random, Terminal], list[Box]], ...] = (_stripe, _pipe, _bar, _pair, _grille, _scaled)
    boxes = kinds[random.integers(len(kinds))](random, terminal)
    return [dataclasses.replace(box, pose=pose @ box.pose) for box in boxes]


def _stripe(random: Random, terminal: Terminal) -> list[Box]:
    color = (random.uniform(0.6, 0.9),) * 3
    return [Box(np.eye(4), (random.uniform(0.05, 0.8), random.uniform(0.005, 0.03), 0.0005), color)]


def _pipe(random: Random, terminal: Terminal) -> list[Box]:
    width = random.uniform(0.006, 0.03)
    return [Box(np.eye(4), (random.uniform(0.2, 1.0), width, width), _METAL, metal=True)]


def _bar(random: Random, terminal: Terminal) -> list[Box]:
    return _row(terminal, (0.0,))


def _pair(random: Random, terminal: Terminal) -> list[Box]:
    gap = terminal.gap * (random.uniform(0.15, 0.5) if random.random() < 0.5 else random.uniform(2.0, 4.0))
    half = (terminal.bar_height + gap) / 2
    return _row(terminal, (-half, half))


def _grille(random: Random, terminal: Terminal) -> list[Box]:
    pitch = random.uniform(0.4, 0.6) * terminal.spacing
    thin = dataclasses.replace(terminal, bar_height=0.5 * pitch)
    return _row(thin, tuple(pitch * (index - 2.5) for index in range(6)))


def _scaled(random: Random, terminal: Terminal) -> list[Box]:
    factor = random.uniform(0.4, 0.65) if random.random() < 0.5 else random.uniform(1.6, 2.5)
    bars = _row(terminal, (-terminal.spacing / 2, terminal.spacing / 2))
    plate = Box(shifted((0.0, 0.0, terminal.bar_thickness + 0.0025)), (0.2, 0.12, 0.005), DARK)
    return [_grown(box, factor) for box in (plate, *bars)]


def _grown(box: Box, factor: float) -> Box:
    pose = box.pose.copy()
    pose[:3, 3] *= factor
    x, y, z = box.size
    return dataclasses.replace(box, pose=pose, size=(factor * x, factor * y, factor * z))


def _row(terminal: Terminal, places: tuple[float, ...]) -> list[Box]:
    """Return metal bars of the terminal's size with their centre lines at y = places (m)."""
    size = (terminal.bar_length, terminal.bar_height, terminal.bar_thickness)
    return [Box(shifted((0.0, y, terminal.bar_thickness / 2)), size, _METAL, metal=True) for y in places]


def draw_obstruction(random: Random, kind: str, terminal: Terminal, room: float) -> tuple[Box, ...]:
    """Return one obstruction of a kind of KINDS, at most `room` m in front of the touched faces."""
    half = np.array([0.5 * terminal.bar_length, 0.5 * terminal.spacing + 0.5 * terminal.bar_height]) + _BESIDE
    return tuple(KINDS[kind](random, terminal, random.uniform(-half, half), room))


def _cable(random: Random, terminal: Terminal, place: Array, room: float) -> list[Box]:
    """Return a round cable of one colour that sags between two ends."""
    width, angle = random.uniform(0.002, 0.012), random.uniform(-math.pi, math.pi)
    away = 0.5 * width + _up_to(random, 0.8 * room, 0.06)
    reach, sag = random.uniform(0.08, 0.3), random.uniform(0.0, 0.06)
    along = np.array([math.cos(angle), math.sin(angle)])
    middle = random.uniform(-0.5, 0.5)
    color = _paint(random)
    # A parabola through `place`: gravity pulls it down the plate, and its ends are farther from it.
    run = np.linspace(-1.0, 1.0, _LINKS + 1)
    bow = run**2 - middle**2
    points = np.empty((_LINKS + 1, 3))
    points[:, :2] = place + reach * (run - middle)[:, None] * along
    points[:, 1] += sag * bow
    points[:, 2] = -away - random.uniform(0.0, 0.2 * room) * run**2
    side = width * _ROUND
    return [
        _between(start, end, (side, side), askew, color)
        for start, end in itertools.pairwise(points)
        for askew in (0.0, math.pi / 4)
    ]


def _strap(random: Random, terminal: Terminal, place: Array, room: float) -> list[Box]:
    """Return a flat band, tight over the bars, or raised and turned in front of them."""
    pose = _flat(random, place)
    width, length = random.uniform(0.006, 0.04), random.uniform(0.15, 0.6)
    if random.random() < 0.5:
        pose[2, 3] = -0.5 * _BAND
    else:
        pose[2, 3] = -_BAND - _up_to(random, room, 0.04)
        lean = min(0.3, 0.8 * -pose[2, 3] / (0.5 * width))
        pose[:3, :3] = pose[:3, :3] @ turn(random.uniform(-lean, lean) * _AXES[0])
    return [Box(pose, (length, width, _BAND), _paint(random))]


def _label(random: Random, terminal: Terminal, place: Array, room: float) -> list[Box]:
    """Return a sticker of any brightness: on one bar, on the plate, or over both."""
    size = (random.uniform(0.01, 0.07), random.uniform(0.006, 0.04))
    kind = random.integers(3)
    if kind == 0:  # on the touched face of one bar, and no wider than it
        size = (size[0], min(size[1], terminal.bar_height))
        place = np.array([place[0], math.copysign(0.5 * terminal.spacing, place[1])])
    elif kind == 1:  # on the plate beside both
        place = place + np.array([0.0, math.copysign(terminal.spacing, place[1])])
    pose = _flat(random, place) if kind else shifted((place[0], place[1], 0.0))
    pose[2, 3] = terminal.bar_thickness - 0.5 * _STICKER if kind == 1 else -0.5 * _STICKER
    return [Box(pose, (*size, _STICKER), _paint(random))]


def _hand(random: Random, terminal: Terminal, place: Array, room: float) -> list[Box]:
    """Return a hand whose middle finger ends at `place`: palm, four fingers and a thumb of three parts each."""
    pose = _flat(random, place)
    lean = random.uniform(0.0, 0.4)
    pose[:3, :3] = pose[:3, :3] @ turn(lean * _AXES[1])
    pose[2, 3] = -0.012 - _up_to(random, room, 0.05)
    tone = random.uniform(0.08, 0.6)
    skin: Color = (min(1.0, 1.15 * tone), 0.75 * tone, 0.6 * tone)
    spread = random.uniform(0.0, 0.12)
    boxes = [Box(pose @ shifted((-0.125, 0.0, 0.0)), (0.09, 0.08, 0.025), skin)]
    for finger, length in zip((-1.5, -0.5, 0.5, 1.5), (0.065, 0.078, 0.08, 0.06), strict=True):
        root = np.array([-0.08, 0.02 * finger, 0.0])
        aim = np.array([math.cos(finger * spread), math.sin(finger * spread), 0.0])
        boxes += _finger(pose, root, aim, length, skin)
    aim = np.array([math.cos(0.8), -math.sin(0.8), 0.0])
    boxes += _finger(pose, np.array([-0.13, -0.04, 0.0]), aim, 0.06, skin)
    return boxes


def _finger(pose: Array, root: Array, aim: Array, length: float, color: Color) -> list[Box]:
    """Return three parts from `root` (3,) along `aim` (3,), both in the hand's frame, each a little thinner."""
    knots = root + np.linspace(0.0, length, 4)[:, None] * aim
    parts = zip(knots[:-1], knots[1:], (0.018, 0.0165, 0.015), strict=True)
    placed = [(pose[:3, :3] @ a + pose[:3, 3], pose[:3, :3] @ b + pose[:3, 3], width) for a, b, width in parts]
    return [
        _between(a, b, (_ROUND * width, _ROUND * width), askew, color)
        for a, b, width in placed
        for askew in (0.0, math.pi / 4)
    ]


def _between(start: Array, end: Array, section: tuple[float, float], askew: float, color: Color) -> Box:
    """Return a box from start to end (m), its section turned about its length."""
    along = end - start
    length = float(np.linalg.norm(along))
    x = along / length
    y = np.cross((0.0, 0.0, 1.0) if abs(x[2]) < 0.9 else (1.0, 0.0, 0.0), x)
    y /= np.linalg.norm(y)
    rotation = np.column_stack([x, y, np.cross(x, y)]) @ turn(askew * _AXES[0])
    return Box(transform(rotation, (start + end) / 2), (length + section[0], *section), color)


def _flat(random: Random, place: Array) -> Array:
    """Return the (4, 4) pose of something flat at `place` (2,), randomly turned."""
    pose = shifted((float(place[0]), float(place[1]), 0.0))
    pose[:3, :3] = turn(random.uniform(-math.pi, math.pi) * _AXES[2])
    return pose


def _up_to(random: Random, room: float, usual: float) -> float:
    """Return a distance, mostly small: touching is as likely as hanging in front."""
    return float(min(random.uniform(0.0, 1.0) ** 2 * usual, room))


def _paint(random: Random) -> Color:
    """Return black, white, grey or coloured paint."""
    tone = float(random.choice([0.02, 0.75, random.uniform(0.02, 0.8)]))
    red, green, blue = np.clip(tone * random.uniform(0.5, 1.5, 3), 0.0, 1.0)
    return (float(red), float(green), float(blue)) if random.random() < 0.5 else (tone, tone, tone)


KINDS: dict[str, Callable[[Random, Terminal, Array, float], list[Box]]] = {
    "cable": _cable,
    "strap": _strap,
    "hand": _hand,
    "label": _label,
}
"""Function that draws each kind."""


def hidden_share(boxes: Sequence[Box], terminal: Terminal, camera_T_terminal: Array) -> float:  # noqa: N803
    """Return the share of the bars' touched faces that boxes (posed in the terminal's frame) hide from a camera."""
    low, high = terminal.corners()[:, 0], terminal.corners()[:, 2]
    place = (np.arange(_ACROSS) + 0.5) / _ACROSS, (np.arange(_DOWN) + 0.5) / _DOWN
    grid = np.stack([*np.meshgrid(*place), np.zeros((_DOWN, _ACROSS))], axis=-1).reshape(-1, 3)
    points = (low[:, None] + grid * (high - low)[:, None]).reshape(-1, 3)
    camera = np.linalg.inv(camera_T_terminal)[:3, 3]
    hidden = np.zeros(len(points), dtype=bool)
    for box in boxes:
        turned, half = box.pose[:3, :3], 0.5 * np.asarray(box.size)
        start = (camera - box.pose[:3, 3]) @ turned
        run = (points - camera) @ turned
        # Parameters at which the line of sight crosses each pair of the box's faces, in shares of its length.
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = (-half - start) / run, (half - start) / run
        enter, leave = np.minimum(first, second).max(axis=1), np.maximum(first, second).min(axis=1)
        hidden |= (enter < leave) & (enter < 1.0) & (leave > 0.0)
    return float(hidden.mean())
