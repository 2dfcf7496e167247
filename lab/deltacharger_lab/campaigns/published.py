# SPDX-License-Identifier: Apache-2.0
"""The paper's Algorithm 1 as printed, for comparison; docking itself never runs it.

    go to the coordinates; current > 0.5 A: back 30 mm; while current < 0.4 A: on by 5 mm; measure the angle;
    below the critical one: while an offset is not zero, 15 times at most: detect it, move by it; start charging;
    else go back, charging has failed. All-zero tactile frames end it.

It has no filter, no check for contradictions or clearance, no easing, and no repeated contacts. The estimates must be
classes (`PaperClasses`). Their angles are whole degrees of |angle| up to 5°, so a critical angle above 5° refuses
nothing. Their offsets are 0, ±5 and ±10 mm.

Where the paper gives no detail, this uses docking's own: the tare at the standoff, the lift before a move sideways, the
depth of the search, 24 frames for an estimate, probe and lease, and the limits of reach and phases.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from deltacharger_core.machine import CONTACT_FORCE
from deltacharger_core.script import Script
from deltacharger_docking import algorithm, clearance, codes, energy, observation, press, release, standoff, touch
from deltacharger_docking.context import Context
from deltacharger_lab.training.labels import centres
from deltacharger_tactile.classifiers import classifier


class PaperClasses:
    """Estimates integer degrees 0–5 and steps of 5 mm, with no uncertainty."""

    def __init__(self) -> None:
        self._networks = classifier.load("cnn")

    def predict(self, left: Any, right: Any) -> clearance.MisalignmentEstimate:
        """Return the centres of the most probable classes; pads (10, 10) N below 1 N have no contact."""
        frame = np.stack((left, right))
        found = {target: float(centres(target)[net.predict(frame[None])[0]]) for target, net in self._networks.items()}
        return clearance.MisalignmentEstimate(
            angle=found["angle"],
            angle_stddev=0.0,
            vertical=found["vertical"],
            vertical_stddev=0.0,
            horizontal=found["horizontal"],
            horizontal_stddev=0.0,
            contact=bool(np.nanmax(frame) >= CONTACT_FORCE),
        )


_BACK, _STEP = 0.030, 0.005  # m: the paper's step back from too hard a push, and its step on


def published(
    electrodes: observation.ElectrodePose, critical_angle: float = math.inf
) -> Callable[[Context], Script[str]]:
    """Return the paper's docking, for `DockingMachine.start`; it succeeds once charge current has been stable.

    Args:
        electrodes: pose of the target's electrodes, charger_base.
        critical_angle: of the classes, rad; the default is the parameter.

    Returns:
        A script that raises CriticalAngle for an angle that is not below the critical one, and what docking's steps
        raise. It opens the contactor at its end.
    """

    def script(context: Context) -> Script[str]:
        x, y, z = electrodes.position
        depth, limit = z + context.parameters.search_depth, min(critical_angle, context.parameters.critical_angle)
        yield from algorithm.prepare(context)
        yield from standoff.approach(context, (x, y, z))
        yield from press.step_to(context, z)
        if context.contact.value > context.parameters.current_max:
            yield from _back_off(context)
        yield from _press(context, depth)
        yield from _align(context, depth, limit)
        yield from energy.energise(context)
        yield from energy.de_energise(context)
        return "charged"

    return script


def _back_off(context: Context) -> Script[None]:
    x, y, z = context.position
    context.check_way((x, y, z - _BACK))
    if context.observation.tactile_contact:
        yield from release.take_off(context, z - _BACK)
        yield from context.rest()
    else:
        yield from context.move((x, y, z - _BACK), context.parameters.travel_speed)


def _press(context: Context, depth: float) -> Script[None]:
    context.enter(codes.State.CONTACT, press.CONTACT_TIMEOUT)
    while context.contact.value < context.parameters.current_min:
        press.check_depth(context, depth)
        yield from press.step_to(context, context.commanded[2] + _STEP)
    press.check_pads(context)


def _align(context: Context, depth: float, limit: float) -> Script[None]:
    """Move by classes until both offsets are of class zero, or all moves are used."""
    status = context.status
    found = yield from touch.measure(context)
    if not abs(found.angle) < limit:
        raise codes.CriticalAngle(touch.rolled_too_far(found.angle))
    while (found.horizontal or found.vertical) and status.alignments < touch.ALIGNMENTS_MAX:
        x, y = found.horizontal, found.vertical
        status.alignments += 1
        context.decide("move", "the electrodes move by the centres of the classes", x_m=x, y_m=y)
        yield from press.move_aside(context, x, y)
        yield from _press(context, depth)
        found = yield from touch.measure(context)
    status.aligned = not (found.horizontal or found.vertical)
    status.docked = True
