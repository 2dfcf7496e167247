# SPDX-License-Identifier: Apache-2.0
"""A charger in virtual time whose nodes can be killed or stopped, and whose inputs can be wrong, late or frozen.

The nodes' own rules are imitated: the board opens 0.1 s after tactile_node stops, a lease lapses 0.25 s after
docking_node stops, servos hold their place, and a lapsed lease is refused until the contactor was opened.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from deltacharger_docking.codes import Code, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockGoal, Observation, Reply, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_lab.campaigns.virtual_charger import GOAL, VirtualCharger
from deltacharger_sim.parameters import ServoParameters, TargetParameters, WorldParameters

from .. import quick

SERVED_BY = {
    Service.TORQUE_ON: "servo_node",
    Service.TORQUE_OFF: "servo_node",
    Service.TARE: "tactile_node",
    Service.PROBE: "tactile_node",
    Service.OPEN: "tactile_node",
    Service.ESTIMATE: "misalignment_node",
    Service.DETECT: "electrode_detector_node",
}
_HEARTBEAT, _LEASE = 0.1, 0.25  # s
_JUST_BEHIND = 0.05  # s
_SERVO = ("angles", "currents", "torque_enabled")
_PADS = ("tactile_contact", "tared")
_POWER = ("contactor_closed", "charge_current", "target_voltage", "power_fault")
_TOPICS = {"servo_state": _SERVO, "tactile_frame": _PADS, "charger_power": _POWER}


class Faulty(VirtualCharger):
    """A charger with quick steps whose target is 6 mm off in both axes, so that every phase occurs.

    Args:
        off: distance (m) of the target in each axis.
        nearer: distance (m) of the target before the place in the goal.
        parameters: of docking, other than the quick ones.

    Attributes:
        silent: the node that neither sends nor receives; '' = none.
        shown: values of the observation that a fault replaces.
        frozen: the topic that repeats itself under new stamps; '' = none.
        asked: all requests.
        held: service whose answers are kept back, in `echoes`.
        twice: whether each answer is repeated in every following tick.
    """

    def __init__(self, off: float = 0.006, nearer: float = 0.0, **parameters: object) -> None:
        target = TargetParameters(x=off, y=off, z=0.080 - nearer, roll=0.03)
        world = WorldParameters(target=target, servo=ServoParameters(damping=quick.DAMPING), step=0.01)
        super().__init__(world, DockingParameters(**{**quick.STEPS, **parameters}), 1)
        self.silent = self.frozen = ""
        self.since = 0.0
        self.shown: Mapping[str, Any] = MappingProxyType({})
        self.asked: list[Request] = []
        self.echoes: list[Reply] = []
        self.held: Service | None = None
        self.twice = False
        self._last = self.observe()
        self._lapsed = False
        self.distort = self.told

    def silence(self, node: str) -> None:
        self.silent, self.since = node, self.now
        if node == "servo_node":
            self._trajectory, self._goal = (), self._angles()
        self._lapsed = node in ("tactile_node", "docking_node") and self.plant.read_power()[3]

    def resume(self) -> None:
        """Continue the stopped node, whose pending requests are answered late, and show true values again."""
        self.silent, self.shown = "", {}

    def restart(self) -> None:
        """End the fault; pending requests of a killed node are lost."""
        if self.silent == "docking_node":
            self.machine = DockingMachine(self.parameters)
            self.outcome = None
            self._pending, self._replies = [], []
        elif self.silent == "servo_node":
            self._torque = False
        self._pending = [each for each in self._pending if SERVED_BY[each.request.service] != self.silent]
        self.resume()

    def told(self, observation: Observation) -> Observation:
        """Return an observation as the faults change it."""
        kept, ages, age = _TOPICS.get(self.frozen, ()), {}, self.now - self.since
        if self.silent == "servo_node":
            kept, ages = _SERVO, {"servo_age": age}
        elif self.silent == "tactile_node":
            kept, ages = _PADS + _POWER, {"tactile_age": age, "power_age": age}
        values = {name: getattr(self._last, name) for name in kept}
        refused = "a close needs a probe younger than 2 s" if self._lapsed and self._energised else ""
        self._last = replace(observation, **{"contactor_refusal": refused, **values, **ages, **self.shown})
        return self._last

    def _sample(self) -> None:
        if self._pending:  # frames that nobody reads cost half of a docking's computing time
            super()._sample()

    def _feels(self) -> bool:
        return self.world.mechanics.contact_force > 5.0

    def _accept(self, request: Request) -> None:
        self.asked.append(request)
        super()._accept(request)

    def _serve(self) -> None:
        away = [each for each in self._pending if SERVED_BY[each.request.service] == self.silent]
        self._pending = [each for each in self._pending if each not in away]
        super()._serve()
        self._pending += away
        if self.twice:
            self._replies += self.echoes
            self.echoes += [reply for reply in self._replies if reply not in self.echoes]
        elif self.held is not None:
            held = {request.number for request in self.asked if request.service is self.held}
            late = [reply for reply in self._replies if reply.number in held]
            self.echoes += late
            self._replies = [reply for reply in self._replies if reply not in late]

    def _step(self) -> None:
        gone = self.now - self.since
        if self.silent == "tactile_node" and gone >= _HEARTBEAT:
            self.plant.open_contactor(False)
        if self.silent == "docking_node":
            if gone >= _LEASE:
                self.plant.open_contactor(True)
            return
        super()._step()

    def _follow(self, command: Command) -> None:
        if self.silent == "servo_node":
            command = replace(command, trajectory=None)
        if self.silent == "tactile_node":
            command = replace(command, energise=self._energised)
        elif not command.energise:
            self._lapsed = False
        super()._follow(command)

    @property
    def closed(self) -> bool:
        """Whether the contactor is really closed."""
        return self.plant.read_power()[3]

    @property
    def has_torque(self) -> bool:
        """Whether the servos really have torque."""
        return self._torque

    def reach(self, state: State) -> None:
        """Dock, and undock if the state requires it, until just after the state's beginning."""
        if self.machine.status.docked:
            self.go_home()
        self.outcome = None
        self.begin(DockGoal(None if state is State.LOCATE else GOAL))
        if state is State.RETRACT:
            assert self.finish(60.0).success
            self.outcome = None
            self.machine.start_undock("", self.observe())
        self.until(lambda: self.machine.status.state is state or self.outcome is not None, 60.0)
        assert self.machine.status.state is state, self.outcome
        if state is not State.LOCATE:  # its only request is answered at once
            self.run(_JUST_BEHIND)

    def end(self, phase: State, expected: Code) -> Code:
        """Step until the goal has ended, or supervision of charging if it may; return the code."""
        watched = phase is State.CHARGING
        if watched and expected is Code.NONE:
            self.run(3.0)
            assert self.machine.status.charging
        else:
            failed = lambda: self.machine.status.code is not Code.NONE  # noqa: E731
            self.until(lambda: failed() or (not watched and self.outcome is not None), 40.0)
            if failed():
                self.until(lambda: self.machine.status.state is State.IDLE, 30.0)
        return self.machine.status.code

    def go_home(self) -> None:
        """Undock, which must succeed."""
        outcome = self.undock()
        assert outcome.success, outcome.message
        assert self.distance(self.parameters.home) < 0.012
        assert not self.has_torque

    def assert_never_hurt(self) -> None:
        """Nothing was shorted, energised without clearance, separated live or released live."""
        record = self.world.record
        assert record.energised_shorts == 0
        assert record.energised_unsafe == 0.0
        assert record.parted_live == 0
        assert record.unpowered_live == 0

    def distance(self, place: tuple[float, ...]) -> float:
        """Distance (m) of the platform from a place."""
        return math.dist(self.world.snapshot().position, place)
