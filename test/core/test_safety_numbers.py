# SPDX-License-Identifier: Apache-2.0
"""The table of safety numbers: for each limit, as literals, a value just inside, one just outside, and the unknown.

No number here is imported, so none can change with the product. Whoever changes one changes its row, its mutant in
test/mutants.yaml and its reason together. Everything is pure or in virtual time.
"""

import math
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple
from unittest.mock import Mock

import numpy as np
import pytest

from deltacharger_core import parameters, real_time, servo_types
from deltacharger_core.machine import ChargeLimits
from deltacharger_core.script import NEXT
from deltacharger_docking import (
    algorithm,
    charging,
    clearance,
    codes,
    contact,
    context,
    energy,
    goals,
    machine,
    observation,
    place,
    release,
    touch,
    watch,
)
from deltacharger_docking.mission.machine import MissionMachine
from deltacharger_docking.mission.parameters import MissionParameters
from deltacharger_docking.mission.places import BaseMount, Place
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_driver.board import contactor, protocol
from deltacharger_driver.errors import DriverError
from deltacharger_driver.parameters import ServoNodeParameters
from deltacharger_driver.servos import controller, motion, registers
from deltacharger_kinematics import geometry, scalar, swing
from deltacharger_sim.emulators.power import EmulatedPower, PowerStage, StageParameters, StageReading
from deltacharger_tactile import estimator, perception
from deltacharger_vision import errors, mount
from deltacharger_vision.detector.judgement import supported

NAN, INF, DEGREE, MM = math.nan, math.inf, math.radians(1.0), 1e-3
DOCK = (0.0, 0.0, 0.08)
PARAMETERS = DockingParameters()
LIMITS = ChargeLimits(10.0, 29.4)
PROFILES = {"seven": TargetProfile(19.0, 29.4, 10.0, 0.5), "late": TargetProfile(19.0, 29.4, 10.0, 0.5, port="dead")}


class Limit(NamedTuple):
    """What is limited; whether a value is accepted; the last accepted value, the first refused, and others refused."""

    what: str
    accepts: Callable[[Any], Any]
    inside: Any
    outside: Any
    refused: Sequence[Any] = (NAN,)


def fields(accepts: Callable[..., bool], inside: float, refused: Sequence[float], *names: str) -> Iterator[Limit]:
    """Yield rows of fields that are refused alike."""
    for name in names:
        ask: Callable[[Any], bool] = lambda value, name=name: accepts(**{name: value})  # noqa: E731
        yield Limit(f"{accepts.__name__}: {name}", ask, inside, refused[0], refused[1:])


def passes(call: Callable[..., Any], *values: Any) -> bool:
    """Return whether none of the product's refusals is raised."""
    try:
        call(*values)
    except (codes.DockingError, DriverError, errors.VisionError, perception.Refused, parameters.ParameterError):
        return False
    return True


# Clearance of an estimate.


def estimate(**changes: Any) -> clearance.MisalignmentEstimate:
    poses = dict.fromkeys(("angle", "vertical", "horizontal", "across"), 0.0)
    stddevs = dict.fromkeys(("angle_stddev", "vertical_stddev", "horizontal_stddev", "across_stddev"), 1e-9)
    return clearance.MisalignmentEstimate(**poses | stddevs | changes)


def clears(limit: float | None = None, **changes: Any) -> bool:
    return clearance.judge(estimate(**changes), PARAMETERS, limit).leaves_clearance


def sure(**changes: Any) -> bool:
    return clearance.judge(estimate(**changes), PARAMETERS) is clearance.Verdict.SAFE


def usable(**changes: Any) -> bool:
    return estimate(**changes).usable


