# SPDX-License-Identifier: Apache-2.0
"""What faults distort in a hostile docking.

A fault acts on one or more channels between world and docking:
- order: of a servo, before the plant obeys it; only the plant changes.
- reading: of a servo; docking and servo_node's watch of the joints read it.
- frame: raw tactile frames (n, 2, 10, 10), N.
- seen: the observation, after all others.
- reply: of a service.
- target: displacement of the target, m and rad.
- world: called in each step of the world while the fault lasts, and once with `on` False after it.
- steps: of docking in a tick; usually one.
"""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from deltacharger_docking.observation import Observation, Reply, Service
from deltacharger_kinematics.geometry import Vector
from deltacharger_sim.world import World

_NONE = (0.0, 0.0, 0.0, 0.0)


class ServoOrder(NamedTuple):
    """ServoOrder to a servo: torque on, goal angle (rad), current bound (A), shares of its stiffness and damping."""

    enabled: bool
    reference: float
    limit: float
    gain: float
    braking: float


Reading = tuple[float, float, float, float, float]
"""Of a servo: rad, rad/s, A, V, °C."""


Answer = Callable[["Acting", Service, Callable[[], Reply | None]], Reply | None]
"""Makes the reply to a call under a fault; the last argument makes it without. None = no answer."""


@dataclass
class Acting:
    """A fault in one docking: what was drawn, and its state.

    Attributes:
        fault: of the table.
        onset: docking state, `GOAL` or `TIME`.
        delay: s from there to the onset.
        lasts: s; inf = until it is removed.
        flicker: Hz at which it comes and goes; 0 = it stays.
        servo, pad: which one it hits.
        size: in the fault's own unit.
        ramp: s in which a target moves.
        world: of the docking.
        since, until: s, beginning and end; inf = not yet.
        now, step: s, of the world's present step and its length.
        on: whether it distorts this step.
        log: observations of the last half second, undistorted.
        memory: values kept while it acts.
    """

    fault: HostileFault
    onset: str
    delay: float
    lasts: float
    flicker: float
    servo: int
    pad: int
    size: float
    ramp: float
    noise: random.Random
    world: World | None = None
    since: float = math.inf
    until: float = math.inf
    now: float = 0.0
    step: float = 0.0
    on: bool = False
    log: list[Observation] = field(default_factory=list)
    memory: dict[Any, Any] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """Return what was drawn, to run it again by hand."""
        end = "" if math.isinf(self.lasts) else f" for {self.lasts:.2f} s"
        often = f" at {self.flicker:.1f} Hz" if self.flicker else ""
        hits = f"servo {self.servo + 1}, pad {self.pad}, {self.size:.4g} {self.fault.unit}".rstrip()
        return f"{self.fault.name} ({hits}) from {self.onset} + {self.delay:.2f} s{end}{often}"

    @property
    def lasting(self) -> bool:
        """Whether it has begun and not ended, flickering or not."""
        return self.since <= self.now < self.until

    @property
    def active(self) -> bool:
        """Whether it distorts now."""
        return self.lasting and (self.flicker == 0.0 or (self.now - self.since) * self.flicker % 1.0 < 0.5)

    @property
    def level(self) -> float:
        """Share of a target's move that is done: rises from the onset, falls from the end."""
        risen = min(max((min(self.now, self.until) - self.since) / self.ramp, 0.0), 1.0)
        return risen if self.now < self.until else max(risen - (self.now - self.until) / self.ramp, 0.0)

    def begin(self, at: float) -> None:
        """Let it begin at `at` s."""
        self.since, self.until = at, at + self.lasts

    def end(self) -> None:
        """Let it end now, or never begin."""
        self.until = min(self.until, self.now)

    def age(self) -> float:
        """Return how long (s) it has acted without a break."""
        return self.now - float(self.memory.setdefault("from", self.now))


@dataclass(frozen=True)
class HostileFault:
    """One fault.

    Attributes:
        name: unique.
        kind: faults of one kind are drawn equally often as those of another.
        codes: how a docking with it may end, besides what its scene refuses; NONE where it can be harmless.
        sizes: range that its size is drawn from.
        choices: sizes to choose from instead.
        unit: of the size.
        onsets: docking states from which it may begin; empty = all, and at a time.
        flickers: whether it may come and go.
        lasts: range of its duration, s; empty = drawn, or until it is removed.
        nodelike: docking must send its lines piece by piece and be stepped every 10 ms, as in the node.
    """

    name: str
    kind: str
    codes: str
    sizes: tuple[float, float] = (0.0, 0.0)
    choices: tuple[float, ...] = ()
    unit: str = ""
    onsets: tuple[str, ...] = ()
    flickers: bool = True
    lasts: tuple[float, ...] = ()
    nodelike: bool = False
    order: Callable[[Acting, int, ServoOrder], ServoOrder] | None = None
    reading: Callable[[Acting, int, Reading], Reading] | None = None
    frame: Callable[[Acting, Any], Any] | None = None
    seen: Callable[[Acting, Observation], Observation] | None = None
    reply: Answer | None = None
    late: Callable[[Acting, Service], float] | None = None
    target: Callable[[Acting], tuple[float, float, float, float]] | None = None
    world: Callable[[Acting, Any, bool], None] | None = None
    steps: Callable[[Acting], int] | None = None


