# SPDX-License-Identifier: Apache-2.0
"""Faults of hostile dockings and the codes that each may end with: the table, and what is drawn of it."""

import dataclasses
import math
import random

import numpy as np

from deltacharger_docking import codes, observation
from deltacharger_lab.campaigns import faults as do
from deltacharger_lab.campaigns.faults import Acting, HostileFault

GOAL = "GOAL"
"""Onset with the goal, before anything moves."""
TIMED = "TIME"
"""Onset at a time after the goal."""
SUSPENDED = "suspended"
"""Name of the fault in which docking itself is not stepped."""
_STATES = ("APPROACH", "CONTACT", "MEASURE", "ALIGN", "ENERGISE", "CHARGING", "RETRACT")
_TORQUE = (observation.Service.TORQUE_ON, observation.Service.TORQUE_OFF)
_LOOSE = "NONE SERVO_FAULT STUCK"
_PUSH_UNKNOWN = "NONE SERVO_FAULT STUCK OVERCURRENT NO_CONTACT"
_ELSEWHERE = "NONE SERVO_FAULT STUCK NO_CONTACT NO_TACTILE_CONTACT ESTIMATE_UNSURE MISALIGNED"
_FELT_LESS = "NONE SERVO_FAULT NO_CONTACT NO_TACTILE_CONTACT ESTIMATE_UNSURE MISALIGNED"
_MOVED = "NONE CRITICAL_ANGLE MISALIGNED ESTIMATE_UNSURE NO_CONTACT NO_CHARGE_CURRENT SHORT_CIRCUIT"
_DEGREE = math.radians(1.0)

