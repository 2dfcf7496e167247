# SPDX-License-Identifier: Apache-2.0
"""Algorithm 1 of the paper as printed, from step 2 on: `approach: published`.

    go to the coordinates; current > 0.5 A: back 30 mm; while current < 0.4 A: on by 5 mm; measure the angle;
    below the critical one: while an offset is not zero, 15 times at most: detect it, move by it; start charging;
    else go back, charging has failed. All-zero tactile frames end it.

No filter, no contradiction between looks, no clearance, no arm put at ease, no contact made anew. What is felt are
the classes of the paper's CNN: whole degrees of |angle| up to 5°, so that only a goal whose `critical_angle` is
5° or less is ever refused for its angle, and offsets of 0, ±5 and ±10 mm.

Where the print is silent, the least that works: the current is `current_signal`, tared at the standoff before the
place; as magnets hold the electrodes, they are lifted by `lift` before they move sideways and pressed again by the
same 5 mm; the angle is measured once, before the first move, and each look at the offsets is one estimate of
`estimate_frames` frames; where it is not told, on which side the search ends, it ends `search_depth` beyond the place.
Reach, each phase's bounds, probe and lease are the charger's, not the algorithm's: they stay.

With `published_clearance_rule` the same, and before current may flow our rule besides: clearance by the continuous
estimate, which another contact in this place must confirm where it is not sure. Nothing else of ours.
"""

from __future__ import annotations

import math
from dataclasses import fields

from deltacharger_core.script import Script
from deltacharger_docking.clearance import FeltPose, MisalignmentClasses, Verdict
from deltacharger_docking.codes import CriticalAngle, EstimateUnsure, Misaligned
from deltacharger_docking.context import Context
from deltacharger_docking.press import approach, contact, first_push, press_again
from deltacharger_docking.touch import Target, measure, tell_verdict, too_tilted
from deltacharger_kinematics.geometry import Vector


def dock(context: Context, target: Target, place: Vector) -> Script[None]:
    """Go to the electrodes' `place` (m, charger_base), press, and move by classes until they are zero.

    Args:
        context: of the docking; its torque is on and its pads are tared.
        target: its critical angle counts; nothing is remembered of what was felt.
        place: as received.

    Raises:
        CriticalAngle: the class of the angle is not below the critical one; or clearance is asked for and the angle
            leaves none.
        Misaligned: clearance is asked for and the offset leaves none.
        EstimateUnsure: no classes were told; or clearance is asked for and not known.
    """
    yield from approach(context, place)
    yield from first_push(context, place)
    target.depth = place[2] + context.parameters.search_depth
    yield from contact(context, target.depth)
    yield from align(context, target)


def align(context: Context, target: Target) -> Script[None]:
    """Move by classes until they are zero or the moves are used up; errors as of `dock`."""
    parameters, status = context.parameters, context.status
    status.aligned = False
    felt = yield from measure(context)
    classes = _told(context, felt)
    if not classes.angle < target.critical_angle:
        raise CriticalAngle(too_tilted(classes.angle))
    while not _is_zero(classes) and status.alignments < parameters.alignments_max:
        x, y = classes.horizontal, classes.vertical
        status.alignments += 1
        context.decide("move", "the electrodes are moved by the classes' centres", x_m=x, y_m=y)
        yield from press_again(context, target.depth, x, y)
        felt = yield from measure(context)
        classes = _told(context, felt)
    status.aligned = _is_zero(classes)
    x, y = classes.horizontal, classes.vertical
    if status.aligned:
        context.decide("aligned", "both offsets are of class zero", x_m=x, y_m=y)
    else:
        context.decide("exhausted", "the moves are used up", x_m=x, y_m=y, moves=status.alignments)
        if not parameters.charge_when_not_aligned:
            raise Misaligned(f"after {status.alignments} moves the offsets are not of class zero")
    if parameters.keeps_clearance:
        yield from _see_clearance(context, target, felt)
    status.docked = True


def _see_clearance(context: Context, target: Target, felt: FeltPose) -> Script[None]:
    """Judge clearance as `guarded` does; what one contact leaves unsure, another one in this place must confirm."""
    contacts = 1
    while (verdict := _verdict(context, target, felt)) is Verdict.PROBABLY_SAFE:
        if contacts >= context.parameters.clearance_contacts:
            return
        contacts += 1
        context.status.redockings += 1
        context.decide("again", "clearance is not sure yet: the contact is made anew", x_m=0.0, y_m=0.0)
        yield from press_again(context, target.depth, 0.0, 0.0)
        felt = yield from measure(context)
    if verdict is Verdict.CRITICAL:
        raise CriticalAngle(too_tilted(felt.angle))
    if not verdict.leaves_clearance:
        raise Misaligned(
            f"no clearance is sure where the classes have led: {math.degrees(felt.angle):.1f}°, "
            f"{1000 * felt.vertical:.1f} mm vertical"
        )


def _verdict(context: Context, target: Target, felt: FeltPose) -> Verdict:
    if not felt.usable:
        if math.isfinite(felt.angle) and abs(felt.angle) >= target.critical_angle:
            raise CriticalAngle(too_tilted(felt.angle))
        raise EstimateUnsure("the tactile estimate is unsure, so clearance is not known; check pads and target")
    return tell_verdict(context, felt, target.critical_angle)


def _told(context: Context, felt: FeltPose) -> MisalignmentClasses:
    """Return the classes of what was felt.

    Raises:
        EstimateUnsure: some were not told.
    """
    classes = felt.classes
    if classes is None:
        missing = [item.name for item in fields(MisalignmentClasses)]
    else:
        missing = [item.name for item in fields(classes) if not math.isfinite(getattr(classes, item.name))]
    if classes is None or missing:
        raise EstimateUnsure(
            f"no class was told of {', '.join(missing)}: {' and '.join(f'{each}_probability' for each in missing)} of "
            f"the model '{context.parameters.classes_of}' are missing or NaN; look at misalignment_node"
        )
    context.decide(
        "classes",
        "the most probable classes of what was measured",
        angle_rad=classes.angle,
        vertical_m=classes.vertical,
        horizontal_m=classes.horizontal,
    )
    return classes


def _is_zero(classes: MisalignmentClasses) -> bool:
    return classes.horizontal == 0.0 and classes.vertical == 0.0