# Servos


def stays(a: Acting, index: int, order: ServoOrder) -> ServoOrder:
    """Keep the order that the servo had."""
    return a.memory.setdefault("order", order) if index == a.servo else order


def slow(a: Acting, index: int, order: ServoOrder) -> ServoOrder:
    """Let the servo's goal move by at most `size` rad/s."""
    if index != a.servo:
        return order
    before, most = a.memory.get("goal", order.reference), a.size * (a.now - a.memory.get("at", a.now))
    goal = min(max(order.reference, before - most), before + most)
    a.memory |= {"goal": goal, "at": a.now}
    return order._replace(reference=goal)


def limp(a: Acting, index: int, order: ServoOrder) -> ServoOrder:
    """Take the torque off the servo."""
    return order._replace(enabled=order.enabled and index != a.servo)


def rubs(a: Acting, world: Any, on: bool) -> None:
    """Let the servo's gear rub with `size` N·m."""
    usual = world.parameters.servo.friction
    world.mechanics.set_friction(tuple(a.size if on and index == a.servo else usual for index in range(3)))


def _one(values: Vector, index: int, value: float) -> Vector:
    changed = list(values)
    changed[index] = value
    return changed[0], changed[1], changed[2]


def nan_angle(a: Acting, seen: Observation) -> Observation:
    """Report one angle as NaN."""
    earlier = tuple((time, _one(angles, a.servo, math.nan), currents) for time, angles, currents in seen.earlier)
    return dataclasses.replace(seen, angles=_one(seen.angles, a.servo, math.nan), earlier=earlier)


def frozen_encoder(a: Acting, index: int, reading: Reading) -> Reading:
    """Keep the angle (rad) that the encoder reads."""
    if index != a.servo:
        return reading
    return a.memory.setdefault("angle", reading[0]), 0.0, *reading[2:]


def by_frozen_encoder(a: Acting, index: int, order: ServoOrder) -> ServoOrder:
    """Let the servo's own loop control the frozen angle."""
    if index != a.servo or a.world is None:
        return order
    true = a.world.mechanics.angles[index]
    return order._replace(reference=true + order.reference - a.memory.setdefault("angle", true))


def slipped(a: Acting, index: int, reading: Reading) -> Reading:
    """Let the encoder read `size` rad more."""
    return (reading[0] + (a.size if index == a.servo else 0.0), *reading[1:])


def by_slipped(a: Acting, index: int, order: ServoOrder) -> ServoOrder:
    """Let the servo's own loop control the slipped angle."""
    return order._replace(reference=order.reference - (a.size if index == a.servo else 0.0))


def noisy(a: Acting, index: int, reading: Reading) -> Reading:
    """Add noise of `size` rad (σ) to all angles."""
    return (reading[0] + a.noise.gauss(0.0, a.size), *reading[1:])


def current(change: Callable[[Acting, float, int], float]) -> Callable[[Acting, int, Reading], Reading]:
    """Change the currents: of one servo, or of all where the pad drawn is 1."""

    def changed(a: Acting, index: int, reading: Reading) -> Reading:
        hit = a.pad == 1 or index == a.servo
        return (*reading[:2], change(a, reading[2], index), *reading[3:]) if hit else reading

    return changed


# Pads, and data that come late


def one_pad(a: Acting, frames: Any) -> Any:
    """Let one pad read 0 N."""
    changed = np.array(frames)
    changed[:, a.pad] = 0.0
    return changed


def touched(a: Acting, frames: Any) -> Any:
    """Let eight taxels of one pad read `size` N more."""
    changed = np.array(frames)
    changed[:, a.pad, 4:6, 3:7] += a.size
    return changed


def stale(a: Acting, seen: Observation) -> Observation:
    """Repeat the last touch, which grows older."""
    touch = a.memory.setdefault("touch", seen.tactile_contact)
    return dataclasses.replace(seen, tactile_contact=touch, tactile_age=a.age())


