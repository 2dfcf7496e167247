# SPDX-License-Identifier: Apache-2.0
"""Conditions of the vision report: rows of images of one kind, and the camera that the detector assumes."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from deltacharger_lab.reports.vision import strangers, views
from deltacharger_lab.reports.vision.views import APPROACH, DOCK, DrawnView
from deltacharger_vision.images import Intrinsics
from deltacharger_vision.rendering.camera import OAK_D
from deltacharger_vision.rendering.obstructions import KINDS

RANGES = (0.15, 0.17, 0.20, 0.25, 0.30, 0.40, 0.50, 0.60, 0.70, 0.80, 0.90, 1.00)
"""m."""
BAND = (0.15, 0.80)
"""Ranges of the targets, m."""
SIZES = ((320, 200), (640, 400), (1280, 800))
ANYWHERE = (0.2, 0.8)
RAYS, MUJOCO = "ray-caster", "MuJoCo"
BY_RANGE, DEFECTS, HIDDEN, ALARMS = "range", "defects", "hidden", "alarms"
INTRINSICS, LENS, SIZE, RENDERERS = "intrinsics", "lens", "size", "renderers"
BIASED, PIXELS, STRANGE = "biased", "pixels", "strange"
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
        change: changes the image that was taken.
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
    change: strangers.Change = strangers.unchanged


_DOCKED = partial(views.plain, nearest=DOCK[0], farthest=DOCK[1])
_IN_CLUTTER = partial(views.in_clutter, nearest=ANYWHERE[0], farthest=ANYWHERE[1])
_IN_ROOM = partial(views.in_room, nearest=ANYWHERE[0], farthest=ANYWHERE[1])


def _by_range() -> list[Condition]:
    draws = [(away, partial(views.plain, nearest=away, farthest=away)) for away in RANGES]
    return [
        Condition(f"{away:.2f} m", BY_RANGE, draw, 4 / 3, stream=number, away=away)
        for number, (away, draw) in enumerate(draws, 1)
    ]


def _anywhere(random: np.random.Generator, **changes: Any) -> DrawnView:
    return views.plain(random, *ANYWHERE).changed(**changes)


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
        Condition(ALONE, DEFECTS, partial(views.plain, nearest=0.15, farthest=0.6), color_only=True),
    ]  # fmt: skip


_THOUSAND = 20 / 3
_FIXED = (
    Condition("25 % of one bar hidden", HIDDEN, partial(views.covered, share=0.25)),
    Condition(HALF_HIDDEN, HIDDEN, partial(views.covered, share=0.5), 2.0),
    Condition("75 % of one bar hidden", HIDDEN, partial(views.covered, share=0.75)),
    Condition("15 % of both bars hidden", HIDDEN, partial(views.covered, share=0.15, both=True)),
    Condition("30 % of both bars hidden", HIDDEN, partial(views.covered, share=0.3, both=True)),
    Condition(CLUTTER, ALARMS, views.without, _THOUSAND, real=False),
    Condition(CLUTTER_FLAT, ALARMS, views.without, _THOUSAND, real=False, color_only=True),
    Condition("drawn rooms, decoys alone", ALARMS, views.decoys, 2.0, real=False),
    Condition("bars 0.75 and 1.3 times the size", ALARMS, views.other_size, real=False),
)
"""Rows of hidden bars and of false alarms."""


_SHARES = ((RAYS, 0.7), (MUJOCO, 0.3))
"""Share of the images for each renderer."""


def _obstructed() -> list[Condition]:
    """Return rows of each obstruction, of none, and of those that hide more than half: 1000, 1000, 200 images."""
    found = []
    for renderer, share in _SHARES:
        for kind in KINDS:
            draw: Draw = partial(views.obstructed, kind=kind)
            found.append(
                Condition(f"{kind}, {renderer}", OBSTRUCTED, draw, share * _THOUSAND / len(KINDS), renderer=renderer)
            )
        found.append(Condition(f"nothing, {renderer}", CLEAR, views.unobstructed, share * _THOUSAND, renderer=renderer))
    for kind in ("strap", "hand"):
        draw = partial(views.obstructed, kind=kind, most=1.0, least=views.MOST_HIDDEN)
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
    draw = partial(views.plain, nearest=BAND[0], farthest=BAND[1])
    cameras = [OAK_D.scaled(*size) for size in SIZES]
    return [Condition(f"{of.width} × {of.height} px", SIZE, draw, takes=of, assumed=of) for of in cameras]


def _renderers() -> list[Condition]:
    draws: dict[str, Draw] = {
        "docking": _DOCKED,
        "approaching": partial(views.plain, nearest=APPROACH[0], farthest=APPROACH[1]),
        "exposure × 0.2": partial(_anywhere, camera={"exposure": 0.2}),
        "highlight 4": partial(_anywhere, scene={"highlight": 4.0}),
        "clutter around": _IN_CLUTTER,
        "drawn room, decoys": _IN_ROOM,
        "half of one bar hidden": partial(views.covered, share=0.5),
    }
    return [
        Condition(f"{name}, {renderer}", RENDERERS, draw, 0.5, renderer=renderer)
        for name, draw in draws.items()
        for renderer in (RAYS, MUJOCO)
    ]


def _strange() -> list[Condition]:
    """Return rows of biased depth, of other pixels (1000 images each), and of other cameras and bars."""
    plain, leaning, s = strangers.plain, strangers.leaning, strangers
    rows = [
        ("any bias up to 2 %", BIASED, plain, s.biased, 0.8 * _THOUSAND),
        ("any bias up to 2 %, faces lean by 28–55°", BIASED, leaning, s.biased, 0.2 * _THOUSAND),
        ("depth unaligned, without frame_id", PIXELS, plain, s.unaligned, 0.3 * _THOUSAND),
        ("cut by 1–25 %, told", PIXELS, plain, s.cropped, 0.2 * _THOUSAND),
        ("cut by 1–25 %, not told", PIXELS, plain, s.cropped_untold, 0.1 * _THOUSAND),
        ("2 × 2 px binned, told", PIXELS, plain, s.binned, 0.2 * _THOUSAND),
        ("half as large, not told", PIXELS, plain, s.scaled_untold, 0.2 * _THOUSAND),
        *((f"depth × {factor:g}", STRANGE, plain, s.scaled_by(factor), 1.0) for factor in (0.98, 0.99, 1.01, 1.02)),
        *((f"disparity off by {off:g} px", STRANGE, plain, s.shifted_by(off), 1.0) for off in (0.3, 1.0)),
        *((f"no depth below {least:g} m", STRANGE, plain, s.only_beyond(least), 1.0) for least in (0.28, 0.35, 0.7)),
        ("no depth, faces lean by 28–55°", STRANGE, leaning, s.only_beyond(100.0), 3.0),
        ("depth of the plate ± 25 %", STRANGE, plain, s.noisy_plate, 1.0),
        ("depth of the bars mirrored", STRANGE, plain, s.mirrored_depth, 1.0),
        *((f"dirt on {100 * share:.0f} % of the bars", STRANGE, plain, s.dirty(share), 1.0) for share in (0.15, 0.3)),
        ("bars that mirror", STRANGE, s.mirrors, s.unchanged, 1.0),
        *(
            (f"plate reflects {share:g} (bars 0.65)", STRANGE, s.plate(share), s.unchanged, 1.0)
            for share in (0.2, 0.35)
        ),
        ("light frame 4 mm beside the bars", STRANGE, s.framed, s.unchanged, 1.0),
    ]
    return [Condition(name, group, draw, weight, change=change) for name, group, draw, change, weight in rows]


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
        _strange(),
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
