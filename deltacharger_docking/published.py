# SPDX-License-Identifier: Apache-2.0
"""The paper's Algorithm 1 as published, from step 2 on: `approach: published`.

    go to the coordinates; current > 0.5 A: back 30 mm; while current < 0.4 A: on by 5 mm; measure the angle;
    below the critical one: while an offset is not zero, 15 times at most: detect it, move by it; start charging;
    else go back, charging has failed. All-zero tactile frames end it.

It has no filter, no check for contradictions or clearance, no easing, and no repeated contacts. It uses the classes of
the paper's CNN. Their angles are whole degrees of |angle| up to 5°, so only a goal with a `critical_angle` of 5° or
less can be refused for its angle. Their offsets are 0, ±5 and ±10 mm.

Where the paper gives no detail, this uses the simplest solution that works. The current is `current_signal`, tared at
the standoff. Since magnets hold the electrodes, they lift by `lift` before they move sideways, then press again in
steps of 5 mm. The angle is measured once, before the first move; each offset is one estimate of `estimate_frames`
frames. The search ends `search_depth` beyond the place. Limits of reach and phases, probe and lease remain active.

`published_clearance_rule` adds only our rule before current flows: clearance by the continuous estimate. If it is not
sure, another contact in this place must confirm it.
"""

from __future__ import annotations

import math
from dataclasses import fields

from deltacharger_core.script import Script
from deltacharger_docking.clearance import MisalignmentClasses, MisalignmentEstimate, Verdict
from deltacharger_docking.codes import CriticalAngle, EstimateUnsure, Misaligned
from deltacharger_docking.context import Context
from deltacharger_docking.press import contact, first_push, press_again
from deltacharger_docking.standoff import approach
from deltacharger_docking.touch import Target, measure, record_verdict, rolled_too_far
from deltacharger_kinematics.geometry import Vector


def dock(context: Context, target: Target, place: Vector) -> Script[None]:
    """Go to the electrodes' `place` (m, charger_base), press, and move by classes until they are zero.

    Args:
        context: of the docking; its torque is on and its pads are tared.
        target: for its critical angle; estimates are not stored in it.
        place: as received.

    Raises:
        CriticalAngle: the class of the angle is not below the critical one; or the angle leaves less than the required
            clearance.
        Misaligned: the offset leaves less than the required clearance.
        EstimateUnsure: classes are missing, or required clearance is unknown.
    """
    yield from approach(context, place)
    yield from first_push(context, place)
    target.depth = place[2] + context.parameters.search_depth
    yield from contact(context, target.depth)
    yield from align(context, target)


def align(context: Context, target: Target) -> Script[None]:
    """Move by classes until they are zero or all moves are used; errors as for `dock`."""
    parameters, status = context.parameters, context.status
    status.aligned = False
    estimate = yield from measure(context)
    classes = _classes_of(context, estimate)
    if not classes.angle < target.critical_angle:
        raise CriticalAngle(rolled_too_far(classes.angle))
    while not _is_zero(classes) and status.alignments < parameters.alignments_max:
        x, y = classes.horizontal, classes.vertical
        status.alignments += 1
        context.decide("move", "the electrodes move by the centres of the classes", x_m=x, y_m=y)
        yield from press_again(context, target.depth, x, y)
        estimate = yield from measure(context)
        classes = _classes_of(context, estimate)
    status.aligned = _is_zero(classes)
    x, y = classes.horizontal, classes.vertical
    if status.aligned:
        context.decide("aligned", "both offsets are of class zero", x_m=x, y_m=y)
    else:
        context.decide("exhausted", "all moves are used", x_m=x, y_m=y, moves=status.alignments)
        if not parameters.charge_when_not_aligned:
            raise Misaligned(f"after {status.alignments} moves the offsets are not of class zero")
    if parameters.keeps_clearance:
        yield from _see_clearance(context, target, estimate)
    status.docked = True


def _see_clearance(context: Context, target: Target, estimate: MisalignmentEstimate) -> Script[None]:
    """Judge clearance like `guarded`; if one contact leaves it unsure, another one in this place must confirm it."""
    contacts = 1
    while (verdict := _verdict(context, target, estimate)) is Verdict.PROBABLY_SAFE:
        if contacts >= context.parameters.clearance_contacts:
            return
        contacts += 1
        context.status.redockings += 1
        context.decide("again", "clearance is not sure yet: the contact is repeated", x_m=0.0, y_m=0.0)
        yield from press_again(context, target.depth, 0.0, 0.0)
        estimate = yield from measure(context)
    if verdict is Verdict.CRITICAL:
        raise CriticalAngle(rolled_too_far(estimate.angle))
    if not verdict.leaves_clearance:
        raise Misaligned(
            f"there is no sure clearance after the moves by classes: {math.degrees(estimate.angle):.1f}°, "
            f"{1000 * estimate.vertical:.1f} mm vertical"
        )


def _verdict(context: Context, target: Target, estimate: MisalignmentEstimate) -> Verdict:
    if not estimate.usable:
        if math.isfinite(estimate.angle) and abs(estimate.angle) >= target.critical_angle:
            raise CriticalAngle(rolled_too_far(estimate.angle))
        raise EstimateUnsure("the tactile estimate is unsure, so clearance is unknown; check pads and target")
    return record_verdict(context, estimate, target.critical_angle)


def _classes_of(context: Context, estimate: MisalignmentEstimate) -> MisalignmentClasses:
    """Return the classes of the estimate.

    Raises:
        EstimateUnsure: some are missing.
    """
    classes = estimate.classes
    if classes is None:
        missing = [item.name for item in fields(MisalignmentClasses)]
    else:
        missing = [item.name for item in fields(classes) if not math.isfinite(getattr(classes, item.name))]
    if classes is None or missing:
        raise EstimateUnsure(
            f"no class for {', '.join(missing)}: {' and '.join(f'{each}_probability' for each in missing)} of "
            f"the model '{context.parameters.class_model}' are missing or NaN; check misalignment_node"
        )
    context.decide(
        "classes",
        "the most probable classes of the estimate",
        angle_rad=classes.angle,
        vertical_m=classes.vertical,
        horizontal_m=classes.horizontal,
    )
    return classes


def _is_zero(classes: MisalignmentClasses) -> bool:
    return classes.horizontal == 0.0 and classes.vertical == 0.0
