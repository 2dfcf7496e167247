# SPDX-License-Identifier: Apache-2.0
"""One hostile docking: a charger whose world, pads and answers are distorted by faults, and its judge."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE, LONGEST_LEASE
from deltacharger_docking.codes import DockingError, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import (
    DockGoal,
    DockingOutcome,
    ElectrodePose,
    Observation,
    Reply,
    Request,
    Service,
)
from deltacharger_lab.campaigns import hostile, judge
from deltacharger_lab.campaigns.faults import Acting, HostileFault, Reading, ServoOrder
from deltacharger_sim.circuit import Circuit
from deltacharger_sim.emulators.power import Outputs
from deltacharger_sim.pads import Lean, PadSource, Pose
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.virtual import quick_charger, virtual_charger
from deltacharger_sim.world import World

_FINEST = 0.005  # s of the world's steps while the target moves
_REMEMBERED = 0.6  # s of observations
_WATCHED = (3.0, 8.0)  # s of charging
_REMOVED = 0.3  # s in which a target comes back
_RECOVERY = 1.5  # s between the removal and the next goal
_HOME = 90.0  # s for an arm on its way back
_NEXT = 420.0  # s for the next goal
_STILL = (0.0, 0.0, 0.0, 0.0)


class FaultyCircuit(Circuit):
    """A power stage whose contactor does not pull in, welds, drops out or feeds a target that takes nothing.

    Args:
        parameters: of the world.
        trial: is told of the probe and of orders to close.
        world: of the circuit.

    Attributes:
        refuses: whether the contactor's coil has no effect.
    """

    def __init__(self, parameters: WorldParameters, trial: Trial, world: World) -> None:
        super().__init__(parameters.circuit, parameters.port, parameters.stage)
        self.refuses = False
        self._trial, self._world = trial, world

    def drive(self, outputs: Outputs) -> None:
        """Take the board's orders."""
        if outputs.precharge and not self._outputs.precharge:
            self._trial.judge.closing(self._world)
        super().drive(outputs._replace(contactor=outputs.contactor and not self.refuses))

    def drop_out(self) -> None:
        """Open the contactor although its coil is driven."""
        self._pulled = math.inf
        self._break()

    def probe(self) -> tuple[float, float]:
        """Return what the probe measures."""
        self._trial.judge.probed(self._world)
        return super().probe()

    def weld(self, on: bool) -> None:
        """Let the contactor stick from now on if closed, else once it has closed; False = replace it."""
        self._parameters = replace(self._parameters, welded=on)
        self._stuck = on and (self._stuck or self.closed)

    def take_current(self, on: bool) -> None:
        """Let the target take current, or none."""
        self.port.parameters = replace(self.port.parameters, accepts=on)