POSES = ("angle", "vertical", "horizontal", "angle_stddev", "vertical_stddev", "horizontal_stddev")
CLEARANCE = (
    # 3.7 mm (1 + cos) − 35 mm sin = 0.3 mm at 11.58°; a goal's lower limit needs 3 σ: 4° + 3 · 0.333° = 5°.
    Limit("angle, °", lambda v: clears(angle=v * DEGREE), 11.57, 11.59),
    Limit("goal's angle, °", lambda v: clears(5 * DEGREE, angle=v * DEGREE), 4.99, 5.01),
    Limit("σ of 4°, °", lambda v: clears(5 * DEGREE, angle=4 * DEGREE, angle_stddev=v * DEGREE), 0.33, 0.34),
    # 7.4 mm − 0.3 mm; 3 σ and 6 σ of 3 mm; σ of 35 mm · cos · angle's σ.
    # (An offset with unknown error is calculated again, so it is not refused.)
    Limit("across, mm", lambda v: clears(across=v * MM), 7.09, 7.11, ()),
    Limit("σ across, mm", lambda v: clears(across=4.1 * MM, across_stddev=v * MM), 0.99, 1.01, ()),
    Limit("σ across when sure, mm", lambda v: sure(across=4.1 * MM, across_stddev=v * MM), 0.49, 0.51, ()),
    # 0.0086 m/rad · (2° + 2 · 1°) = 0.6 mm.
    Limit("pitched, mm", lambda v: clears(across=v * MM, pitch=2 * DEGREE, pitch_stddev=DEGREE), 6.49, 6.51, ()),
    *fields(usable, 0.001, (NAN, INF), *POSES),
    *fields(usable, 0.0, (-1e-9, -1.0), "angle_stddev", "vertical_stddev", "horizontal_stddev"),
    *fields(usable, True, (False,), "contact", "sure", "in_range"),
    Limit("squared innovations", lambda v: not place.contradicts(v, 2), 33.0, 33.1, ()),
)


def test_the_error_of_the_clearance_has_both_terms_of_the_bars() -> None:
    found = clearance.clearance_stddev(estimate(angle=0.2, angle_stddev=0.01, across_stddev=3e-4), 0.0037, 0.035)
    assert found == pytest.approx(math.hypot((0.0037 * math.sin(0.2) + 0.035 * math.cos(0.2)) * 0.01, 3e-4), rel=1e-12)


# What docking observes.


@cache
def pressing(current: float = 0.45, z: float = 0.08) -> observation.Observation:
    """Return a healthy docked arm that presses with this contact current (A)."""
    delta = scalar.ScalarDelta(geometry.DeltaGeometry())
    held, jacobian = delta.holding_torque(0.0, 0.0, z, PARAMETERS.gravity), delta.jacobian(0.0, 0.0, z)
    force = 3.0 * PARAMETERS.torque_constant * current / sum(jacobian[6:])
    pushed = delta.torque(0.0, 0.0, z, (0.0, 0.0, force))
    currents = tuple((one + two) / PARAMETERS.torque_constant for one, two in zip(held, pushed, strict=True))
    fresh = dict.fromkeys(("servo_age", "tactile_age", "power_age"), 0.0)
    known = {"servos_valid": True, "torque_enabled": True, "tactile_contact": True, "tared": True}
    volts = {"charge_current": 0.0, "least_current": 0.0, "target_voltage": 24.0, "battery_voltage": 26.0}
    return observation.Observation(0.0, delta.inverse(0.0, 0.0, z), currents, **fresh, **known, **volts)


def scene(profile: str = "seven", **changes: Any) -> context.Context:
    shared = context.Context(PARAMETERS, geometry.DeltaGeometry(), profiles=PROFILES)
    shared.choose_profile(profile)
    shared.observe(replace(pressing(), **changes))
    return shared


def may_close(**changes: Any) -> bool:
    return watch.reason_not_to_close(scene(**changes)) is None


def stays_closed(seen: observation.Observation | None = None, **changes: Any) -> bool:
    live = {"contactor_closed": True, "charge_current": 5.0}
    return watched(scene(**live), replace(seen or pressing(), **{"time": 0.2} | live | changes))


def watched(shared: context.Context, seen: observation.Observation) -> bool:
    """Return whether live electrodes stay where they were measured in pressing()."""
    shared.enter(codes.State.CHARGING, INF)
    shared.closing = context.Live(0.0)
    shared.evidence.keep(shared.position, 0.003)
    watches = watch.Watches(shared)
    assert watches.problem() is None
    shared.observe(seen)
    return watches.problem() is None


def touches_live(**changes: Any) -> bool:
    shared = context.Context(replace(PARAMETERS, power="none"), geometry.DeltaGeometry())
    shared.observe(pressing())
    return watched(shared, replace(pressing(), **changes))


def keeps_port(volts: float, samples: int = 2) -> bool:
    """Return whether docking goes on if a live port of 24 V in contact shows another voltage."""
    shared = scene()
    shared.enter(codes.State.MEASURE, INF)
    watches = watch.Watches(shared)
    found = [watches.problem()]
    for number in range(samples):
        shared.observe(replace(pressing(), time=0.05 * (number + 1), target_voltage=volts))
        found.append(watches.problem())
    return not any(found)