FAULTS: tuple[HostileFault, ...] = (
    HostileFault("servo_stays", "servo", _LOOSE, order=do.stays),
    HostileFault("servo_slow", "servo", f"{_LOOSE} TIMEOUT", (0.05, 0.4), unit="rad/s", order=do.slow),
    HostileFault("servo_limp", "servo", _LOOSE, order=do.limp),
    HostileFault("servo_limp_told", "servo", _LOOSE, order=do.limp, seen=do.sees(torque_enabled=False)),
    HostileFault("gear_friction", "servo", f"{_LOOSE} NO_TACTILE_CONTACT", (0.4, 1.0), unit="N·m", world=do.rubs),
    HostileFault("hardware_error", "servo", _LOOSE, seen=do.sees(hardware_error=32)),
    HostileFault("angle_nan", "servo", _LOOSE, seen=do.nan_angle),
    HostileFault(
        *("current_frozen", "current", _PUSH_UNKNOWN),
        reading=do.current(lambda a, value, index: a.memory.setdefault(index, value)),
    ),
    HostileFault("current_low", "current", _PUSH_UNKNOWN, reading=do.current(lambda _, value, __: 0.3 * value)),
    HostileFault("current_high", "current", _PUSH_UNKNOWN, reading=do.current(lambda _, value, __: 1.3 * value)),
    HostileFault("current_nan", "current", _LOOSE, reading=do.current(lambda _, __, ___: math.nan)),
    HostileFault("current_flipped", "current", _PUSH_UNKNOWN, reading=do.current(lambda _, value, __: -value)),
    HostileFault(
        *("current_offset", "current", f"{_PUSH_UNKNOWN} NO_TACTILE_CONTACT", (-0.5, 0.5)),
        unit="A",
        reading=do.current(lambda a, value, _: value + a.size),
    ),
    HostileFault("encoder_frozen", "angle", _LOOSE, reading=do.frozen_encoder, order=do.by_frozen_encoder),
    HostileFault(
        *("encoder_slips", "angle", _ELSEWHERE),
        choices=(-10.0 * _DEGREE, 10.0 * _DEGREE),
        unit="rad",
        reading=do.slipped,
        order=do.by_slipped,
    ),
    HostileFault(
        "encoder_offset", "angle", _ELSEWHERE, (-3.0 * _DEGREE, 3.0 * _DEGREE), unit="rad", reading=do.slipped
    ),
    HostileFault("encoder_noise", "angle", _ELSEWHERE, (0.1 * _DEGREE, 2.0 * _DEGREE), unit="rad", reading=do.noisy),
    HostileFault(
        *("pads_frozen", "pads", f"{_FELT_LESS} TACTILE_STALE"),
        frame=lambda a, frames: np.broadcast_to(a.memory.setdefault("frame", frames[-1]), frames.shape),
    ),
    HostileFault(
        *("pads_stale", "pads", "NONE TACTILE_STALE"),
        seen=do.stale,
        reply=do.silent(observation.Service.ESTIMATE, observation.Service.TARE),
        nodelike=True,
    ),
    HostileFault("pad_dead", "pads", f"{_FELT_LESS} TACTILE_STALE", frame=do.one_pad),
    HostileFault(
        *("pad_touched", "pads", f"{_LOOSE} TACTILE_STALE NO_CONTACT ESTIMATE_UNSURE MISALIGNED TARGET_ROLLS"),
        (2.0, 5.0),
        unit="N",
        frame=do.touched,
    ),
    HostileFault("pads_half", "pads", _FELT_LESS, frame=lambda _, frames: 0.5 * frames),
    HostileFault(
        *("pads_nan", "pads", "NONE TACTILE_STALE NO_TACTILE_CONTACT ESTIMATE_UNSURE"),
        frame=lambda _, frames: np.full(frames.shape, math.nan),
    ),
    HostileFault("pads_untared", "pads", "NONE TACTILE_STALE", seen=do.sees(tared=False)),
    HostileFault(
        *("servo_late", "time", "NONE SERVO_STALE TIMEOUT", (0.1, 0.5)), unit="s", seen=do.servo_late, nodelike=True
    ),
    HostileFault(
        *("tactile_late", "time", "NONE TACTILE_STALE NO_TACTILE_CONTACT TIMEOUT", (0.1, 0.5)),
        unit="s",
        seen=do.tactile_late,
        nodelike=True,
    ),
    HostileFault("observed_twice", "time", "NONE", steps=lambda _: 2),
    HostileFault(
        *(SUSPENDED, "time", "NONE POWER_STALE"),
        lasts=(0.2, 2.0),
        flickers=False,
        steps=lambda _: 0,
        nodelike=True,
    ),
    HostileFault("power_silent", "power", "NONE POWER_STALE CONTACTOR_WELDED", seen=do.power_silent),
    HostileFault(
        "charge_current_nan", "power", "NONE POWER_STALE CONTACTOR_WELDED", seen=do.sees(charge_current=math.nan)
    ),
    HostileFault(
        *("target_voltage", "power", "NONE VOLTAGE_OUT_OF_RANGE REVERSE_POLARITY POWER_STALE CONTACTOR_WELDED"),
        choices=(math.nan, 29.0, 3.0, -5.0, 45.0),
        unit="V",
        seen=do.sees(target_voltage=None),
    ),
    HostileFault(
        *("battery_voltage", "power", "NONE VOLTAGE_OUT_OF_RANGE POWER_STALE"),
        choices=(15.0, 35.0, math.nan),
        unit="V",
        seen=do.sees(battery_voltage=None),
    ),
    *(
        HostileFault(f"power_fault_{bit}", "power_fault", f"NONE {kind.code.name}", seen=do.sees(power_fault=bit))
        for bit, (kind, _) in codes.POWER_FAULTS.items()
    ),
    HostileFault("contactor_opens", "contactor", "NONE POWER_STALE NO_CHARGE_CURRENT", world=do.opens),
    HostileFault(
        *("contactor_refused", "contactor", "NONE NO_CHARGE_CURRENT POWER_STALE"),
        seen=lambda _, seen: (
            seen if seen.contactor_closed else dataclasses.replace(seen, contactor_refusal="interlock")
        ),
        world=do.refuses,
    ),
    HostileFault("no_current", "contactor", "NONE NO_CHARGE_CURRENT", world=do.idles),
    HostileFault(
        *("contactor_welded", "weld", "NONE CONTACTOR_WELDED"),
        onsets=("APPROACH", "ENERGISE", "CHARGING", "RETRACT"),
        flickers=False,
        world=do.welds,
    ),
    HostileFault(
        *("weld_told_open", "weld", "NONE CONTACTOR_WELDED"),
        seen=do.sees(power_fault=7, contactor_closed=False, charge_current=0.0),
    ),
    HostileFault(
        "current_while_open", "weld", "NONE CONTACTOR_WELDED POWER_STALE", (0.6, 5.0), unit="A", seen=do.leaks
    ),
    HostileFault("probe_silent", "probe", "NONE POWER_STALE", reply=do.silent(observation.Service.PROBE)),
    HostileFault("probe_refused", "probe", "NONE POWER_STALE", reply=do.refused(observation.Service.PROBE)),
    HostileFault(
        *("probe_late", "probe", "NONE POWER_STALE", (0.5, 3.0)),
        unit="s",
        late=lambda a, service: a.size if service is observation.Service.PROBE else 0.0,
    ),
    HostileFault(
        *("probe_short", "probe", "NONE SHORT_CIRCUIT"),
        reply=do.answers(observation.Service.PROBE, resistance=0.2, target_voltage=0.0),
    ),
    HostileFault(
        *("probe_open", "probe", "NONE NO_CHARGE_CURRENT LEANING"),
        reply=do.answers(observation.Service.PROBE, resistance=math.inf, target_voltage=math.nan),
    ),
    HostileFault(
        *("probe_voltage", "probe", "NONE VOLTAGE_OUT_OF_RANGE REVERSE_POLARITY POWER_STALE NO_CHARGE_CURRENT"),
        choices=(-24.0, 5.0, 45.0, math.nan),
        unit="V",
        reply=do.answers(observation.Service.PROBE, target_voltage=None),
    ),
    HostileFault("tare_silent", "service", "NONE TACTILE_STALE", reply=do.silent(observation.Service.TARE)),
    HostileFault("tare_refused", "service", "NONE TACTILE_STALE", reply=do.refused(observation.Service.TARE)),
    HostileFault("estimate_silent", "service", "NONE TACTILE_STALE", reply=do.silent(observation.Service.ESTIMATE)),
    HostileFault(
        "estimate_refused",
        "service",
        "NONE TACTILE_STALE ESTIMATE_UNSURE",
        reply=do.refused(observation.Service.ESTIMATE),
    ),
    HostileFault("torque_silent", "service", "NONE SERVO_FAULT", reply=do.silent(*_TORQUE)),
    HostileFault("torque_refused", "service", "NONE SERVO_FAULT", reply=do.refused(*_TORQUE)),
    HostileFault(
        *(
            "estimate_turned",
            "estimator",
            "NONE CRITICAL_ANGLE ESTIMATE_UNSURE MISALIGNED SHORT_CIRCUIT",
            (-0.14, 0.14),
        ),
        unit="rad",
        reply=do.estimates(lambda a, estimate: {"angle": estimate.angle + a.size}),
    ),
    HostileFault(
        *("estimate_unsure", "estimator", "NONE CRITICAL_ANGLE ESTIMATE_UNSURE MISALIGNED"),
        reply=do.estimates(lambda _, __: {"sure": False}),
    ),
    HostileFault(
        "second_source",
        "source",
        "NONE DUPLICATE_SOURCE",
        flickers=False,
        seen=do.sees(duplicate_sources="servo_state"),
    ),
    HostileFault(
        *("second_source_flaps", "source", "NONE DUPLICATE_SOURCE"),
        flickers=False,
        seen=lambda a, seen: (
            dataclasses.replace(seen, duplicate_sources="servo_state") if a.age() * 4.6 % 1.0 < 0.5 else seen
        ),
    ),
    HostileFault(
        *("target_leaves", "target", f"{_MOVED} NO_TACTILE_CONTACT TARGET_ROLLS", (0.005, 0.06)),
        unit="m",
        flickers=False,
        target=lambda a: (0.0, 0.0, a.level * a.size, 0.0),
    ),
    HostileFault(
        *("target_parts", "target", f"{_MOVED} NO_TACTILE_CONTACT TARGET_ROLLS", (0.003, 0.02)),
        unit="m",
        onsets=("MEASURE", "ENERGISE", "ENERGISE", "CHARGING"),
        flickers=False,
        lasts=(0.05, 0.5),
        target=lambda a: (0.0, 0.0, min(a.level * a.ramp / 0.05, 1.0) * a.size, 0.0),
    ),
    HostileFault(
        *("target_nearer", "target", "NONE OVERCURRENT NO_TACTILE_CONTACT UNREACHABLE", (0.016, 0.06)),
        unit="m",
        onsets=(GOAL,),
        flickers=False,
        lasts=(math.inf, math.inf),
        target=lambda a: (0.0, 0.0, -a.size if a.lasting else 0.0, 0.0),
    ),
    HostileFault(
        *("target_sideways", "target", f"{_MOVED} NO_TACTILE_CONTACT", (-0.015, 0.015)),
        unit="m",
        flickers=False,
        target=do.sideways,
    ),
    HostileFault(
        *("target_turns", "target", f"{_MOVED} NO_TACTILE_CONTACT", (-0.26, 0.26)),
        unit="rad",
        flickers=False,
        target=lambda a: (0.0, 0.0, 0.0, a.level * a.size),
    ),
    HostileFault(
        *("target_shakes", "target", f"{_MOVED} NO_TACTILE_CONTACT OVERCURRENT", (0.002, 0.004)),
        unit="m",
        flickers=False,
        target=do.shakes,
    ),
    HostileFault(
        *("target_rolls", "target", "NONE TARGET_ROLLS NO_CONTACT NO_TACTILE_CONTACT", (0.0, 10.0)),
        unit="N",
        flickers=False,
        world=do.rolls,
    ),
)
"""The table, written from docs/errors.md before any run.

Seeds 20 and 501 to 504 added `target_parts`; that a divider may read as a weld; that pads which feel less while live
end as a lost contact, since the contactor opens on the first frame; that pads and currents contradict each other
whoever lies; that a turned target's ridges are missed; and that the probe finds what a wrong estimate overlooked.
"""

