# SPDX-License-Identifier: Apache-2.0
"""One docking of a campaign, from its number to its row of results."""

import math
import traceback
from typing import Any

from deltacharger_docking.codes import Code, DockingError
from deltacharger_docking.observation import DockGoal, DockingOutcome
from deltacharger_lab.campaigns import disturbances, estimates, judge, keys, parts, targets
from deltacharger_lab.campaigns.disturbances import Nudging
from deltacharger_lab.campaigns.draw import Drawn, draw
from deltacharger_lab.campaigns.published import published
from deltacharger_lab.campaigns.scene import CampaignScene
from deltacharger_lab.campaigns.trial import ExactHostile, QuickHostile, Trial
from deltacharger_sim.virtual import quick_charger, virtual_charger

LIMIT = 420.0  # simulated s; docking itself ends after goal_timeout and its way back
CRASHED = "CRASHED"
_TEXT_MOST = 2000

RESULTS: dict[str, tuple[type, str]] = {
    "code": (int, "code of the outcome, 0 = charged; -1 = the docking crashed, see error"),
    "code_name": (str, "its name"),
    "message": (str, "docking's message of a failure, else empty"),
    "charged": (bool, "whether stable charge current flowed"),
    "aligned": (bool, "whether the last contact was accepted: with clearance, and no gain expected from another one"),
    "time": (float, "s from the goal to its outcome"),
    "moves": (int, "lateral corrections and repeated contacts"),
    "contact_current": (float, "A per servo at the outcome, as measured"),
    "reported_push": (float, "N, force of the servos on the target along z at the outcome, as docking reports it"),
    "force_min": (float, "N, least true push that docking allows then"),
    "force_max": (float, "N, largest one"),
    "friction_force": (float, "N, friction along z that docking measured in free air"),
    "true_push": (float, "N, truth then, without magnets"),
    "assumed_stiffness": (float, "N·m/rad of a servo, as docking assumes it at the outcome"),
    "charge_current": (float, "A into the target at the outcome"),
    "rest_current": (
        float,
        f"A per servo, contact current at rest: median over the last of {disturbances.SECONDS:g} s of charging on",
    ),
    "rest_push": (float, "N, truth then: force of the servos on the target along z, without magnets"),
    "servo_current_1": (float, "A, size of the first servo's current then, median of its readings"),
    "servo_current_2": (float, "A, of the second"),
    "servo_current_3": (float, "A, of the third"),
    "servo_current_hottest": (float, "A, the largest of the three"),
    "ended": (str, f"name of the code that ended charging within those {disturbances.SECONDS:g} s, else empty"),
    "undocked": (str, "name of the code of undocking after that, NONE = success; empty = it did not charge"),
    "undock_time": (float, "s that undocking took"),
    "undock_message": (str, "its message of a failure, else empty"),
    "still_touching": (bool, "whether undocking succeeded although the electrodes touch the target"),
    "target_moved": (float, "m, how far the target stands from its place along z after that"),
    "nudge_opened": (
        float,
        "s from the start of a nudge until the contactor opened; NaN = no nudge, or it stayed closed",
    ),
    "shorts": (int, "times that live electrodes were shorted"),
    "energised": (float, "s that electrodes were live"),
    "energised_unsafe": (float, "s that electrodes were live with negative clearance"),
    "parted_live": (int, "times that live electrodes left the target"),
    "lifted_live": (int, "times that live electrodes had one bar without load while the other pressed"),
    "bar_heat": (float, "W, largest heat in the contact of one bar"),
    "contacts": (int, "times that the electrodes met the target"),
    "peak_force": (float, "N, largest normal force on the electrodes"),
    "peak_push": (float, "N, largest force of the servos along z, impacts of the platform's mass included"),
    "servo_push": (float, "N, the same by the torques of motors and gears, without impacts"),
    "time_above_band": (float, "s in contact with a contact current above the band"),
    "final_horizontal": (float, "m, truth at the outcome, target in end_effector; NaN = not in contact"),
    "final_vertical": (float, "m, as final_horizontal"),
    "final_angle": (float, "rad, as final_horizontal"),
    "final_misalignment": (float, "m, distance of the centres of a charged docking; NaN = not charged"),
    "clearance": (float, "m, truth at the outcome, between the nearest wrong bars; NaN = not in contact"),
    "estimated_horizontal": (float, "m, last estimate"),
    "estimated_horizontal_stddev": (float, "m, its reported standard deviation"),
    "estimated_vertical": (float, "m, last estimate"),
    "estimated_angle": (float, "rad, last estimate"),
    "estimates": (int, "estimates of the misalignment up to the outcome"),
    **{
        f"{which}_{axis}_{what}": (float, f"{unit}, {about} of the {which} estimate made in contact")
        for which in ("first", "last")
        for axis, unit in zip(estimates.AXES, ("m", "m", "rad"), strict=True)
        for what, about in (("error", "estimate − truth"), ("stddev", "reported standard deviation"))
    },
    "last_across_stddev": (float, "m, reported standard deviation across the bars of the last estimate in contact"),
    "last_clearance": (float, "m, truth at the last estimate made in contact"),
    "error": (str, "of a docking that crashed, else empty"),
}
"""Result columns, with type, unit and meaning."""
_ESTIMATED = tuple(name for name in RESULTS if name.startswith("estimated_"))