def continues(
    state: codes.State = codes.State.MEASURE,
    seen: observation.Observation | None = None,
    lead: float = 0.0,
    **changes: Any,
) -> bool:
    """Return whether a script goes on in this state, whose command leads the arm by so much (m) more than explained."""

    def script(shared: context.Context) -> Iterator[Any]:
        shared.enter(state, INF)
        shared.commanded = DOCK
        shared.commanded = 0.0, 0.0, 0.08 - shared.unexplained_lead + lead
        while True:
            yield NEXT

    docking = machine.DockingMachine(PARAMETERS, profiles=PROFILES)
    docking.start(script, pressing())  # type: ignore[arg-type]
    docking.step(pressing())
    for time in (0.14, 0.2):  # what pushes too hard is read more than once
        docking.step(replace(seen or pressing(), **{"time": time} | changes))
    return docking.status.code is codes.Code.NONE


def parts(retreat: float, touches: bool = False) -> bool:
    """Return whether electrodes that are pulled so far (m) from where they last touched count as released."""
    shared = scene()
    pull = release._pull(shared, DOCK, 3.5, 1.0, 0.08, None)
    next(pull)
    shared.observe(replace(pressing(z=0.08 - retreat), time=0.01, tactile_contact=touches))
    return next(pull, None) is None


def moves_on(state: codes.State = codes.State.CONTACT, **changes: Any) -> bool:
    shared = scene(**changes)
    shared.enter(state, INF)
    return not shared.is_blind


def without(values: Sequence[float], index: int | None) -> Any:
    """Return values of which one is unknown."""
    return tuple(NAN if at == index else value for at, value in enumerate(values))


OBSERVATION = (
    *fields(may_close, 0.49, (0.51, INF, NAN), "power_age", "tactile_age"),
    *fields(may_close, 0.24, (0.26, INF, NAN), "servo_age"),
    Limit("unknown angle", lambda v: may_close(angles=without(pressing().angles, v)), None, 0, (1, 2)),
    Limit("unknown current", lambda v: may_close(currents=without(pressing().currents, v)), None, 0, (1, 2)),
    *fields(may_close, 23.71, (23.69, NAN, -INF), "battery_voltage"),
    *fields(may_close, 29.49, (29.51,), "stage_voltage"),
    *fields(may_close, 29.11, (29.09, 0.0), "stage_voltage"),
    *fields(may_close, 29.79, (29.81, INF), "battery_voltage"),
    *fields(may_close, 5.1, (4.9, NAN, -INF), "thermal_reserve"),
    *fields(may_close, True, (False,), "torque_enabled", "tactile_contact"),
    *fields(may_close, "", ("a second tactile_node",), "duplicate_sources"),
    Limit("port in contact, V", keeps_port, 8.1, 7.9, (2.1, 0.0, -24.0)),  # a third of 24 V
    Limit("charger_power of a collapse", lambda v: keeps_port(0.0, v), 1, 2, ()),
    *fields(stays_closed, 0.49, (0.51, INF, NAN), "power_age"),
    *fields(stays_closed, 0.24, (0.26, INF, NAN), "servo_age"),
    *fields(stays_closed, 5.1, (4.9, NAN, -INF), "thermal_reserve"),
    *fields(stays_closed, 10.4, (10.6, INF, NAN), "charge_current"),
    *fields(stays_closed, -0.49, (-0.51, -INF), "charge_current"),
    Limit("out of the target for 0.05 s, A", lambda v: stays_closed(time=0.05, charge_current=v), -4.9, -5.1, (-INF,)),
    Limit("out of the target, s", lambda v: stays_closed(time=v, charge_current=-0.6), 0.09, 0.11, ()),
    Limit("over the profile's current, s", lambda v: stays_closed(time=v, charge_current=10.6), 0.09, 0.11, ()),
    *fields(stays_closed, 29.69, (29.71, INF, NAN), "target_voltage"),
    *fields(stays_closed, 18.1, (17.9, 0.0, -24.0, -INF), "target_voltage"),
    Limit("target's voltage off, s", lambda v: stays_closed(time=v, target_voltage=29.8), 0.09, 0.11, ()),
    *fields(stays_closed, 22.8, (29.81, NAN), "battery_voltage"),
    *fields(stays_closed, True, (False,), "torque_enabled", "contactor_closed"),
    *fields(stays_closed, 0, (*range(1, 10), 255), "power_fault"),
    *fields(stays_closed, 0.99, (1.01,), "time"),  # docking itself paused
    Limit("contact while live, A", lambda v: stays_closed(pressing(v)), 0.16, 0.14, ()),
    Limit("retreat while live, mm", lambda v: stays_closed(pressing(z=0.08 - v * MM)), 1.4, 1.6, ()),
    Limit("unknown angle, s", lambda v: stays_closed(angles=without(pressing().angles, 0), time=v), 0.24, 0.26, ()),
    Limit(
        "unknown current, s", lambda v: stays_closed(currents=without(pressing().currents, 0), time=v), 0.24, 0.26, ()
    ),
    Limit("servos not read, s", lambda v: stays_closed(servos_valid=False, time=v), 0.24, 0.26, ()),
    *fields(touches_live, 0.49, (0.51, INF, NAN), "tactile_age"),
    *fields(touches_live, 5.1, (4.9, NAN), "thermal_reserve"),
    *fields(continues, 0.49, (0.51, INF, NAN), "servo_age", "tactile_age"),
    *fields(continues, 0, (1, 0x20, 0xFF), "hardware_error"),
    *fields(continues, True, (False,), "torque_enabled"),
    Limit("hard contact, A", lambda v: continues(seen=pressing(v)), 0.99, 1.01, ()),
    Limit("lead, mm", lambda v: continues(codes.State.CONTACT, lead=v * MM), 2.9, 3.1, ()),
    Limit("retreat that parts, mm", lambda v: parts(v * MM), 4.1, 3.9, ()),
    Limit(
        "damping, N·m·s/rad",
        lambda v: not swing.surely_swings(swing.Swung(15.0, v, 0.0, 0.0)),
        0.151,
        0.149,
        (0.0, -0.1),
    ),
    Limit("pads when parting", lambda v: parts(0.005, v), False, True, ()),
    *fields(moves_on, 0.09, (0.11, INF, NAN), "servo_age", "tactile_age"),
)


