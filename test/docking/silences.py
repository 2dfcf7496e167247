# SPDX-License-Identifier: Apache-2.0
"""A charger in virtual time whose nodes can be killed or stopped, each with its topics and services.

The nodes' own rules are imitated: the board opens 0.1 s after tactile_node stops, a lease lapses 0.25 s after
docking_node stops, servos hold their place, and a lapsed lease is refused until the contactor was opened.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_docking.codes import Code, State
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.observation import Command, DockGoal, Observation, Service
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
OPEN_WITHIN = {"servo_node": 0.35, "tactile_node": 0.11, "docking_node": 0.35}
_HEARTBEAT, _LEASE = 0.1, 0.25  # s
_JUST_BEHIND = 0.05  # s


class Faulty(VirtualCharger):
    """A charger with quick steps whose target is 6 mm off in both axes, so that every phase occurs.

    Args:
        nearer: distance (m) of the target before the place in the goal.
        parameters: of docking, other than the quick ones.

    Attributes:
        silent: the node that neither sends nor receives; '' = none.
        frozen: which of servo_state, tactile_frame and charger_power repeats itself under new stamps.
    """

    def __init__(self, nearer: float = 0.0, **parameters: object) -> None:
        target = TargetParameters(x=0.006, y=0.006, z=0.080 - nearer, roll=0.03)
        world = WorldParameters(target=target, servo=ServoParameters(damping=quick.DAMPING))
        super().__init__(world, DockingParameters(**{**quick.STEPS, **parameters}), 1)
        self.silent = ""
        self.since = 0.0
        self.frozen: tuple[str, ...] = ()
        self._last = self.observe()
        self._lapsed = False
        self.distort = self._told

    def silence(self, node: str) -> None:
        self.silent, self.since = node, self.now
        if node == "servo_node":
            self._trajectory, self._goal = (), self._angles()
        self._lapsed = node in ("tactile_node", "docking_node") and self.plant.read_power()[3]

    def resume(self) -> None:
        """Continue the stopped node; pending requests are answered late."""
        self.silent = ""

    def restart(self) -> None:
        """Start the killed node; pending requests are lost."""
        if self.silent == "docking_node":
            self.machine = DockingMachine(self.parameters)
            self.outcome = None
            self._pending, self._replies = [], []
        elif self.silent == "servo_node":
            self._torque = False
        self._pending = [each for each in self._pending if SERVED_BY[each.request.service] != self.silent]
        self.silent = ""

    def _told(self, observation: Observation) -> Observation:
        age, last, values = self.now - self.since, self._last, {}
        servo = {name: getattr(last, name) for name in ("angles", "currents", "torque_enabled")}
        pads = {name: getattr(last, name) for name in ("tactile_contact", "tared")}
        power = {
            name: getattr(last, name)
            for name in ("contactor_closed", "charge_current", "target_voltage", "power_fault")
        }
        if self.silent == "servo_node":
            values = {**servo, "servo_age": age}
        elif self.silent == "tactile_node":
            values = {**pads, **power, "tactile_age": age, "power_age": age}
        for name, kept in (("servo_state", servo), ("tactile_frame", pads), ("charger_power", power)):
            if name in self.frozen:
                values.update(kept)
        refused = "a close needs a probe younger than 2 s" if self._lapsed and self._energised else ""
        changed = replace(observation, contactor_refusal=refused, **values)
        self._last = changed
        return changed

    def _serve(self) -> None:
        away = [each for each in self._pending if SERVED_BY[each.request.service] == self.silent]
        self._pending = [each for each in self._pending if each not in away]
        super()._serve()
        self._pending += away

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

    def end(self, phase: State, expected: set[Code]) -> Code:
        """Step until the goal has ended, or supervision of charging if it may; return the code."""
        watched = phase is State.CHARGING
        if watched and expected == {Code.NONE}:
            self.run(5.0)
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