def columns(scene: CampaignScene) -> dict[str, tuple[type, str]]:
    """Return every column of a campaign's results: number and seeds, drawn values, results."""
    found: dict[str, tuple[type, str]] = {
        "number": (int, "of the docking, from 0"),
        "seed": (int, "of its noise and jitter"),
        "rig_seed": (int, "of its pads"),
    }
    for axis in parts.AXES:
        found[f"goal_{axis}"] = (float, "pose in the goal, charger_base, m or rad")
        found[f"place_{axis}"] = (float, "true pose of the target, charger_base, m or rad")
    for axis in "xyz":
        found[f"gravity_{axis}"] = (float, "gravity, charger_base, m/s²")
    for name in scene.drawn():
        key = keys.known_keys()[name]
        found[name] = (key.kind, key.description())
    return found | RESULTS | (judge.COLUMNS if scene.hostile else targets.COLUMNS if scene.targets else {})


def dock_once(scene: CampaignScene, seed: int, number: int, exact: bool = False) -> dict[str, Any]:
    """Run docking `number` of a campaign and return its row; the row of a crash has the error.

    Args:
        scene: distributions to draw from.
        seed: of the campaign.
        number: of the docking.
        exact: every tick and every tactile frame as in the nodes, slower.
    """
    row: dict[str, Any] = {"number": number, "seed": 0, "rig_seed": 0} | _nothing()
    row |= {name: _default(name) for name in scene.drawn()} if scene.bases else {}
    trial = None
    try:
        drawn = draw(scene, seed, number)
        row |= _what_was_drawn(drawn)
        trial = Trial(drawn.scene, drawn.seed) if scene.hostile else None
        row |= run(drawn, exact, trial=trial)
    except Exception as error:  # any error; the other dockings continue
        row |= _nothing()
        row |= {"code": -1, "code_name": CRASHED, "message": f"{type(error).__name__}: {error}"}
        row["error"] = "".join(traceback.format_exception(error))[-_TEXT_MOST:]
    if scene.targets:
        row = targets.nothing() | row
    if scene.hostile:
        row = judge.nothing() | row
        row |= trial.judged(row) if trial is not None else {}
    return row


def _default(name: str) -> Any:
    """Return the value of a key that the drawn base scene leaves alone."""
    default = keys.known_keys()[name].default
    return math.nan if default is None else default


def run(drawn: Drawn, exact: bool = False, goal: DockGoal | None = None, trial: Trial | None = None) -> dict[str, Any]:
    """Run one docking to its outcome and return the columns of `RESULTS`; as published, it ends before it charges.

    With a `trial` it is watched longer, and a second goal follows.
    """
    charger = make_charger(drawn, exact, trial)
    log, effort = estimates.EstimateLog(charger, drawn.estimator, drawn.seed), virtual_charger.Effort(charger)
    nudging = Nudging(drawn.nudge, charger.world) if drawn.nudge.moves else None
    above, top = 0.0, drawn.docking.current_max
    limit = LIMIT if drawn.case is None else targets.LIMIT
    try:
        if drawn.published:
            charger.start(published(drawn.goal))
        else:
            held = DockGoal(drawn.goal) if drawn.case is None else drawn.case.goal(drawn.goal)
            charger.begin(goal or held)
    except DockingError as error:
        refused = DockingOutcome(False, error.code, str(error), error.retriable)
        row = result(charger, refused, 0.0) | {"estimates": 0, "servo_push": 0.0}
        return row if drawn.case is None else row | drawn.case.judged(charger, refused)
    while charger.outcome is None:
        before = charger.now
        if before > limit:
            raise TimeoutError(f"no outcome within {limit:g} s; state {charger.machine.status.state.name}")
        charger.tick()
        effort.look()
        if nudging is not None:
            nudging.look()
        if charger.machine.status.contact_current > top and charger.world.misalignment is not None:
            above += charger.now - before
    log.frozen = True
    row = result(charger, charger.outcome, above) | _estimates(log)
    if drawn.case is not None:
        return row | drawn.case.judged(charger, charger.outcome) | {"servo_push": effort.most}
    if charger.machine.status.charging:
        watched = disturbances.SECONDS if trial is None else trial.watched
        if nudging is not None:
            watched = max(watched, drawn.nudge.after + disturbances.watched_after())
        row |= disturbances.Rest(charger, watched, nudging).watch()
    if nudging is not None:
        row["nudge_opened"] = nudging.opened
    if charger.machine.status.charging:
        row |= _undock(charger)
    if trial is not None:
        row |= trial.finish([row["code_name"], row["ended"], row["undocked"]], drawn.goal)
    return row | _record(charger) | {"servo_push": effort.most}