def test_only_known_currents_count_and_repeated_ones_are_recognized() -> None:
    shared = scene()
    shared.observe(replace(pressing(), time=0.01, currents=without(pressing().currents, 0)))
    assert shared.contact.value == pytest.approx(0.45)
    assert shared.contact.repeats_itself
    shared.observe(replace(pressing(0.46), time=0.02))
    assert not shared.contact.repeats_itself


# What docking is answered: probe, detection, goal, estimates while charging.


def answered(script: Any, shared: context.Context, **reply: Any) -> Any:
    """Answer the script's request with this reply; return what the script returns, None if it goes on."""
    next(script)
    number = shared.command().requests[-1].number
    shared.observe(replace(pressing(), time=shared.time + 0.01, replies=(observation.Reply(number, True, **reply),)))
    try:
        next(script)
    except StopIteration as end:
        return end.value
    return None


def energises(profile: str = "seven", **probe: Any) -> bool:
    shared = scene(profile)
    found = {"resistance": NAN, "target_voltage": 24.0} | probe
    return passes(lambda: answered(energy.energise(shared), shared, **found)) and shared.energise


def opens(age: float, seconds: float = 0.5, **changes: Any) -> bool:
    """Return whether docking believes that the contactor is open, by reports of this age."""
    shared = scene(**changes)
    shared.live = True
    script = energy.de_energise(shared)
    for at in np.arange(0.0, seconds, 0.01):
        shared.observe(replace(pressing(), time=at, power_age=age, **changes))
        if next(script, "opened") == "opened":
            return True
    return False


def locates(age: float) -> bool:
    shared = scene()
    found = observation.ElectrodePose(DOCK, 0.0, age=age)
    return passes(lambda: answered(algorithm.locate(shared), shared, detection=found))


def rolls(roll: float, sigma: float = 0.0) -> bool:
    seen = observation.ElectrodePose(DOCK, roll * DEGREE, sigma * DEGREE)
    return passes(algorithm.check_roll, scene(), seen, 12.0 * DEGREE)


def leans(sigma: float = 0.0, **lean: float) -> bool:
    sizes = {name: value * DEGREE for name, value in lean.items()}
    sigmas = {f"{name}_stddev": sigma * DEGREE for name in lean}
    return passes(algorithm.check_lean, scene(), observation.ElectrodePose(DOCK, 0.0, **sizes, **sigmas))


def serves(**goal: Any) -> bool:
    return passes(goals.check_goal, observation.DockGoal(None, **goal), scene().planner, PARAMETERS, PROFILES)


