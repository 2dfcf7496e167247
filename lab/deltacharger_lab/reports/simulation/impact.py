# SPDX-License-Identifier: Apache-2.0
"""Impacts: peak force over contact stiffness, step, speed and servo stiffness, against the converged reference."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from deltacharger_core.machine import MAGNET_FORCE, SERVO_STIFFNESS, STALL_CURRENT
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.reports.formats import is_known
from deltacharger_lab.reports.simulation import models, reference, scenes
from deltacharger_sim.parameters import ContactParameters, MagnetParameters, WorldParameters
from deltacharger_sim.world import World

STIFFEST = 1e6  # N/m per electrode up to which the target holds
DOCKING_STEPS = (0.005, 0.01, 0.02)  # s of the world while docking: node and exact campaigns, quick campaigns
COMMANDS = 0.02  # s between commands of a strike; every step of the grid divides it
_STANDS, _BEFORE = 0.2, 0.014  # s at rest, and m before the target, of a strike's start
_AFTER = 0.12  # s after the last command
_SOFT = 1e4  # N/m per electrode up to which strikes can reach the stop
_GRAZING = 5e-5  # m of the stop's depth that must not matter
_TOLERANCES, _TIGHTEST = (1e-5, 1e-6, reference.TOLERANCE), 1e-11  # of the reference, compared with the tightest
_SNAP_GAP = 0.0025  # m before the target, end of a snap's line: within every servo's unstable range


@dataclass(frozen=True)
class Strike:
    """One kind of strike.

    Attributes:
        name: on the page.
        speed: of the commanded line, m/s.
        magnets: N.
        beyond: end of the line, m beyond the target; soft electrodes are pushed 2 mm deeper.
    """

    name: str
    speed: float
    magnets: float = MAGNET_FORCE
    beyond: float = 0.001


STRIKES = (
    Strike("10 mm/s", 0.01),
    Strike("25 mm/s", 0.025),
    Strike("120 mm/s", 0.12),
    Strike("10 mm/s, no magnets", 0.01, 0.0),
    Strike("25 mm/s, no magnets", 0.025, 0.0),
    Strike("120 mm/s, no magnets", 0.12, 0.0),
    Strike("snap by the magnets", 0.02, beyond=-_SNAP_GAP),
)
PRESSING = STRIKES[1]
"""The strike at the speed of docking, for the comparison of tolerances and models."""


def axis_world(contact: float, servo: float = SERVO_STIFFNESS, magnets: float = MAGNET_FORCE) -> WorldParameters:
    """Return parameters of a charger on its axis, weightless and without gear friction."""
    return scenes.world(contact, servo, friction=0.0, gravity_y=0.0, magnets=MagnetParameters(force=magnets))


def strike_orders(parameters: WorldParameters, strike: Strike) -> tuple[float, list[reference.Order], float]:
    """Return the start (m), commands along the line, led by the lag, and the duration (s)."""
    servo, target = parameters.servo, parameters.target.z
    start, deeper = target - _BEFORE, 0.002 * (parameters.contact.stiffness <= _SOFT and strike.beyond > 0.0)
    way = _BEFORE + strike.beyond + deeper
    count, lag = math.ceil(way / (strike.speed * COMMANDS) - 1e-9), (servo.damping + servo.viscosity) / servo.stiffness
    orders = [(0.0, reference.angle(start)[0], STALL_CURRENT)]
    for index in range(count + 1):
        theta, slope, _ = reference.angle(start + min(strike.speed * COMMANDS * (index + 1), way))
        ahead = lag * slope * strike.speed if index < count else 0.0
        orders.append((_STANDS + COMMANDS * index, theta + ahead, STALL_CURRENT))
    return start, orders, COMMANDS * round((_STANDS + _AFTER) / COMMANDS + count)


def obey(moved: World, orders: Sequence[reference.Order], duration: float, step: float) -> float:
    """Run a world with commands in steps of `step` s and return the largest force at an end of a step (N)."""
    sent, ends = 0, 0.0
    for index in range(round(duration / step)):
        while sent < len(orders) and orders[sent][0] <= index * step + 1e-9:
            for servo in range(3):
                moved.command(servo, True, *orders[sent][1:])
            sent += 1
        moved.step(step)
        ends = max(ends, moved.mechanics.contact_force)
    return ends


def strikes(contact: float, servo: float, steps: tuple[float, ...]) -> list[dict[str, Any]]:
    """Return the light model's peak (N) of every strike and step, with the errors (%) of peak and steps' ends."""
    rows = []
    for strike in STRIKES:
        parameters = axis_world(contact, servo, strike.magnets)
        start, orders, duration = strike_orders(parameters, strike)
        exact = reference.on_axis(parameters, start, orders, duration).peak
        grazes = _grazes(parameters, start, orders, duration, exact)
        for step in steps:
            moved = World(parameters, start=(0.0, 0.0, start))
            ends, peak = obey(moved, orders, duration, step), moved.record.peak_force
            row = {"contact": contact, "servo": servo, "strike": strike.name, "step": step, "exact": exact}
            row |= {"peak": peak, "percent": 100.0 * (peak / exact - 1.0)}
            rows.append(row | {"ends_percent": 100.0 * (ends / exact - 1.0), "grazes": grazes})
    return rows


class _NearerStop(ContactParameters):
    hard_stop = ContactParameters.hard_stop - _GRAZING


def _grazes(
    parameters: WorldParameters, start: float, orders: list[reference.Order], duration: float, exact: float
) -> bool:
    """Return whether the reference's own peak would change by more than the limit if the stop were 0.05 mm nearer.

    Soft electrodes may only just reach their stop; less than a step's path error decides whether they strike it.
    """
    contact = parameters.contact
    if contact.stiffness > _SOFT:
        return False
    nearer = replace(parameters, contact=_NearerStop(contact.stiffness, contact.friction))
    return abs(reference.on_axis(nearer, start, orders, duration).peak / exact - 1.0) > models.PEAK_LIMIT / 100.0


def docking_orders() -> list[reference.Order]:
    """Return the commands of `scenes.docking` on the axis: at rest at TRAVEL 1 s after leaving home, then its path."""
    orders = [(0.0, reference.angle(scenes.TRAVEL)[0], STALL_CURRENT)]
    orders += [
        (1.0 + scenes.TICK * tick, reference.angle(scenes.commanded(tick))[0], STALL_CURRENT)
        for tick in range(scenes.PATH_TICKS)
    ]
    return orders


def axis_docking(contact: float, servo: float) -> dict[str, Any]:
    """Return path (list of m) and peak force (N) of `scenes.docking` without weight and gear friction, converged."""
    found = reference.on_axis(
        axis_world(contact, servo), 0.0, docking_orders(), 1.0 + scenes.PATH_TICKS * scenes.TICK, scenes.SAMPLE
    )
    trace: list[Vector] = [(0.0, 0.0, z) for z in found.trace[round(1.0 / scenes.SAMPLE) :]]
    return {"contact": contact, "servo": servo, "trace": trace, "peak": found.peak}


def others(name: str, contacts: tuple[float, ...], step: float) -> list[dict[str, Any]]:
    """Return MuJoCo's peak (N) of the strike at 25 mm/s in steps of `step` s, and the reference's."""
    rows = []
    for contact in contacts:
        parameters = axis_world(contact)
        start, orders, duration = strike_orders(parameters, PRESSING)
        moved = scenes.model_world(name, parameters, step)
        # It starts at home and reaches the start of the strike in one second.
        led = [orders[0], *((when + 1.0, goal, bound) for when, goal, bound in orders)]
        obey(moved, led, duration + 1.0, step)
        row = {"model": name, "contact": contact, "step": step, "peak": moved.record.peak_force}
        rows.append(row | {"exact": reference.on_axis(parameters, start, orders, duration).peak})
    return rows


def tolerances(contacts: tuple[float, ...]) -> list[dict[str, Any]]:
    """Return the change of the reference's peak (N) with its tolerance, in % of the tightest."""
    rows = []
    for contact in contacts:
        parameters = axis_world(contact)
        strike = strike_orders(parameters, PRESSING)
        best = reference.on_axis(parameters, *strike, tolerance=_TIGHTEST).peak
        changes = {
            str(each): 100.0 * (reference.on_axis(parameters, *strike, tolerance=each).peak / best - 1.0)
            for each in _TOLERANCES
        }
        rows.append({"contact": contact, "peak": best, "percent": changes})
    return rows