class FaultyWorld(World):
    """A world between whose plant and readings faults act.

    Args:
        trial: with the faults and the judge.
        given: arguments of `World`.
    """

    def __init__(self, trial: Trial, *given: Any) -> None:
        super().__init__(*given)
        self.circuit: FaultyCircuit = FaultyCircuit(self.parameters, trial, self)
        self._trial = trial
        self._orders = [ServoOrder(False, angle, 0.0, 1.0, 1.0) for angle in self.mechanics.angles]
        self._displaced = _STILL

    def command(
        self,
        index: int,
        enabled: bool,
        reference: float,
        current_limit: float,
        gain: float = 1.0,
        braking: float = 1.0,
    ) -> None:
        """Take an order to a servo; faults change it in each step."""
        aim = reference if math.isfinite(reference) else self._orders[index].reference
        self._orders[index] = ServoOrder(enabled, aim, current_limit, gain, braking)
        self._order(index)

    def servo(self, index: int) -> Reading:
        """Return the reading of a servo, distorted."""
        reading = super().servo(index)
        for acting in self._trial.active("reading"):
            reading = acting.fault.reading(acting, index, reading)  # type: ignore[misc]
        return reading

    def step(self, dt: float | None = None) -> None:
        """Advance by `dt` s in steps fine enough for the faults."""
        left = self.dt if dt is None else dt
        while left > 1e-9:
            now = min(left, _FINEST) if self._trial.has("target") else left
            left -= now
            self._one_step(now)

    def _one_step(self, dt: float) -> None:
        self._trial.pass_time(self.time, dt)
        if self._trial.has("order"):
            for index in range(3):
                self._order(index)
        if self._trial.has("target"):
            self._displace()
        super().step(dt)
        self._trial.judge.look(self, dt, any(order.enabled for order in self._orders))

    def _order(self, index: int) -> None:
        order = self._orders[index]
        for acting in self._trial.active("order"):
            order = acting.fault.order(acting, index, order)  # type: ignore[misc]
        super().command(index, *order)

    def _displace(self) -> None:
        moves = [acting.fault.target(acting) for acting in self._trial.of("target")]  # type: ignore[misc]
        place = tuple(map(sum, zip(_STILL, *moves, strict=True)))
        if place == self._displaced:
            return
        dx, dy, dz, turn = (now - before for now, before in zip(place, self._displaced, strict=True))
        self._displaced = place  # type: ignore[assignment]
        target = self.parameters.target
        moved = replace(target, x=target.x + dx, y=target.y + dy, z=target.z + dz, roll=target.roll + turn)
        self.parameters = replace(self.parameters, target=moved)
        self.mechanics.carry(dx, dy)
        if dz:
            self.mechanics.move_along(dz)
        self._follow_contact()  # a turn alone moves nothing, but shifts the bars


class FaultyPads:
    """Pads whose frames faults change."""

    def __init__(self, pads: PadSource, trial: Trial) -> None:
        self._pads, self._trial = pads, trial

    def begin_docking(self) -> Pose:
        """Draw a new docking."""
        return self._pads.begin_docking()

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> Any:
        """Return frames as `PadSource.frames`, distorted."""
        found = self._pads.frames(time, pose, force, count, period, lean)
        for acting in self._trial.active("frame"):
            found = acting.fault.frame(acting, found)  # type: ignore[misc]
        return found

    def sample(self, time: float, pose: Pose | None, force: float, lean: Lean | None = None) -> tuple[Any, Any]:
        """Read both pads once."""
        left, right = self.frames(time, pose, force, 1, 0.0, lean)[0]
        return left, right


class _Suffers(virtual_charger.VirtualCharger):
    """What exact and quick chargers have in common under faults.

    Args:
        trial: with the faults and the judge.
        given: arguments of the charger.
    """

    def __init__(self, trial: Trial, *given: Any, **named: Any) -> None:
        self._trial = trial
        super().__init__(*given, **named)
        self.distort = trial.distort
        self._stepped = 0.0  # s, last step of the machine
        trial.charger = self

    def _make_world(self, world: WorldParameters, tactile: Any, seed: int) -> World:
        return FaultyWorld(self._trial, world, tactile, seed)

    def begin(self, goal: DockGoal) -> None:
        """Start a Dock goal; raises the machine's refusal."""
        super().begin(goal)
        self._trial.begin()

    def undock(self, limit: float = 60.0) -> DockingOutcome:
        """Serve an Undock goal to its end."""
        self._trial.begin()
        return super().undock(limit)

    def _step(self) -> None:
        self._trial.see(self.machine.status.state)
        for again in range(self._trial.steps()):
            self._trial.again, before = again > 0, self.outcome
            super()._step()
            self._stepped = self.now
            self._trial.outcomes += self.outcome is not None and self.outcome is not before
        if self._energised and self.now - self._stepped > LONGEST_LEASE:
            self.power.open(self.now)

    def _accept(self, request: Request) -> None:
        super()._accept(request)
        late = sum(a.fault.late(a, request.service) for a in self._trial.active("late"))  # type: ignore[misc]
        self._pending[-1].due += late

    def _reply(self, pending: virtual_charger.Pending) -> Reply:
        make: Callable[[], Reply | None] = lambda: super(_Suffers, self)._reply(pending)  # noqa: E731
        for acting in self._trial.active("reply"):
            make = _through(acting, pending.request, make)
        reply = make()
        if pending.request.service is Service.ESTIMATE and reply is not None and reply.estimate is not None:
            self._trial.judge.measured(self.world)
        return reply  # type: ignore[return-value]