def charges_on(*estimates: clearance.MisalignmentEstimate | None) -> bool:
    """Return whether charging goes on after these clearance checks."""
    shared = scene()
    order = charging.Order(observation.DockGoal(None), 12.0 * DEGREE, 0.0)
    checks = charging.clearance_checks(shared, order, touch.Target(shared, 12.0 * DEGREE))

    def check() -> None:
        for found in estimates:
            next(checks)
            shared.observe(replace(pressing(), time=shared.time + 2.01))
            answered(checks, shared, estimate=found)

    return passes(check)


def blinds(**changes: Any) -> bool:
    return charges_on(*[estimate(**changes)] * 3)


TILTED = estimate(angle=11.8 * DEGREE)
ANSWERS = (
    *fields(energises, NAN, (INF, -INF, 2000.0, 0.0), "resistance"),
    *fields(energises, 19.1, (18.9, 0.0, -24.0, NAN, -INF), "target_voltage"),
    *fields(energises, 29.39, (29.41, INF), "target_voltage"),
    Limit("dead port, Ω", lambda v: energises("late", resistance=v, target_voltage=0.0), 1.01, 0.99, (0.0, NAN)),
    Limit("open port", lambda v: energises(v, resistance=INF, target_voltage=0.0), "late", "seven", ()),
    Limit("dead port that is live, V", lambda v: energises("late", target_voltage=v), 19.1, 18.9, (29.5, -24.0)),
    Limit("report after opening, s", lambda v: opens(v), 0.3, 0.5),
    Limit("current after opening, A", lambda v: opens(0.0, charge_current=v), 0.49, 0.51, (-0.51, INF)),
    Limit("contactor after opening", lambda v: opens(0.0, contactor_closed=v), False, True, ()),
    Limit("age of a detection, s", locates, 0.99, 1.01, (INF, NAN)),
    Limit("roll, °", rolls, 11.9, 12.1, (-12.1, NAN, INF)),
    Limit("roll's σ, °", lambda v: rolls(10.0, v), 0.99, 1.01, (NAN, INF)),
    Limit("yaw, °", lambda v: leans(1.0, yaw=v), 6.9, 7.1, (-7.1, INF)),
    Limit("pitch, °", lambda v: leans(1.0, pitch=v), 6.9, 7.1, (-7.1, INF)),
    *fields(serves, 0.209, (0.210, -0.01, NAN, INF), "critical_angle"),
    Limit("blind checks", lambda v: charges_on(*[None] * v), 2, 3, ()),
    Limit("checks without clearance", lambda v: charges_on(*[TILTED] * v), 1, 2, ()),
    *fields(blinds, 0.001, (NAN, INF), *POSES),
    *fields(blinds, True, (False,), "contact", "sure", "in_range"),
)


# The board: its packets, probe and heartbeat, as the host and as the emulated board judge them.


def leases(duration: float, after: float = 0.0) -> bool:
    lease = contactor.ContactorLease()
    lease.probed(NAN, 24.0, 0.0)
    return passes(lambda: lease.grant("docking", duration, 0.0, limits=LIMITS)) and lease.is_live(after)


def guard(newton: float = 1.0, fault: int = 0, power_age: float = 0.0, frame_age: float = 0.0, **probe: float) -> Any:
    """Return a guard after a probe, and the times of its clock."""
    link, now = Mock(), [10.0]
    link.probe.return_value = protocol.ProbeResult(**{"resistance": NAN, "target_voltage": 24.0, "time": 10.0} | probe)
    made = contactor.ContactorGuard(link, clock=lambda: now[0])
    made.probe()
    made.observe_power(protocol.PowerSample(10.0 - power_age, protocol.Power(26.0, 24.0, 0.0, False, fault)))
    feel(made, 10.0 - frame_age, newton)
    return made, now


def feel(guard: contactor.ContactorGuard, time: float, newton: float) -> None:
    pads = np.full((2, 10, 10), NAN, np.float32)
    pads[1, 4, 4] = newton
    guard.observe_tactile(protocol.TactileSample(time, 1, 0, pads, True, False))


def guards(**given: Any) -> bool:
    """Return whether the guard closes the contactor."""
    return passes(guard(**given)[0].close, "docking", 0.25, "", LIMITS)


def renews(newest: float, touched: float) -> bool:
    """Return whether the guard renews a lease with a newest frame and a last contact of these ages (s)."""
    made, now = guard()
    made.close("docking", 0.25, "", LIMITS)
    now[0] = 10.2
    made._frames.clear()
    for age, newton in ((touched, 2.0), (newest, 2.0 if newest == touched else 0.0)):
        feel(made, 10.2 - age, newton)
    return passes(made.close, "docking", 0.25)


