# SPDX-License-Identifier: Apache-2.0
"""A charger in virtual time: the real state machine, the simulated world, no ROS, no ports and no waiting.

Thousands of dockings must run faster than real time, and equally on every machine. What lies between machine and
world is modelled here: the servo goal at 100 Hz, the delay of services, the contactor's lease. The machine gets only
data that the robot's topics carry.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core import arrays, machine, real_time, servo_types
from deltacharger_core.script import NEXT, Script
from deltacharger_docking import clearance, codes, context, observation
from deltacharger_docking.machine import DockingMachine
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_driver.board.protocol import POWER_RATE, AckError
from deltacharger_driver.servos import motion, registers
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_kinematics.trajectory_feed import Waypoint
from deltacharger_sim.emulators.power import EmulatedPower
from deltacharger_sim.mechanics import Mechanics
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import LITHIUM_7S, WorldParameters
from deltacharger_sim.world import SharedWorld, World
from deltacharger_tactile import PoseEstimator, default_model

TICK = 0.01
PROFILE = TargetProfile(**LITHIUM_7S)
FRAME = 1.0 / machine.FRAME_RATE
GOAL = observation.ElectrodePose((0.0, 0.0, machine.DOCK_DISTANCE), 0.0)
_ORDERS = (
    observation.Service.TORQUE_ON,
    observation.Service.TORQUE_OFF,
    observation.Service.TARE,
    observation.Service.PROBE,
)  # refused if they come too late


@functools.cache
def packaged_model() -> PoseEstimator:
    """Return the packaged model of the pads, read once per process."""
    return default_model()


@dataclass
class Pending:
    """A pending request: times of request and answer (s), and the frames (N) of its answer."""

    request: observation.Request
    asked: float
    due: float
    frames: list[np.ndarray]


class VirtualCharger:
    """Steps world and machine by 10 ms; `distort` may change each observation to inject a fault.

    Args:
        world: the simulated world; None = defaults.
        parameters: of docking, and servo_node's torque constant; None = defaults with the world's servo stiffness.
        seed: of noise and jitter.
        rig_seed: seed of the device with the pads.
        tactile: the pads; None = those of `rig_seed` and `seed`.
        geometry: the arm's dimensions that docking assumes; None = the true ones.
        profile: of the target.

    Attributes:
        power: the board's power stage.
        excess: excess reading of taxels after each tare (2, 10, 10) N; None = none.
    """

    def __init__(
        self,
        world: WorldParameters | None = None,
        parameters: DockingParameters | None = None,
        seed: int = 1,
        rig_seed: int = 900,
        tactile: Any = None,
        geometry: DeltaGeometry | None = None,
        profile: TargetProfile = PROFILE,
    ) -> None:
        self.now = 0.0
        self.profile = profile
        world = world or WorldParameters()
        self.parameters = parameters or DockingParameters(servo_stiffness=world.servo.stiffness)
        self.geometry = geometry or DeltaGeometry()
        self.world = self._make_world(world, tactile or ContactSource(None, rig_seed, seed), seed)
        self.plant = self._make_plant()
        self.power = self._make_power()
        self._power, self._reported = self.power.report(), 0.0  # the last POWER and its time (s)
        self.machine = self._make_machine()
        self.distort: Callable[[observation.Observation], observation.Observation] = lambda seen: seen
        self.answer: dict[observation.Service, Callable[[observation.Reply], observation.Reply | None]] = {}
        self.states: list[codes.State] = []
        self.outcome: observation.DockingOutcome | None = None
        self.model: Any = packaged_model()  # predicts from two averaged, tared pads
        self.baseline = np.zeros((machine.PADS, machine.ROWS, machine.COLUMNS))
        self.excess: arrays.Array | None = None
        self._tared = False
        self._torque = False
        self._trajectory: tuple[Waypoint, ...] = ()
        self._started = 0.0
        self._followed: tuple[Waypoint, ...] = ()  # the line to which the next number belongs
        self._segment = 0
        self._goal = [0.0, 0.0, 0.0]
        self._from = [0.0, 0.0, 0.0]
        self._bound = [machine.CURRENT_BOUND] * 3
        self._pending: list[Pending] = []
        self._replies: list[observation.Reply] = []
        self._earlier: list[observation.Reading] = []  # of the servos, since the machine's last step
        self._waits = NEXT  # pending condition of the machine
        self._energised, self._limit = False, 0.0  # whether the lease is held, and its largest current (A)
        self._refusal = ""  # why the board did not close
        self._probing = AckError.DONE  # its answer to the last request to probe
        self._probed: tuple[float, float] | None = None  # Ω and V of the last probe, if it has ended
        self._frame = np.zeros((machine.PADS, machine.ROWS, machine.COLUMNS))
        self._frame_at = -math.inf
        stiffness, damping = self.parameters.servo_stiffness, machine.SERVO_DAMPING
        gains = round(stiffness / machine.STIFFNESS_PER_GAIN), round(damping / machine.DAMPING_PER_GAIN)
        settings = registers.BusSettings("", gains=gains, torque_constant=self.parameters.torque_constant)
        self._watch = motion.JointWatch(settings, settings.drive(servo_types.MX_64))
        self._stopped, self._stop_at = "", math.inf  # why and until when servo_node stops the arm

    def _make_world(self, world: WorldParameters, tactile: Any, seed: int) -> World:
        return World(world, tactile, seed)

    def _make_plant(self) -> SharedWorld:
        return SharedWorld(self.world, clock=lambda: self.now)

    def _make_power(self) -> EmulatedPower:
        return EmulatedPower(self.plant, self.world.parameters.stage)

    @property
    def profiles(self) -> dict[str, TargetProfile]:
        """Docking's profiles by name; none for electrodes that are wired to the battery."""
        return {} if self.parameters.always_live else {"lithium_7s": self.profile}

    def _make_machine(self) -> DockingMachine:
        return DockingMachine(self.parameters, self.geometry, profiles=self.profiles)

    def dock(self, goal: observation.DockGoal | None = None, limit: float = 240.0) -> observation.DockingOutcome:
        """Serve a Dock goal to its end."""
        self.begin(goal or observation.DockGoal(GOAL))
        return self.finish(limit)

    def begin(self, goal: observation.DockGoal) -> None:
        """Start a Dock goal; raises the machine's refusal."""
        self.outcome, self._waits = None, NEXT
        self.machine.start_dock(goal, self.observe())

    def start(self, script: Callable[[context.Context], Script[str]]) -> None:
        """Start another script on the machine."""
        self.outcome, self._waits = None, NEXT
        self.machine.start(script, self.observe())

    def undock(self, limit: float = 60.0) -> observation.DockingOutcome:
        """Serve an Undock goal to its end."""
        self.outcome, self._waits = None, NEXT
        self.machine.start_undock("", self.observe())
        return self.finish(limit)

    def finish(self, limit: float) -> observation.DockingOutcome:
        """Step until the goal has an outcome; raises TimeoutError after `limit` simulated seconds."""
        end = self.now + limit
        while self.outcome is None:
            self._tick_before(end)
        return self.outcome

    def until(self, condition: Callable[[], bool], limit: float) -> None:
        """Step until `condition` holds; raises TimeoutError after `limit` simulated seconds."""
        end = self.now + limit
        while not condition():
            self._tick_before(end)

    def _tick_before(self, end: float) -> None:
        if self.now >= end:
            raise TimeoutError(f"not reached until {end:.2f} s; state {self.machine.status.state.name}")
        self.tick()

    def run(self, seconds: float) -> None:
        """Step for a while."""
        end = self.now + seconds
        while self.now < end:
            self.tick()

    def tick(self) -> None:
        """Advance by 10 ms."""
        self.now += TICK
        self._servos()
        self._sample()
        self._watch_power()
        self._serve()
        self._step()

    def _step(self) -> None:
        """Let the machine decide, and carry out its commands."""
        command = self.machine.step(self.distort(self.observe()))
        self._replies, self._earlier = [], []
        self._waits = command.waits
        self._follow(command)
        if not self.states or self.states[-1] is not self.machine.status.state:
            self.states.append(self.machine.status.state)
        if self.machine.outcome is not None:
            self.outcome, self.machine.outcome = self.machine.outcome, None

    def _follow(self, command: observation.Command) -> None:
        if command.trajectory is not None and not self._stopped:
            self._trajectory = command.trajectory
            self._started = self.now
            self._from = list(self._goal)
            if not command.trajectory:
                self._goal = self._angles()
        for request in command.requests:
            self._accept(request)
        if command.energise != self._energised:
            self._energised, self._refusal = command.energise, ""
            if not command.energise:
                self.power.open(self.now)
            elif command.limits is not None:
                self.power.heartbeat(self.now)
                error = self.power.close(command.limits, self.now)
                self._refusal = f"the board refused: {error.name}" if error else ""
                self._limit = command.limits.current
        elif self._energised and command.limits is not None and command.limits.current != self._limit:
            self._limit = command.limits.current
            self.power.limit(self._limit)

    def _watch_power(self) -> None:
        """Let the board look at its power stage, while docking holds the lease with a heartbeat, and report."""
        if self._energised:
            self.power.heartbeat(self.now)
        self.power.poll(self.now)
        self._probed = self.power.poll_probe(self.now) or self._probed
        if self.now - self._reported >= 1.0 / POWER_RATE - 1e-6:
            self._power, self._reported = self.power.report(), self.now

    def observe(self) -> observation.Observation:
        """Return the observation that the topics would carry."""
        angles, currents = self._reading()
        power, stage = self._power, self.power.parameters
        return observation.Observation(
            time=self.now,
            angles=angles,
            currents=currents,
            servo_age=0.0,
            servos_valid=True,
            torque_enabled=self._torque,
            tactile_age=0.0,
            tactile_contact=self._feels(),
            tared=self._tared,
            power_age=self.now - self._reported,
            contactor_closed=power.contactor_closed,
            charge_current=power.charge_current,
            least_current=power.least_current,
            target_voltage=power.target_voltage,
            battery_voltage=power.battery_voltage,
            power_fault=power.fault,
            stage_steps_up=stage.steps_up,
            stage_voltage=stage.stage_voltage or math.nan,
            contactor_refusal=self._refusal,
            replies=tuple(self._replies),
            earlier=tuple(self._earlier),
            stopped=self._stopped,
            taxels=self._taxels(),
        )

    def _taxels(self) -> arrays.Array | None:
        """Return the newest tared frame (2, 10, 10) N."""
        return self._frame if self._tared else None

    def _reading(self) -> tuple[Vector, Vector]:
        """Return angles (rad) and currents (A) as in servo_state."""
        (a, _, i, _, _), (b, _, j, _, _), (c, _, k, _, _) = (self.plant.read_servo(index) for index in range(3))
        return (a, b, c), (i, j, k)

    def _feels(self) -> bool:
        """Return whether some taxel is in contact."""
        return bool(np.fmax.reduce(self._frame, axis=None) >= machine.CONTACT_FORCE)  # `nanmax` takes 4 times as long

    def _angles(self) -> list[float]:
        return [self.plant.read_servo(index)[0] for index in range(3)]

    def _servos(self) -> None:
        if self._trajectory:
            self._bound, self._goal = self._along(self._trajectory, self.now - self._started)
        for index in range(3):
            self.plant.command_servo(index, self._torque, self._goal[index], self._bound[index])
        self._watch_joints()

    def _along(self, line: tuple[Waypoint, ...], elapsed: float) -> tuple[list[float], list[float]]:
        """Return bounds (A) and goal angles (rad) `elapsed` s after a line was sent; calls are in time order."""
        if self._followed is not line:
            self._followed, self._segment = line, 0
        last = len(line) - 1
        while self._segment < last and elapsed >= line[self._segment].time:
            self._segment += 1
        point = line[self._segment]
        a, b, c = point.torque_bound
        constant = self.parameters.torque_constant
        bound = [a / constant, b / constant, c / constant]
        if elapsed >= point.time:
            return bound, list(point.angles)
        before, since = (
            (line[self._segment - 1].angles, line[self._segment - 1].time) if self._segment else (self._from, 0.0)
        )
        share = (elapsed - since) / (point.time - since)
        (a, b, c), (d, e, f) = before, point.angles
        return bound, [a + share * (d - a), b + share * (e - b), c + share * (f - c)]

    def _watch_joints(self) -> None:
        """Stop the arm as servo_node does if a joint strays: hold, open the contactor, torque off after `STOP_TIME`."""
        if not self._torque:
            return
        servo = self.world.servo  # the plant has advanced it to the orders that have just been given
        (a, u, i, _, _), (b, v, j, _, _), (c, w, k, _, _) = servo(0), servo(1), servo(2)
        fault = self._watch.fault(self.now, self._goal, (a, b, c), (u, v, w), (i, j, k))
        if fault and not self._stopped:
            self._stopped, self._stop_at = fault, self.now + motion.STOP_TIME
            self._trajectory, self._goal = (), [a, b, c]
            self.power.open(self.now)
        if self.now >= self._stop_at:
            self._torque, self._stop_at = False, math.inf

    def _sample(self) -> None:
        if self.now - self._frame_at < FRAME:
            return
        self._frame_at = self.now
        raw = np.array(self.plant.read_taxels())
        self._frame = np.maximum(raw - self.baseline, 0.0)
        for pending in self._pending:
            pending.frames.append(raw if pending.request.service is observation.Service.TARE else self._frame)

    def _accept(self, request: observation.Request) -> None:
        delay = {
            observation.Service.TARE: 0.2,
            observation.Service.PROBE: 0.2,
            observation.Service.ESTIMATE: (request.frames + 1) * FRAME,
        }
        self._pending.append(Pending(request, self.now, self.now + delay.get(request.service, 0.02), []))
        if request.service is observation.Service.PROBE:
            self._probing, self._probed = self.power.start_probe(self.now), None

    def _serve(self) -> None:
        for pending in [pending for pending in self._pending if self.now >= pending.due]:
            self._pending.remove(pending)
            answer: observation.Reply | None = self._reply(pending)
            if pending.request.service in self.answer and answer is not None:
                answer = self.answer[pending.request.service](answer)
            if answer is not None:
                self._replies.append(answer)

    def _reply(self, pending: Pending) -> observation.Reply:
        number, service = pending.request.number, pending.request.service
        if service in _ORDERS and (refusal := real_time.late(self.now - pending.asked)):
            return observation.Reply(number, False, refusal)
        if service in (observation.Service.TORQUE_ON, observation.Service.TORQUE_OFF):
            self._torque = service is observation.Service.TORQUE_ON
            self._trajectory, self._goal = (), self._angles()
            self._stopped, self._stop_at = "", math.inf
            self._watch.begin_at(self._goal)
        elif service is observation.Service.TARE:
            self.baseline, self._tared = np.mean(pending.frames, axis=0), True
            if self.excess is not None:
                self.baseline -= self.excess
        elif service is observation.Service.OPEN:
            self.power.open(self.now)  # clears a latched fault
        elif service is observation.Service.PROBE:
            found = None if self._probing else self._probed or self.power.poll_probe(self.now)
            if found is None:
                return observation.Reply(
                    number, False, f"the board refused: {(self._probing or AckError.NOT_NOW).name}"
                )
            return observation.Reply(number, True, resistance=found[0], target_voltage=found[1])
        elif service is observation.Service.ESTIMATE:
            left, right = np.mean(pending.frames, axis=0)
            return observation.Reply(
                number, True, estimate=clearance.MisalignmentEstimate.of(self.model.predict(left, right))
            )
        elif service is observation.Service.DETECT:
            return observation.Reply(number, True, detection=GOAL)
        return observation.Reply(number, True)


class Effort:
    """Largest push so far while in contact: the servos' force along z at the platform, without gravity and impacts.

    It excludes the force of the platform's own mass when it strikes a stiff target.

    Attributes:
        most: N along z, 0 if the electrodes were never in contact.
    """

    def __init__(self, charger: VirtualCharger) -> None:
        self._world = charger.world
        self.most = 0.0

    def look(self) -> None:
        """Take the present push if it is larger."""
        mechanics = self._world.mechanics
        if mechanics.contact_force > 0.0 and isinstance(mechanics, Mechanics):
            self.most = max(self.most, mechanics.servo_push())