def _before(a: Acting, seen: Observation) -> Observation:
    """Return the last observation that is at least `size` s older."""
    return next((old for old in reversed(a.log) if old.time <= seen.time - a.size), a.log[0] if a.log else seen)


def servo_late(a: Acting, seen: Observation) -> Observation:
    """Report servo data that are at least `size` s old."""
    old = _before(a, seen)
    return dataclasses.replace(
        seen, angles=old.angles, currents=old.currents, servo_age=seen.time - old.time, earlier=()
    )


def tactile_late(a: Acting, seen: Observation) -> Observation:
    """Report a touch that is at least `size` s old."""
    old = _before(a, seen)
    return dataclasses.replace(seen, tactile_contact=old.tactile_contact, tactile_age=seen.time - old.time)


# Power


def power_silent(a: Acting, seen: Observation) -> Observation:
    """Repeat the last power data, which grow older."""
    names = ("contactor_closed", "charge_current", "target_voltage", "battery_voltage", "power_fault")
    kept = a.memory.setdefault("power", {name: getattr(seen, name) for name in names})
    return dataclasses.replace(seen, power_age=a.age(), **kept)


def sees(**values: Any) -> Callable[[Acting, Observation], Observation]:
    """Replace fields of the observation; None = by the fault's size."""

    def changed(a: Acting, seen: Observation) -> Observation:
        given: dict[str, Any] = {name: a.size if value is None else value for name, value in values.items()}
        return dataclasses.replace(seen, **given)

    return changed


def leaks(a: Acting, seen: Observation) -> Observation:
    """Report `size` A while the contactor is open."""
    return seen if seen.contactor_closed else dataclasses.replace(seen, charge_current=a.size)


def opens(_: Acting, world: Any, on: bool) -> None:
    """Open the contactor at once."""
    if on and world.circuit.closed:
        world.circuit.drop_out()


def refuses(_: Acting, world: Any, on: bool) -> None:
    """Let the contactor refuse to close."""
    world.circuit.refuses = on


def welds(_: Acting, world: Any, on: bool) -> None:
    """Let the contactor stick once it is closed."""
    world.circuit.weld(on)


def idles(_: Acting, world: Any, on: bool) -> None:
    """Let the target take no current."""
    world.circuit.take_current(not on)


# Services


def silent(*services: Service) -> Answer:
    """Leave calls of these services without effect and answer."""
    return lambda _, service, make: None if service in services else make()


def refused(*services: Service) -> Answer:
    """Refuse calls of these services, which have no effect."""
    return lambda _, service, make: Reply(0, False, "refused") if service in services else make()


def answers(service: Service, **values: Any) -> Answer:
    """Replace fields of one service's reply; None = by the fault's size."""

    def changed(a: Acting, asked: Service, make: Callable[[], Reply | None]) -> Reply | None:
        reply = make()
        given: dict[str, Any] = {name: a.size if value is None else value for name, value in values.items()}
        return dataclasses.replace(reply, **given) if asked is service and reply is not None else reply

    return changed


def estimates(
    change: Callable[[Acting, Any], dict[str, Any]],
) -> Answer:
    """Change fields of the estimates."""

    def changed(a: Acting, service: Service, make: Callable[[], Reply | None]) -> Reply | None:
        reply = make()
        if service is not Service.ESTIMATE or reply is None or reply.estimate is None:
            return reply
        return dataclasses.replace(reply, estimate=dataclasses.replace(reply.estimate, **change(a, reply.estimate)))

    return changed


# Target


def sideways(a: Acting) -> tuple[float, float, float, float]:
    """Move the target by `size` m in any direction across z."""
    way, turn = a.level * abs(a.size), math.copysign(1.0, a.size) * a.ramp * 40.0  # any direction, by what was drawn
    return way * math.cos(turn), way * math.sin(turn), 0.0, 0.0


def shakes(a: Acting) -> tuple[float, float, float, float]:
    """Shake the target by `size` m along y at 8 to 20 Hz, for half of the draws by 3/4 of it along z too."""
    if not a.lasting:
        return _NONE
    rate = 8.0 + 12.0 * min(a.ramp, 1.0)  # Hz
    swing = a.size * math.sin(2.0 * math.pi * rate * (a.now - a.since))
    return 0.0, swing, 0.75 * swing if a.pad else 0.0, 0.0


def rolls(a: Acting, world: Any, on: bool) -> None:
    """Let the target's brakes slip at `size` N."""
    world.mechanics.set_brakes(a.size if on else world.parameters.stand.brakes)