def _through(acting: Acting, request: Request, make: Callable[[], Any]) -> Callable[[], Reply | None]:
    """Return what makes the reply to a request under a fault."""

    def made() -> Reply | None:
        found = acting.fault.reply(acting, request.service, make)  # type: ignore[misc]
        return None if found is None else replace(found, number=request.number)

    return made


class ExactHostile(_Suffers):
    """A charger under faults that computes everything as the nodes do."""


class QuickHostile(_Suffers, quick_charger.QuickCharger):
    """A quick charger under faults: while one lasts it is stepped every 10 ms.

    Where data or docking come late, lines are sent piece by piece, as by the node.
    """

    def _make_machine(self) -> DockingMachine:
        if not self._trial.nodelike:
            return quick_charger.QuickCharger._make_machine(self)
        planner = quick_charger.QuickPlanner(self.parameters, self.geometry)
        return DockingMachine(self.parameters, self.geometry, planner, profiles=self.profiles)

    def _stride(self, most: int) -> int:
        if self._trial.nodelike or self._trial.lasts():
            return 1
        left = (self._trial.next_onset() - self.now) / virtual_charger.TICK
        return min(
            quick_charger.QuickCharger._stride(self, most),
            math.ceil(left) if 1.0 < left < most else 1 if left <= 1.0 else most,
        )

    def _stands(self) -> bool:
        return not self._trial.lasts() and quick_charger.QuickCharger._stands(self)

    def _feels(self) -> bool:
        if not any(self._trial.active("frame")):
            return quick_charger.QuickCharger._feels(self)
        self._felt = self._read_at = None
        if not self._tared:
            return False
        self._felt = (self.feel(1, 0.0)[0] - self.baseline).clip(min=0.0)
        return bool(np.fmax.reduce(self._felt, axis=None) >= CONTACT_FORCE)