def stage(resistance: float = NAN, voltage: float = 24.0, closed: bool = False, fault: int = 0) -> Any:
    reading = StageReading(26.0, 24.0, 24.0, 5.0 if closed else 0.0, closed, fault)
    return SimpleNamespace(probe=lambda: (resistance, voltage), read_power=lambda: reading, drive=lambda outputs: None)


def board(heartbeat: float = 0.0, probe: float = 0.0, **plant: Any) -> EmulatedPower:
    """Return an emulated board that was to close at 10 s, so long (s) after heartbeat and probe."""
    power = EmulatedPower(stage(**plant), probe_time=0.0)
    power.start_probe(10.0 - probe)
    power.poll_probe(10.0 - probe)
    power.heartbeat(10.0 - heartbeat)
    power.close(LIMITS, 10.0)
    return power


def board_closes(**given: Any) -> bool:
    return board(**given).closed


def board_holds(silence: float, fault: int = 0) -> bool:
    power = board()
    power._plant = stage(closed=True, fault=fault)
    power.poll(10.0 + silence)
    return power.closed and power.fault == 0


def keeps(seconds: float = 5.1, **reading: Any) -> bool:
    """Return whether the emulated board keeps its contactor closed for so long on this reading."""
    watch, power = PowerStage(lambda outputs: None, StageParameters()), StageReading(26.0, 24.0, 24.0, 5.0, True)
    watch.close(LIMITS, 0.0)
    for at in np.arange(0.0, seconds + 0.003, 0.001):  # three steps pre-charge, pull in and charge
        if watch.step(power, at) or watch.dropped_out:
            return False
        power = power._replace(**reading) if getattr(watch, "_flowed", False) else power
    return True


def clears_weld(**reading: Any) -> bool:
    return not protocol.weld_problem(protocol.Power(26.0, NAN, 0.0, False, 7)._replace(**reading))


def finds_open(current: float = 0.0, closed: bool = False, after: float = 0.051) -> bool:
    watch = PowerStage(lambda outputs: None, StageParameters())
    return not watch.step(StageReading(26.0, 24.0, 0.0, current, closed), after)


def test_faults_have_the_numbers_of_the_wire_and_the_codes_of_docking() -> None:
    assert sorted(protocol.BoardFault) == list(range(10))
    assert protocol.BoardFault.STALE == 3
    found = {number: int(kind.code) for number, (kind, _) in codes.POWER_FAULTS.items()}
    assert found == {number: 500 + number for number in range(1, 8)} | {8: 503, 9: 303}


BOARD = (
    Limit("lease, s", leases, 0.01, 0.0, (-0.1, NAN)),
    Limit("longest lease, s", lambda v: leases(9.0, v), 0.249, 0.251),
    *fields(guards, 0.49, (0.51, INF, NAN), "power_age"),
    *fields(guards, 0.09, (0.11, INF, NAN), "frame_age"),
    Limit("frame of a renewal, s", lambda v: renews(v, v), 0.24, 0.26, (INF,)),
    Limit("contact before the newest frame of a renewal, s", lambda v: renews(0.1, 0.1 + v), 0.09, 0.11, ()),
    *fields(guards, 1.01, (0.99, 0.0, NAN), "newton"),
    *fields(guards, 0, range(1, 10), "fault"),
    *fields(guards, NAN, (0.99, 1.01, INF), "resistance"),
    *fields(guards, 1.0, (0.99, -24.0, NAN), "target_voltage"),
    *fields(guards, 8.01, (7.99, NAN, -INF), "time"),
    *fields(board_closes, 0.094, (0.096, INF), "heartbeat"),
    *fields(board_closes, 1.99, (2.01, INF), "probe"),
    *fields(board_closes, NAN, (0.99, 1.01, INF), "resistance"),
    *fields(board_closes, 1.0, (0.99, -24.0, NAN), "voltage"),
    *fields(board_closes, False, (True,), "closed"),
    Limit("power stage, s", lambda v: board_holds(v, fault=9), 0.009, 0.011, ()),
    *fields(keeps, 19.9, (20.1, -5.1, -0.51, 0.04, NAN), "current"),
    *fields(keeps, 10.1, (9.9, 1.9, -1.1, NAN), "target"),
    *fields(keeps, 29.69, (29.71,), "target"),
    *fields(keeps, 22.71, (22.69, NAN), "battery"),
    *fields(keeps, 29.79, (29.81,), "battery"),
    Limit("bounce, s", lambda v: keeps(v, closed=False), 0.019, 0.022, ()),
    Limit("unknown current, s", lambda v: keeps(v, current=NAN), 0.099, 0.103, ()),
    Limit("wrong target, s", lambda v: keeps(v, target=9.9), 0.099, 0.103, ()),
    Limit("low battery, s", lambda v: keeps(v, battery=22.6), 4.999, 5.003, ()),
    *fields(finds_open, 0.49, (0.51, -0.51), "current"),
    *fields(finds_open, False, (True,), "closed"),
    Limit("contacts open, s", lambda v: finds_open(closed=True, after=v), 0.049, 0.051, ()),
    *fields(clears_weld, 0.49, (0.51, -0.51, NAN), "charge_current"),
    *fields(clears_weld, 4.9, (5.1, -5.1, INF), "target_voltage"),
    *fields(clears_weld, False, (True,), "contactor_closed"),
)