SCENES = {
    "default": "NONE",
    "upright": "NONE",
    "lean5": "NONE LEANING NO_CHARGE_CURRENT",
    "random": "NONE CRITICAL_ANGLE MISALIGNED",
}
"""How dockings without faults end, by the base scene (docs/reports/docking.md)."""
KINDS = tuple(dict.fromkeys(fault.kind for fault in FAULTS))


def allowed(scene: str, faults: list[Acting]) -> set[str]:
    """Return the names of the codes that a docking of a base scene may end with, by the faults that have acted."""
    return set(SCENES[scene].split()).union(*(a.fault.codes.split() for a in faults if math.isfinite(a.since)))


def draw_faults(seed: int) -> list[Acting]:
    """Draw one or two faults of different kinds for the docking with this seed."""
    source = random.Random(f"{seed} hostile")
    kinds = source.sample(KINDS, source.choice((1, 1, 2)))
    return [draw_fault(source.choice([fault for fault in FAULTS if fault.kind == kind]), source) for kind in kinds]


def draw_fault(fault: HostileFault, source: random.Random) -> Acting:
    """Draw what a fault hits, how much, from when and how long."""
    onset = source.choice(fault.onsets or (*_STATES, TIMED))
    most = {GOAL: 0.0, TIMED: 12.0}.get(onset, source.choice((0.2, 1.0)))
    delay = source.uniform(0.0, most)
    lasts = source.choice((math.inf, math.exp(source.uniform(math.log(0.1), math.log(6.0)))))
    flicker = source.choice((0.0, math.exp(source.uniform(0.0, math.log(20.0)))))
    return Acting(
        fault,
        onset=onset,
        delay=delay,
        lasts=lasts if not fault.lasts else fault.lasts[0] + source.random() * _span(fault.lasts),
        flicker=flicker if fault.flickers else 0.0,
        servo=source.randrange(3),
        pad=source.randrange(2),
        size=source.choice(fault.choices) if fault.choices else source.uniform(*fault.sizes),
        ramp=math.exp(source.uniform(math.log(0.05), 0.0)),
        noise=random.Random(f"{source.random()} noise"),
    )


def _span(lasts: tuple[float, ...]) -> float:
    return 0.0 if math.isinf(lasts[0]) else lasts[1] - lasts[0]
