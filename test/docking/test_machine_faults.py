# SPDX-License-Identifier: Apache-2.0
"""Faults of docking's inputs in every phase, in virtual time: the goal ends safely, with the code of the table.

With any node silent or any input wrong: an energised contactor opens within its limit, the goal ends with a code that
names what is missing (or continues if it needed nothing), nothing keeps moving, nothing is released or pulled apart
while it is live. After the fault the next goal succeeds on the same charger, which lifts off first if it was pressing.

A late answer belongs to the goal that requested it, or is dropped. Docking does not search for a frozen sensor, whose
readings may really be constant unless the arm pulls: the push stays bounded, nothing is energised that the other
sensors do not confirm, and while current flows any two of the three inputs detect a target that leaves.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import pytest

from deltacharger_docking import press
from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.codes import Canceled, Code, State
from deltacharger_docking.observation import Command, DockGoal, Observation, Reply, Request, Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_driver.board.protocol import BoardFault
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.virtual.virtual_charger import GOAL, TICK, Effort, VirtualCharger

from .. import quick
from ..marks import rest
from ..sim.fault_table import INPUTS, PHASES
from .dockings import MILLIMETRE, assert_safe_at_home, moves

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
    """A charger with quick steps, whose camera sees the target 10 mm beside its place in both axes.

    Args:
        off: distance (m) of the target in each axis.
        nearer: distance (m) of the target before the place in the goal.
        parameters: of docking, other than the quick ones.

    Attributes:
        found: where the target is.
        silent: the node that neither sends nor receives; '' = none.
        shown: values of the observation that a fault replaces.
        frozen: the topic that repeats itself under new stamps; '' = none.
        asked: all requests.
        held: service whose answers are kept back, in `echoes`.
    """

    def __init__(self, off: float = 0.010, nearer: float = 0.0, **parameters: object) -> None:
        target = TargetParameters(x=off, y=off, z=0.080 - nearer, roll=0.03)
        world = WorldParameters(target=target)
        self.found = replace(GOAL, position=(off, off, GOAL.position[2]))
        super().__init__(world, DockingParameters(**{**quick.STEPS, **parameters}), 1)
        self.world.dt = 0.01
        self.silent = self.frozen = ""
        self.since = 0.0
        self.shown: Mapping[str, Any] = MappingProxyType({})
        self.asked: list[Request] = []
        self.echoes: list[Reply] = []
        self.held: Service | None = None
        self._last = self.observe()
        self._lapsed = False
        self.distort = self.told

    def silence(self, node: str) -> None:
        self.silent, self.since = node, self.now
        if node == "servo_node":
            self._trajectory, self._goal = (), self._angles()
        self._lapsed = node in ("tactile_node", "docking_node") and self.plant.read_power().closed

    def resume(self) -> None:
        """Continue the stopped node, whose pending requests are answered late, and show true values again."""
        self.silent, self.shown = "", {}

    def restart(self) -> None:
        """End the fault; pending requests of a killed node are lost."""
        if self.silent == "docking_node":
            self.machine = self._make_machine()
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
        if self.held is not None:
            held = {request.number for request in self.asked if request.service is self.held}
            late = [reply for reply in self._replies if reply.number in held]
            self.echoes += late
            self._replies = [reply for reply in self._replies if reply not in late]

    def _step(self) -> None:
        gone = self.now - self.since
        if self.silent == "tactile_node" and gone >= _HEARTBEAT and self.power.closed:
            self.power.trip(BoardFault.HEARTBEAT_LOST)
        if self.silent == "docking_node":
            if gone >= _LEASE and self.power.closed:
                self.power.open(self.now)
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
        return self.plant.read_power().closed

    @property
    def has_torque(self) -> bool:
        """Whether the servos really have torque."""
        return self._torque

    def reach(self, state: State) -> None:
        """Dock, and undock if the state requires it, until it has just begun; only a wrong goal leads to ALIGN."""
        if self.machine.status.docked:
            self.go_home()
        self.outcome = None
        self.begin(DockGoal({State.LOCATE: None, State.ALIGN: GOAL}.get(state, self.found)))
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


STOPPED = 1.0  # s
NOTICED = 0.3  # s after which no line continues
SETTLING = 0.003  # m: settling of a loaded arm where it was stopped
PUSH_BOUND = 30.0  # N; limit by the servos' current bound at the dock, for any command
QUICK = (State.CONTACT, State.ENERGISE, State.CHARGING, State.RETRACT)
MOVING = (State.APPROACH, State.CONTACT, State.ALIGN)


@pytest.fixture
def run() -> Faulty:
    """A charger that no other test has used: what it learned there would decide here."""
    return Faulty()


def undergo(run: Faulty, name: str, phase: State, seconds: float) -> None:
    """Let a fault last this time in a phase: a closed contactor opens and stays open, and nothing keeps moving."""
    run.reach(phase)
    fault, closed, start, z = INPUTS[name], run.closed, run.now, run.world.snapshot().position[2]
    run.shown = fault.shown
    if not fault.shown:
        run.silence(name)
    opens = closed and fault.opens > 0.0
    if opens:
        run.until(lambda: not run.closed, 2.0)
        assert run.now - start <= fault.opens + 0.02
    run.run(max(NOTICED - (run.now - start), 0.0))
    place = run.world.snapshot().position
    advanced = moved = 0.0
    while run.now - start < seconds:
        run.tick()
        advanced = max(advanced, run.world.snapshot().position[2] - max(z, place[2]))
        moved = max(moved, run.distance(place))
        assert not (opens and run.closed), "nothing closes it again"
    if name in ("servo_node", "docking_node"):
        assert moved < SETTLING
    elif name == "tactile_node":
        assert advanced < SETTLING, "without touch only the way back is open"


def cells(later: bool) -> Iterator[object]:
    """Yield fault, phase and code of the table, for faults that last or end after a second."""
    for phase in PHASES:
        for name, fault in INPUTS.items():
            codes = fault.later if later else fault.codes
            if phase in codes:
                patient = (name, phase) == ("misalignment_node", State.CHARGING)
                cell = name, phase, codes[phase]
                yield cell if phase in QUICK and not patient else rest(*cell)


@pytest.mark.parametrize(("name", "phase", "code"), cells(False), ids=lambda value: getattr(value, "name", value))
def test_a_fault_that_lasts(run: Faulty, name: str, phase: State, code: Code) -> None:
    undergo(run, name, phase, 2.0 if not INPUTS[name].shown else NOTICED)
    if name != "docking_node":  # whose client knows that the server is gone
        assert run.end(phase, code) is code, run.machine.status.message
        assert bool(run.machine.status.message) == (code is not Code.NONE)
    run.restart()
    run.assert_never_hurt()
    run.go_home()
    assert run.dock(DockGoal(run.found)).success


@pytest.mark.parametrize(("name", "phase", "code"), cells(True), ids=lambda value: getattr(value, "name", value))
def test_a_node_that_is_stopped_for_a_second(run: Faulty, name: str, phase: State, code: Code) -> None:
    """Its late answers arrive together, the trajectories it missed do not; an opened contactor does not close again."""
    undergo(run, name, phase, STOPPED)
    run.resume()
    assert run.end(phase, code) is code, run.machine.status.message
    run.run(0.3)
    if code is not Code.NONE:
        assert not run.has_torque, "what asked for it to go off came late, but came"
        assert not run.closed
    run.assert_never_hurt()
    run.go_home()


@pytest.mark.parametrize("state", [State.LOCATE, *MOVING, State.MEASURE, State.ENERGISE, State.RETRACT])
def test_cancel_in_every_phase(run: Faulty, state: State) -> None:
    run.reach(state)
    run.machine.cancel()
    outcome = run.finish(30.0)
    assert outcome.code is Code.CANCELED
    assert outcome.retriable
    assert_safe_at_home(run)


def test_a_cancel_on_the_way_back_keeps_the_first_error(run: Faulty) -> None:
    run.reach(State.MEASURE)
    run.shown = {"power_fault": 9}
    run.until(lambda: run.machine.status.state is State.RETRACT, 5.0)
    run.machine.cancel()
    assert run.finish(30.0).code is Code.OVERCURRENT


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize(("age", "code"), [("servo_age", Code.SERVO_STALE), ("tactile_age", Code.TACTILE_STALE)])
def test_old_data_stop_the_arm_fresh_data_continue_and_missing_data_end_the_goal(
    state: State, age: str, code: Code
) -> None:
    run = Faulty(travel_speed=0.1, search_speed=0.02)  # 2 mm in the 0.1 s that data may be old
    run.reach(state)
    if state is State.ALIGN:  # sideways, off the magnets
        run.until(lambda: run.world.snapshot().position[0] > 1.0 * MILLIMETRE, 10.0)
    run.until(lambda: moves(run, 3 * TICK), 10.0)
    run.shown = {age: 0.15}
    run.run(0.1)
    held = run.world.snapshot().position
    run.run(0.5)
    assert run.distance(held) < 2.0 * MILLIMETRE
    assert run.machine.status.state is state
    run.shown = {}
    run.until(lambda: moves(run, 3 * TICK), 5.0)
    since, z = run.now, run.world.snapshot().position[2]
    free = GOAL.position[2] - press._SEARCH_FROM  # up to here it cannot strike anything
    run.distort = lambda observation: replace(observation, **{age: run.now - since})
    assert run.finish(20.0).code is code
    assert run.world.snapshot().position[2] < max(z + 3.0 * MILLIMETRE, free), "it was never carried on"
    run.distort = run.told
    run.until(lambda: run.machine.status.state is State.IDLE, 30.0)
    run.go_home()


@pytest.mark.parametrize("seconds", [0.4, 2.0], ids=["carried out", "refused as too late, and repeated"])
@pytest.mark.parametrize("follows", [False, True], ids=["no goal", "a goal follows at once"])
def test_an_order_to_go_limp_never_falls_into_the_next_goal(seconds: float, follows: bool) -> None:
    """servo_node is suspended. When it goes on, its data come at once; that its torque goes off shows later."""
    run = Faulty(off=0.0)
    run.reach(State.CONTACT)
    run.silence("servo_node")
    assert run.finish(5.0).code is Code.SERVO_STALE
    run.run(seconds)
    if follows:
        run.begin(DockGoal(GOAL))
        run.run(0.1)
        assert run.machine.status.waiting_for
    for pending in run._pending:
        pending.due = run.now + 0.3
    shown: list[bool] = []

    def late(seen: Observation) -> Observation:
        shown.append(seen.torque_enabled)
        return replace(seen, torque_enabled=shown[max(len(shown) - 6, 0)])  # six ticks old

    run.resume()
    run.distort = late
    if follows:
        outcome = run.finish(60.0)
        assert outcome.success, outcome.message
        assert run.machine.status.charging
    else:
        run.run(0.5)
        assert not run.has_torque
    run.assert_never_hurt()


def test_a_goal_that_an_emergency_ends_keeps_its_account() -> None:
    """What flows until the contactor is open counts too."""
    run = Faulty(off=0.0)
    run.begin(DockGoal(run.found, hold=True, request_id="order-1"))
    run.until(lambda: run.machine.status.state is State.CHARGING, 60.0)
    run.run(1.0)
    before, why = run.machine._context.energy, Canceled("the charger is shutting down")
    run._follow(run.machine.emergency(why))
    run.until(lambda: not run.observe().contactor_closed, 1.0)
    run.machine.end()
    run.tick()
    outcome, status = run.outcome, run.machine.status
    assert outcome is not None
    assert (outcome.code, outcome.retriable, outcome.message) == (Code.CANCELED, True, str(why))
    assert (status.code, status.message, status.charging) == (Code.CANCELED, str(why), False)
    assert outcome.elapsed == pytest.approx(run.now - run.machine._context.started, abs=2 * TICK)
    assert 0.0 < before < outcome.energy
    assert (outcome.charge_end, outcome.estimate) == ("CANCELED", status.estimate)
    assert outcome.charge_voltage > 20.0
    assert outcome.contact_current > 0.3
    assert not run.machine.busy


BAD = MisalignmentEstimate(math.radians(11.0), 0.001, 0.0, 0.0003, 0.0, 0.0003)


@pytest.mark.parametrize(
    ("service", "first", "own", "code"),
    [
        (Service.DETECT, Code.ELECTRODES_NOT_FOUND, {"success": False}, Code.ELECTRODES_NOT_FOUND),
        (Service.TORQUE_ON, Code.SERVO_FAULT, {"success": False}, Code.SERVO_FAULT),
        (Service.ESTIMATE, Code.TACTILE_STALE, {"estimate": BAD}, Code.CRITICAL_ANGLE),
        (Service.PROBE, Code.POWER_STALE, {"resistance": 0.1}, Code.SHORT_CIRCUIT),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_an_answer_that_arrives_in_the_next_goal_is_ignored(
    service: Service, first: Code, own: dict[str, object], code: Code
) -> None:
    """The late answer is good and repeated in every tick of the next goal, whose own answer is bad."""
    run = Faulty(off=0.0)
    goal = DockGoal(None if service is Service.DETECT else GOAL)
    run.held = service
    assert run.dock(goal).code is first
    run.run(1.0)
    run.held = None
    run._torque = False  # as after manual handling, so that it is requested again
    assert run.echoes
    late = run.echoes
    run.distort = lambda seen: replace(run.told(seen), replies=(*late, *seen.replies, *late))
    run.answer[service] = lambda reply: replace(reply, message="out of order", **own)
    assert run.dock(goal).code is code
    run.assert_never_hurt()


FROZEN = {"servo_state": Code.SERVO_FAULT, "tactile_frame": Code.NO_TACTILE_CONTACT}


@pytest.mark.parametrize("phase", [rest(State.APPROACH), State.CONTACT, State.ENERGISE, State.CHARGING])
@pytest.mark.parametrize("frozen", [*FROZEN, "charger_power"])
def test_a_sensor_that_repeats_itself(run: Faulty, phase: State, frozen: str) -> None:
    """Servos and pads are noticed until contact, power until current flows."""
    if frozen == "charger_power":
        code = Code.NONE if phase is State.CHARGING else Code.NO_CHARGE_CURRENT
    else:
        code = FROZEN[frozen] if phase in MOVING else Code.NONE
    run.reach(phase)
    run.frozen = frozen
    push = Effort(run)

    def is_over() -> bool:
        push.look()
        return run.outcome is not None and (code is not Code.NONE or run.now > until)

    until = run.now + 3.0
    run.until(is_over, 60.0)
    assert run.machine.status.code is code, run.machine.status.message
    run.run(0.5)
    assert run.closed == run.has_torque == (code is Code.NONE)
    assert push.most < PUSH_BOUND
    run.frozen = ""
    run.assert_never_hurt()
    run.go_home()


@pytest.mark.parametrize("phase", [State.MEASURE, State.RETRACT])
def test_an_arm_that_pulls_while_servo_state_repeats_itself_is_not_told_as_stuck(run: Faulty, phase: State) -> None:
    """It lets go, although nothing shows it, and goes limp there. One that is stuck shows the currents of its pull."""
    run.found = GOAL  # beside the target, so the arm lifts off again
    run.reach(phase)
    run.frozen = "servo_state"
    outcome = run.finish(20.0)
    assert outcome.code is Code.SERVO_FAULT, outcome.message
    assert outcome.message.startswith("servo_state repeats one reading")
    run.run(0.5)
    assert not run.has_torque
    run.frozen = ""
    run.assert_never_hurt()
    run.go_home()