# The servos: who may move them, what they measure, and what may be asked of them.


def frees(age: float = 0.0, later: float = 0.0, closed: bool = False) -> bool:
    """Return whether a report of this age frees the arm so much later."""
    guard = motion.MotionGuard()
    guard.observe(b"board", closed, False, age, 10.0)
    return guard.state(10.0 + later, True) is motion.ContactorState.OPEN


def blocks(age: float) -> bool:
    guard = motion.MotionGuard()
    guard.observe(b"board", True, False, age, 10.0)
    return guard.state(10.0, True) is motion.ContactorState.CLOSED


def follows(time: float = 1.0, angle: float = 0.0, torque: float = 1.0, points: int = 1, age: float = 0.0) -> bool:
    limits = motion.JointLimits(("joint",), -1.0, 1.0, 4.0)
    way = [motion.ServoWaypoint(time + number, (angle,), (torque,)) for number in range(points)]
    return passes(motion.check, ("joint",), way, limits) and passes(motion.check_age, age)


def measures(torque: int = 1, current: int = 0, voltage: int = 120, temperature: int = 40, watchdog: int = 6) -> bool:
    block = struct.pack("<BBhiiHBBBB", torque, 0, current, 0, 2048, voltage, temperature, watchdog, 2, 0)
    return passes(registers.decode_block, block, servo_types.MX_64)


def heated(temperature: float, current: float = 3.0, servo: servo_types.ServoType = servo_types.MX_64) -> float:
    """Return the reserve (s) of a servo that starts at this temperature (°C) with this current (A)."""
    model = controller.ThermalModel(servo)
    model.start_at(temperature)
    model.update(current, 0.0)
    return model.reserve()


SERVOS = (
    *fields(frees, 0.19, (0.21, INF, NAN), "age"),
    *fields(frees, -0.09, (-0.11, -INF), "age"),
    *fields(frees, 0.19, (0.21, INF), "later"),
    *fields(frees, False, (True,), "closed"),
    Limit("closed, by a stamp of any error", blocks, NAN, 0.21, ()),
    *fields(follows, 0.0, (-0.01, NAN, INF), "time"),
    *fields(follows, 0.99, (1.01, -1.01, NAN, INF), "angle"),
    *fields(follows, 3.99, (4.01, -0.01, NAN, INF), "torque"),
    *fields(follows, 1000, (1001,), "points"),
    *fields(follows, 0.49, (0.51, -0.51, NAN, INF), "age"),
    Limit("order, s", lambda v: not real_time.late(v), 1.99, 2.01, (NAN, INF)),
    *fields(measures, 1, (2,), "torque"),
    *fields(measures, 2047, (2048, -2048), "current"),
    *fields(measures, 40, (39, 0), "voltage"),
    *fields(measures, 300, (301,), "voltage"),
    *fields(measures, 125, (126,), "temperature"),
    *fields(measures, 127, (128,), "watchdog"),
    Limit(
        "goal, turns", lambda v: passes(registers.angle_to_ticks, v * math.tau, 0, 1), 255.9, 256.1, (NAN, INF, -INF)
    ),
    Limit("bound, A", lambda v: passes(registers.current_to_counts, v, servo_types.MX_64), 6.5, 6.6, (NAN, INF)),
    Limit("time at 3 A, s", lambda v: heated(25.0) > v, 119.9, 120.1),
    Limit("time at 3 A from below 25 °C, s", lambda v: heated(-10.0) > v, 119.9, 120.1),
    Limit("hottest, °C", lambda v: heated(v) > 0.0, 79.9, 80.1, (INF,)),
    Limit("XM430: time at 1.8 A, s", lambda v: heated(25.0, 1.8, servo_types.XM430_W350) > v, 119.9, 120.1),
    Limit("current for ever, A", lambda v: heated(25.0, v) == INF, 0.51, 0.52),
)