def worst(rows: Sequence[dict[str, Any]], key: str = "percent", **wanted: Any) -> float:
    """Return the error farthest from 0 of the rows with the given values; NaN for none, or if one is NaN."""
    found = [row[key] for row in rows if all(row[name] == value for name, value in wanted.items())]
    return max(found, key=abs, default=math.nan) if all(map(is_known, found)) else math.nan


def at_docking(rows: Sequence[dict[str, Any]], grazing: bool = True) -> float:
    """Return the worst error (%) at docking's steps, up to 1e6 N/m, with or without strikes that graze the stop."""
    found = [row for row in rows if row["step"] in DOCKING_STEPS and row["contact"] <= STIFFEST]
    return abs(worst([row for row in found if grazing or not row["grazes"]]))


def tasks(plan: scenes.SimulationPlan, names: Sequence[str]) -> list[tuple[str, Any, tuple[Any, ...], float]]:
    """Return name, function, arguments and weight of the section's work."""
    found: list[tuple[str, Any, tuple[Any, ...], float]] = [
        ("strikes", strikes, (contact, servo, plan.strike_steps), 1.0 + contact / 2e8)
        for contact in plan.strike_contacts
        for servo in plan.strike_servos
    ]
    found.append(("tolerances", tolerances, ((min(plan.strike_contacts), 1e5, max(plan.strike_contacts)),), 5.0))
    for name, step in (
        (scenes.MUJOCO, 1e-3),
        (scenes.MUJOCO, 1e-4),
        (scenes.MUJOCO_USUAL, 1e-3),
        (scenes.MUJOCO_USUAL, 1e-4),
    ):
        if name in names:
            found.append(("others", others, (name, plan.strike_contacts, step), 0.005 / step))
    return found