def _undock(charger: virtual_charger.VirtualCharger) -> dict[str, Any]:
    """Undock, and return the columns about it."""
    began, left = charger.now, charger.undock()
    mechanics = charger.world.mechanics
    return {
        "undocked": left.code.name,
        "undock_time": charger.now - began,
        "undock_message": "" if left.success else left.message,
        "still_touching": left.success and mechanics.contact_force > 0.0,
        "target_moved": mechanics.target_shift[2],
    }


def make_charger(drawn: Drawn, exact: bool, trial: Trial | None = None) -> virtual_charger.VirtualCharger:
    """Return the charger of a docking, with the faults of a `trial` if given."""
    pads = parts.make_pads(drawn.pads, drawn.tactile, drawn.second, drawn.rig_seed, drawn.seed)
    felt = pads if trial is None else trial.pads(pads)
    seeds, assumed, flat = (drawn.seed, drawn.rig_seed), drawn.geometry, drawn.pads == parts.FIRST
    charger: virtual_charger.VirtualCharger
    if trial is not None and exact:
        charger = ExactHostile(trial, drawn.world, drawn.docking, *seeds, felt, assumed, drawn.profile)
    elif trial is not None:
        charger = QuickHostile(trial, drawn.world, drawn.docking, felt, *seeds, assumed, flat, drawn.profile)
    elif exact:
        charger = virtual_charger.VirtualCharger(drawn.world, drawn.docking, *seeds, pads, assumed, drawn.profile)
    else:
        charger = quick_charger.QuickCharger(drawn.world, drawn.docking, pads, *seeds, assumed, flat, drawn.profile)
    if drawn.high_row:
        charger.excess = disturbances.high_row(drawn.high_row, drawn.seed)
    return charger


def result(charger: virtual_charger.VirtualCharger, outcome: DockingOutcome, above: float) -> dict[str, Any]:
    """Return columns of `RESULTS` at the `outcome` of a docking; later ones are empty."""
    truth, estimate = charger.world.snapshot(), outcome.estimate
    x, y, angle = truth.misalignment or (math.nan, math.nan, math.nan)
    return _nothing() | {
        "code": int(outcome.code),
        "code_name": outcome.code.name,
        "message": "" if outcome.success else outcome.message,
        "charged": outcome.success,
        "aligned": outcome.aligned,
        "time": outcome.elapsed,
        "moves": outcome.alignments + outcome.redockings,
        "contact_current": outcome.contact_current,
        "reported_push": outcome.contact_force,
        "force_min": outcome.contact_force_min,
        "force_max": outcome.contact_force_max,
        "friction_force": charger.machine.planner.springs.friction_force,
        "true_push": truth.push if outcome.success else math.nan,
        "assumed_stiffness": charger.machine.planner.springs.stiffness,
        "charge_current": outcome.charge_current,
        "time_above_band": above,
        "final_horizontal": x,
        "final_vertical": y,
        "final_angle": angle,
        "final_misalignment": math.hypot(x, y) if outcome.success else math.nan,
        "clearance": truth.clearance,
        **(
            {}
            if estimate is None
            else {name: getattr(estimate, name.removeprefix("estimated_")) for name in _ESTIMATED}
        ),
        **_record(charger),
    }


def _record(charger: virtual_charger.VirtualCharger) -> dict[str, Any]:
    """Return the true values so far."""
    record = charger.world.record
    return {
        "shorts": int(record.energised_shorts),
        "energised": record.energised,
        "energised_unsafe": record.energised_unsafe,
        "parted_live": int(record.parted_live),
        "lifted_live": int(record.lifted_live),
        "bar_heat": record.bar_heat,
        "contacts": record.contacts,
        "peak_force": record.peak_force,
        "peak_push": record.peak_push,
    }


def _estimates(log: estimates.EstimateLog) -> dict[str, Any]:
    """Return the first and the last estimate with the truth."""
    row: dict[str, Any] = {"estimates": log.count}
    for which, kept in (("first", log.first), ("last", log.last)):
        if kept is None:
            continue
        for axis in estimates.AXES:
            row[f"{which}_{axis}_error"], row[f"{which}_{axis}_stddev"] = kept.error[axis], kept.stddev[axis]
    if log.last is not None:
        row["last_clearance"] = log.last.clearance
        row["last_across_stddev"] = log.last.across_stddev
    return row


def _what_was_drawn(drawn: Drawn) -> dict[str, Any]:
    target, goal = drawn.world.target, drawn.goal
    goal_pose = (*goal.position, goal.roll)
    row: dict[str, Any] = {"seed": drawn.seed, "rig_seed": drawn.rig_seed, **drawn.values}
    for axis, value in zip(parts.AXES, goal_pose, strict=True):
        row[f"goal_{axis}"] = value
        row[f"place_{axis}"] = getattr(target, axis)
    for axis in "xyz":
        row[f"gravity_{axis}"] = getattr(drawn.world, f"gravity_{axis}")
    return row


def _nothing() -> dict[str, Any]:
    """Return the columns of a docking without results."""
    nothing: dict[type, Any] = {int: 0, float: math.nan, bool: False, str: ""}
    return {name: nothing[kind] for name, (kind, _) in RESULTS.items()} | {"code": int(Code.INTERNAL)}