# The camera, and where things are.


def shows(long: float, end: float, other_long: float, other_end: float, scatter: float = 0.5) -> bool:
    """Return whether these visible shares of two bars' outlines support a detection."""
    shares, fit = [[long, end] * 2, [other_long, other_end] * 2], SimpleNamespace(scatter=scatter)
    return supported(np.array(shares), fit) > 0.0  # type: ignore[arg-type]


def mounts(x: float = 0.0, w: float = 1.0) -> bool:
    return passes(mount.Mount.from_numbers, (x, 0.12, -0.12, 0.0, 0.0, 0.0, w))


CAMERA = (
    Limit("both outlines", lambda v: shows(0.8, 0.8, v, v), 0.31, 0.29),
    Limit("clearer outline", lambda v: shows(v, v, 0.7, 0.7), 0.76, 0.74),
    Limit("sides of the other bar", lambda v: shows(1.0, 1.0, v, 1.0), 0.16, 0.14),
    Limit("ends of the clearer bar", lambda v: shows(1.0, v, 0.8, 0.3), 0.51, 0.49),
    Limit("scatter, px", lambda v: shows(1.0, 1.0, 1.0, 1.0, v), 0.99, 1.01),
    *fields(mounts, 9.99, (10.01, -10.01, NAN, INF), "x"),
    *fields(mounts, 1.0009, (1.0011, 0.9989, NAN, INF), "w"),
)


# What users may set.


def settable(kind: Any, name: str, inside: float, outside: float) -> Limit:
    ask = lambda value: passes(lambda: kind(**{name: value}))  # noqa: E731
    return Limit(f"{kind.__name__}: {name}", ask, inside, outside, (NAN, INF, -INF))


SETTINGS = (
    settable(DockingParameters, "critical_angle", 0.2103, 0.2104),
    settable(DockingParameters, "clearance_min", 0.0, -1e-4),
    settable(DockingParameters, "live_servo_age_max", 0.5, 0.51),
    settable(DockingParameters, "age_max", 2.0, 2.1),
    settable(ServoNodeParameters, "current_max", 4.1, 4.2),
    settable(servo_types.MeasuredServos, "stiffness", 0.5, 0.4),
    settable(servo_types.MeasuredServos, "torque_constant", 0.1, 0.09),
)


ROWS = (*CLEARANCE, *OBSERVATION, *ANSWERS, *BOARD, *SERVOS, *CAMERA, *SETTINGS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.what} {row.inside}")
def test_limit(row: Limit) -> None:
    assert row.accepts(row.inside)
    assert not [value for value in (row.outside, *row.refused) if row.accepts(value)]


def test_a_goal_moves_from_the_start_of_its_trajectory() -> None:
    servo = motion.ServoGoals(1, 0.83, 1.46)
    servo.begin_at((0.0,))
    servo.follow(motion.Trajectory((1.0,), ((1.0,),), (None,)), 10.0, 10.0)
    servo.advance(10.5)
    assert servo.angles == (0.5,)


def test_a_target_of_unknown_pitch_has_a_known_place() -> None:
    mission = MissionMachine(MissionParameters(), BaseMount((0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 0.5)), None)
    mission.status.place = Place(0.0, 0.0, 0.0)
    seen = observation.ElectrodePose(DOCK, 0.0, yaw=0.1, yaw_stddev=0.01)
    assert mission._placed(seen, Place(1.0, 0.0, 0.0)) == Place(0.08, 0.0, pytest.approx(0.1 - math.pi))


def test_numbers_that_need_more_than_a_row() -> None:
    assert estimator.PoseEstimator().threshold == 0.25  # N, below which readings are noise
    assert not passes(perception.FrameWindow(lambda: 10.0).fresh, 1, 0.01)  # s; no frame, so no estimate
    assert release.FREE_CURRENT < contact.CONTACT_LOST_CURRENT <= 0.15  # A, the least band
    assert (touch._CLEARANCE_CONTACTS, charging.CLEARANCE_PERIOD, watch._FAULT_DELAY) == (2, 2.0, 0.15)
    assert (motion.STOP_TIME, controller.OPENING_TIME) == (0.5, 0.3)  # s until torque goes off