class Trial:
    """The faults of one docking, and its judgement.

    Args:
        scene: its base scene.
        seed: of the docking.
        faults: None = drawn by the seed.

    Attributes:
        judge: of the world.
        charger: set by the charger when it is made.
        again: whether the machine is being stepped a second time in a tick.
        outcomes: of goals so far.
        watched: s of charging.
    """

    def __init__(self, scene: str, seed: int, faults: list[Acting] | None = None) -> None:
        self.scene = scene
        self.faults = hostile.draw_faults(seed) if faults is None else faults
        self.judge = judge.WorldJudge()
        self.charger: _Suffers | None = None
        self.again = False
        self.goals = self.outcomes = 0
        self.nodelike = any(a.fault.nodelike for a in self.faults)
        self.watched = _WATCHED[0] + (seed % 1000) / 1000.0 * (_WATCHED[1] - _WATCHED[0])
        self._channels = {name: [a for a in self.faults if getattr(a.fault, name) is not None] for name in _CHANNELS}
        self._log: list[Observation] = []
        self._states: set[str] = set()
        self._last: Observation | None = None
        self._removed = False

    def pads(self, pads: PadSource) -> Any:
        """Return pads with the faults."""
        return FaultyPads(pads, self) if self.has("frame") else pads

    def has(self, channel: str) -> bool:
        """Return whether a fault of this docking acts on a channel."""
        return bool(self._channels[channel])

    def of(self, channel: str) -> list[Acting]:
        """Return the faults on a channel."""
        return self._channels[channel]

    def active(self, channel: str) -> list[Acting]:
        """Return the faults that distort a channel now."""
        found = self._channels[channel]
        return [a for a in found if a.active] if found else found

    def lasts(self) -> bool:
        """Return whether a fault lasts, or a target is still on its way back."""
        return any(a.lasting or (a.fault.target is not None and a.level > 0.0) for a in self.faults)

    def next_onset(self) -> float:
        """Return the time (s) of the next known onset."""
        return min((a.since for a in self.faults if a.since > a.now), default=math.inf)

    def begin(self) -> None:
        """Count a goal; with the first one, set the onsets that depend on it alone."""
        self.goals += 1
        if self.goals == 1:
            for acting in self.faults:
                if acting.onset in (hostile.GOAL, hostile.TIMED):
                    acting.begin(acting.delay)

    def see(self, state: State) -> None:
        """Set onsets that depend on docking's state."""
        if state.name in self._states or self._removed:
            return
        self._states.add(state.name)
        for acting in self.faults:
            if acting.onset == state.name:
                acting.begin(acting.now + acting.delay)

    def pass_time(self, now: float, dt: float) -> None:
        """Let faults come and go in the world's step of `dt` s that begins `now`."""
        for acting in self.faults:
            before = acting.on
            acting.now, acting.step, acting.log = now, dt, self._log
            acting.world = self.charger.world if self.charger is not None else None
            acting.on = on = acting.active
            if on and not before:
                acting.memory.clear()
                grace = judge.GRACE_STALLED if acting.fault.name == hostile.SUSPENDED else judge.GRACE
                if not any(begin == acting.since for begin, _ in self.judge.excuses):
                    self.judge.excuses.append((acting.since, acting.since + grace))
            if acting.fault.world is not None and (on or before):
                acting.fault.world(acting, acting.world, on)

    def distort(self, observation: Observation) -> Observation:
        """Return what docking sees."""
        if self.again and self._last is not None:
            return replace(self._last, replies=(), earlier=())
        self._log.append(observation)
        while self._log[0].time < observation.time - _REMEMBERED:
            self._log.pop(0)
        for acting in self.active("seen"):
            observation = acting.fault.seen(acting, observation)  # type: ignore[misc]
        self._last = observation
        return observation

    def steps(self) -> int:
        """Return how often docking is stepped in this tick."""
        found = self.active("steps")
        return min(a.fault.steps(a) for a in found) if found else 1  # type: ignore[misc]

    def remove(self) -> None:
        """End all faults; targets come back."""
        self._removed = True
        self.judge.excuses += [(acting.now, acting.now + judge.GRACE) for acting in self.faults]
        for acting in self.faults:
            if acting.now < acting.since:
                acting.since = math.inf
            acting.ramp = min(acting.ramp, _REMOVED)
            acting.end()

    def finish(self, codes: list[str], goal: ElectrodePose) -> dict[str, Any]:
        """Wait until the arm is back, remove the faults and send the next goal; return the columns about it.

        Args:
            codes: names of the codes so far.
            goal: pose of the electrodes.
        """
        charger = self.charger
        assert charger is not None
        machine = charger.machine
        charger.until(lambda: not machine.busy and machine.status.state is State.IDLE, _HOME)
        self.remove()
        charger.run(_RECOVERY)
        if set(codes) & set(judge.BY_HAND):
            return {}
        began = charger.now
        try:
            charger.begin(DockGoal(goal))
            outcome = charger.finish(_NEXT)
        except DockingError as error:
            return {"next_code": error.code.name, "next_message": str(error), "next_time": 0.0}
        said = "" if outcome.success else outcome.message
        return {"next_code": outcome.code.name, "next_message": said, "next_time": charger.now - began}

    def judged(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Return the columns of the judgement of a docking with these results."""
        acted = [a for a in self.faults if math.isfinite(a.since) and a.since <= a.now]
        found: dict[str, Any] = {
            "scene": self.scene,
            "faults": " ".join(a.fault.name for a in self.faults),
            "drawn_faults": "; ".join(a.text for a in self.faults),
            "acted": " ".join(a.fault.name for a in acted),
            "allowed": " ".join(sorted(hostile.allowed(self.scene, acted))),
            "last_state": self.charger.machine.status.state.name if self.charger is not None else "",
            "goals": self.goals,
            "outcomes": self.outcomes,
            **self.judge.found,
        }
        found["broken"] = " ".join(judge.broken({**row, **found}, hostile.SCENES[self.scene].split()))
        return found


_CHANNELS = [name for name in HostileFault.__annotations__ if name in ("order", "reading", "frame", "seen", "reply")]
_CHANNELS += ["late", "target", "world", "steps"]
