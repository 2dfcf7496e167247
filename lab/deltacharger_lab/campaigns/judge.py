# SPDX-License-Identifier: Apache-2.0
"""Judges hostile dockings by the simulated world, with checks of its own: box, bars, contact, current.

Nothing here uses docking's or the simulation's formulas for clearance and workspace, so that an error there is seen.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_sim.mechanics import Mechanics
from deltacharger_sim.pads import Pose
from deltacharger_sim.world import World

_BOX = ((-0.060, 0.060), (-0.060, 0.060), (0.0, 0.110))  # m, the published workspace in charger_base
_HARD = 1.0  # A per servo, docking's hard_current
_FLOWS = 0.5  # A
_APART = 0.001  # m of gap; a smaller one is a bounce
_MOVED, _TURNED = 0.0015, math.radians(1.5)  # m and rad since an estimate, that make another contact of it
_STEP = 0.011  # s, one step of the world
OUTSIDE_MOST = 0.005  # m
PUSH_MOST = 0.1  # s
GRACE, GRACE_STALLED = 0.15, 0.35
"""s after the onset of a fault in which electrodes may still be live; the latter where docking itself is suspended."""
BY_HAND = ("STUCK", "TARGET_ROLLS", "CONTACTOR_WELDED")
"""Codes after which the arm or the contactor stays as it is until somebody comes."""
PERSON = (*BY_HAND, "SERVO_FAULT")
"""Codes after which a person must act before the next goal: docs/errors.md, "what to do"."""

COLUMNS: dict[str, tuple[type, str]] = {
    "scene": (str, "base scene of the docking"),
    "faults": (str, "names of its faults"),
    "drawn_faults": (str, "what was drawn of each"),
    "acted": (str, "names of those whose onset was reached"),
    "allowed": (str, "codes that it may end with"),
    "last_state": (str, "docking state in which the last outcome or the error came"),
    "outside": (float, "m, farthest excursion of the platform from the workspace box while a servo had torque"),
    "outside_limp": (float, "m, where gravity and the target put a limp arm"),
    "push_over": (float, "s that the servos pushed harder than 1 A (hard_current) of each does there"),
    "closed_unmeasured": (int, "times that the contactor was ordered to close on a contact that was not measured"),
    "live_unsafe": (float, "s live while a bar lay on a wrong bar, later than a grace time after each onset"),
    "live_short": (float, "s live while a bar joined both wrong bars, later than that"),
    "live_apart": (float, "s live without contact, later than that"),
    "live_unsafe_all": (float, "s live while a bar lay on a wrong bar"),
    "live_apart_all": (float, "s live without contact"),
    "touched_live": (int, "times that live electrodes met the target, later than that"),
    "left_live": (int, "times that electrodes parted while current flowed, later than that"),
    "probed_live": (int, "times that the probe was connected to live electrodes"),
    "goals": (int, "goals that were accepted"),
    "outcomes": (int, "their outcomes"),
    "next_code": (str, "name of the code of the goal after the faults were removed; empty = a person must act first"),
    "next_message": (str, "its message of a failure"),
    "next_time": (float, "s that it took"),
    "broken": (str, "laws that were broken"),
}
"""Result columns of a hostile docking, with type, unit and meaning."""

LAWS = {
    "crashed": "an exception left docking",
    "outcome": "a goal had no outcome, or two",
    "code": "a code that its faults do not explain",
    "next": "with the faults gone the next goal failed, and no code asked for a person",
    "box": "the platform was more than 5 mm outside its box while a servo had torque",
    "push": "the servos pushed above their bound for more than 0.1 s",
    "unmeasured": "the contactor was ordered to close on a contact that was not measured",
    "clearance": "live without clearance, later than 0.15 s after the onset",
    "short": "live and shorted, later than 0.15 s after the onset",
    "apart": "live without contact, later than 0.15 s after the onset",
    "touched": "live electrodes met the target, later than 0.15 s after the onset",
    "lifted": "the electrodes parted while current flowed, later than 0.15 s after the onset",
    "probed": "the probe was connected to live electrodes",
}
"""What no docking may do, whatever its faults."""

Corners = list[tuple[float, float]]


class WorldJudge:
    """Watches a world step by step.

    Attributes:
        found: columns that need no more than the world.
        excuses: from each onset the time (s, s) in which electrodes may still be live.
    """

    def __init__(self) -> None:
        numbers = ("outside", "outside_limp", "push_over", "live_unsafe", "live_short", "live_apart")
        self.found: dict[str, float] = dict.fromkeys((*numbers, "live_unsafe_all", "live_apart_all"), 0.0)
        self.found |= dict.fromkeys(("closed_unmeasured", "touched_live", "left_live", "probed_live"), 0)
        self.excuses: list[tuple[float, float]] = []
        self._measured: Pose | None = None  # of the last estimate
        self._parted = True  # since the last estimate
        self._was_apart = self._apart = True  # farther than a bounce; without contact
        self._current = 0.0
        self._lies: tuple[Pose, bool, bool] | None = None

    def look(self, world: World, dt: float, torque: bool = True) -> None:
        """Take a step of `dt` s that has just ended; `torque`: whether a servo was ordered to have it."""
        mechanics, found = world.mechanics, self.found
        where = "outside" if torque else "outside_limp"
        for value, (low, high) in zip(mechanics.position, _BOX, strict=True):
            found[where] = max(found[where], low - value, value - high)
        touches = mechanics.contact_force > 0.0
        if touches and isinstance(mechanics, Mechanics):
            bound = mechanics.push_of(_HARD * world.parameters.servo.torque_constant)
            found["push_over"] += dt if mechanics.servo_push() > bound else 0.0
        far = mechanics.gap > _APART
        self._parted |= far
        excused = any(begin <= world.time <= end for begin, end in self.excuses)
        if world.circuit.closed:
            self._look_live(world, dt, touches, excused)
            found["touched_live"] += touches and self._was_apart and not excused
        found["left_live"] += not touches and not self._apart and abs(self._current) >= _FLOWS and not excused
        self._was_apart = far or (self._was_apart and not touches)
        self._apart, self._current = not touches, world.circuit.current

    def _look_live(self, world: World, dt: float, touches: bool, excused: bool) -> None:
        found, pose = self.found, world.misalignment
        if not touches or pose is None:
            found["live_apart_all"] += dt
            found["live_apart"] += 0.0 if excused else dt
            return
        if self._lies is None or self._lies[0] != pose:
            self._lies = pose, *lies_wrong(pose)
        _, wrong, short = self._lies
        found["live_unsafe_all"] += dt if wrong else 0.0
        if not excused:
            found["live_unsafe"] += dt if wrong else 0.0
            found["live_short"] += dt if short else 0.0

    def measured(self, world: World) -> None:
        """Take an estimate that is being answered now."""
        self._measured, self._parted = world.misalignment, world.misalignment is None

    def closing(self, world: World) -> None:
        """Take an order to close."""
        self.found["closed_unmeasured"] += self._parted or not _is_same(self._measured, world.misalignment)

    def probed(self, world: World) -> None:
        """Take a use of the probe."""
        self.found["probed_live"] += world.circuit.closed or abs(world.circuit.current) >= _FLOWS


def _is_same(one: Pose | None, two: Pose | None) -> bool:
    """Return whether both are poses of one contact."""
    if one is None or two is None:
        return False
    return math.hypot(one[0] - two[0], one[1] - two[1]) <= _MOVED and abs(one[2] - two[2]) <= _TURNED


def lies_wrong(pose: Pose) -> tuple[bool, bool]:
    """Return whether a bar of the charger lies on a wrong bar of the target, and whether one joins both of them.

    Args:
        pose: x (m), y (m) and angle (rad) of the target in end_effector.
    """
    x, y, angle = pose
    away = 0.5 * (BAR_GAP + BAR_HEIGHT)
    ours = {side: _bar(0.0, 0.0, 0.0, side * away) for side in (1, -1)}
    theirs = {side: _bar(x, y, angle, side * away) for side in (1, -1)}
    on = {(a, b): overlap(ours[a], theirs[b]) for a in ours for b in theirs}
    wrong = on[1, -1] or on[-1, 1]
    joins = any(on[side, 1] and on[side, -1] for side in ours) or any(on[1, side] and on[-1, side] for side in theirs)
    return wrong, joins


def _bar(x: float, y: float, angle: float, off: float) -> Corners:
    """Return the corners of a bar `off` m across the middle of a terminal at x, y (m), turned."""
    half, high = 0.5 * BAR_LENGTH, 0.5 * BAR_HEIGHT
    cosine, sine = math.cos(angle), math.sin(angle)
    corners = ((-half, off - high), (half, off - high), (half, off + high), (-half, off + high))
    return [(x + cosine * u - sine * v, y + sine * u + cosine * v) for u, v in corners]


def overlap(one: Corners, two: Corners) -> bool:
    """Return whether two convex polygons share an area: no edge of either has the other wholly on its outside."""
    return not any(_parts(a, b) for a, b in ((one, two), (two, one)))


def _parts(one: Corners, two: Corners) -> bool:
    """Return whether an edge of `one`, counter-clockwise, has all of `two` on its outside."""
    return any(
        all((bx - ax) * (y - ay) - (by - ay) * (x - ax) <= 0.0 for x, y in two)
        for (ax, ay), (bx, by) in zip(one, (*one[1:], one[0]), strict=True)
    )


def nothing() -> dict[str, Any]:
    """Return the columns of a docking that was not judged."""
    empty: dict[type, Any] = {int: 0, float: math.nan, str: ""}
    return {name: empty[kind] for name, (kind, _) in COLUMNS.items()}


def broken(row: Mapping[str, Any], scene: Sequence[str]) -> list[str]:
    """Return the laws that a docking broke.

    Args:
        row: its results.
        scene: codes of its base scene without faults.
    """
    codes = [row[name] for name in ("code_name", "ended", "undocked") if row[name]]
    failed = row["code_name"] == "CRASHED"
    late = failed and row["error"].rstrip().rsplit("\n", 1)[-1].startswith("TimeoutError")
    tests = {
        "crashed": failed and not late,
        "outcome": late or (not failed and row["outcomes"] != row["goals"]),
        "code": not failed and not set(codes) <= set(row["allowed"].split()),
        "next": bool(row["next_code"]) and row["next_code"] not in scene and not set(codes) & set(PERSON),
        "box": row["outside"] > OUTSIDE_MOST,
        "push": row["push_over"] > PUSH_MOST,
        "unmeasured": row["closed_unmeasured"] > 0,
        "clearance": row["live_unsafe"] > _STEP,
        "short": row["live_short"] > _STEP,
        "apart": row["live_apart"] > _STEP,
        "touched": row["touched_live"] > 0,
        "lifted": row["left_live"] > 0,
        "probed": row["probed_live"] > 0,
    }
    return [name for name in LAWS if tests[name]]
