# SPDX-License-Identifier: Apache-2.0
"""Decisions by touch: whether the electrodes may rest where they are, else where to move them."""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_core import machine, script
from deltacharger_docking import clearance, codes, goals, observation, release
from deltacharger_docking.context import SERVICE_TIMEOUT, Context
from deltacharger_docking.place import TargetPlace

_CLEARANCE_CONTACTS = 2  # successive contacts that must pass if one is not enough; chosen as CLEARANCE_SIGMAS
_ALIGNMENT_TOLERANCE = 0.001  # m, offset from which a move counts as a correction; chosen on seeds 5 and 19
ALIGNMENTS_MAX = 15  # most corrections and repeated contacts, as in the paper
# Largest estimated risk of exceeding overlap_loss_max or landing_limit when aligned. Chosen on seed 5 of lean2, lean5
# and rigid.
_ALIGNED_RISK_MAX = 0.02
_UNSURE_MAX = 4  # unsure estimates after which alignment ends; the seeds were not kept
_UNSURE_HERE_MAX = 2  # unsure estimates in one place after which alignment ends
_UNSURE_MOVE_MIN = 0.002  # m, offset from which an unsure estimate is followed
ESTIMATE_FRAMES = 24  # tactile frames averaged in one estimate
MEASURE_TIMEOUT = 10.0  # s, limit for MEASURE
_DRAWS = 1e-3  # m, times force/width²: lateral stiffness of magnets while the platform lands; chosen on seed 43
_POWER = 0.1  # s, two periods of charger_power


def measure(context: Context) -> script.Script[clearance.MisalignmentEstimate]:
    """Return the misalignment that the pads measure, sure or not.

    Raises:
        NoTactileContact: they measure no contact.
        TactileStale: no estimate arrived.
    """
    context.enter(codes.State.MEASURE, MEASURE_TIMEOUT)
    context.doubt, context.doubtful = "", context.observation.duplicate_sources
    context.evidence.forget()
    context.evidence.begin_contact()
    reply = yield from context.ask(observation.Service.ESTIMATE, codes.TactileStale, SERVICE_TIMEOUT, ESTIMATE_FRAMES)
    estimate = reply.estimate
    if not reply.success or estimate is None:
        raise codes.TactileStale(f"no misalignment estimate: {reply.message}")
    context.status.estimate = estimate = with_pitch(context, estimate)
    text = "sure" if estimate.sure and estimate.in_range else "unsure" if estimate.in_range else "out of range"
    context.decide("measured", text, **estimate.numbers)
    keep_evidence(context, estimate)
    if not estimate.contact:
        raise codes.NoTactileContact("the pads lost contact before the misalignment was measured")
    return estimate


def keep_evidence(context: Context, estimate: clearance.MisalignmentEstimate) -> None:
    """Let this estimate of the contact count until its evidence is lost."""
    sigmas = clearance.CLEARANCE_SIGMAS
    margin = clearance.least_clearance(estimate, context.parameters, sigmas) if estimate.usable else 0.0
    context.evidence.keep(context.position, margin)


def with_pitch(context: Context, estimate: clearance.MisalignmentEstimate) -> clearance.MisalignmentEstimate:
    """Return the estimate with the pitch that was detected before contact, which pads cannot measure."""
    seen = context.electrodes
    return estimate if seen is None else replace(estimate, pitch=seen.pitch, pitch_stddev=seen.pitch_stddev)


def record_verdict(
    context: Context, estimate: clearance.MisalignmentEstimate, critical_angle: float
) -> clearance.Verdict:
    """Judge clearance by a usable estimate, and record the verdict with its numbers."""
    parameters = context.parameters
    verdict = clearance.judge(estimate, parameters, critical_angle)
    least = [
        clearance.least_clearance(estimate, parameters, sigmas) - parameters.clearance_min
        for sigmas in (0.0, clearance.CLEARANCE_SIGMAS, clearance.CLEARANCE_SIGMAS_SURE)
    ]
    context.decide(
        "verdict",
        verdict.value,
        clearance_m=least[0] + parameters.clearance_min,
        margin_3_sigma_m=least[1],
        margin_6_sigma_m=least[2],
    )
    return verdict


def look(context: Context, target: Target) -> script.Script[clearance.MisalignmentEstimate | None]:
    """Measure at the first touch; return the estimate if it forbids pressing further, else None.

    Where the target makes the port live, its voltage shows that no bar bridges it, and only a touch without it is
    measured. To measure at each touch would take 0.4 s more in median (150 dockings of `default`). Electrodes
    wired to the battery (power: none) are live whenever they touch.

    It does not wait until the arm rests, since shorted electrodes must not stay in contact. If so light a touch gives
    no usable estimate, pressing continues and is judged later, unless even the unsure one exceeds the critical angle.

    Raises:
        CriticalAngle: the target is rolled too far.
        TactileStale: no estimate arrived.
    """
    parameters = context.parameters
    end = context.time + (0.0 if parameters.always_live else _POWER)
    while context.time < end and not context.port_shown:
        yield script.NEXT
    if not parameters.always_live and context.port_shown and not context.is_dark:
        return None
    context.contact.clear()
    reply = yield from context.ask(observation.Service.ESTIMATE, codes.TactileStale, SERVICE_TIMEOUT, ESTIMATE_FRAMES)
    if not reply.success or reply.estimate is None:
        raise codes.TactileStale(f"no misalignment estimate at the first touch: {reply.message}")
    context.status.estimate = estimate = with_pitch(context, reply.estimate)
    text = "the first touch gives an estimate" if estimate.usable else "the touch is too light for an estimate"
    context.decide("touched", text, contact_current_A=context.contact.value, **estimate.numbers)
    if not estimate.usable:
        known = estimate.contact and math.isfinite(estimate.angle)
        return (
            estimate if known and clearance.reaches_limit(estimate.angle, parameters, target.critical_angle) else None
        )
    verdict = record_verdict(context, estimate, target.critical_angle)
    if verdict is clearance.Verdict.CRITICAL:
        raise codes.CriticalAngle(rolled_too_far(estimate.angle))
    return estimate if verdict is clearance.Verdict.TOO_CLOSE else None


class Target:
    """One target as known by touch, from its first contact until the electrodes leave it.

    Attributes:
        critical_angle: limit of the goal, rad.
        depth: largest z (m, charger_base) at which contact is searched.
        place: where it is, by all contacts on it.
    """

    def __init__(self, context: Context, critical_angle: float) -> None:
        self._context = context
        self.critical_angle = critical_angle
        self.depth = math.inf
        self.place = TargetPlace(context.parameters, context.share)
        self._estimated_here = False  # this contact has been used
        self.begin_goal()

    def begin_goal(self) -> None:
        """Reset what earlier goals counted; the target's place stays known."""
        self._angles: list[float] = []
        self._passed = 0  # contacts in a row that leave clearance
        self._unsure = self._unsure_here = 0
        self._estimate: clearance.MisalignmentEstimate | None = None  # in this contact

    def allows_rest(self, estimate: clearance.MisalignmentEstimate, stay: bool) -> bool:
        """Use the estimate of this contact; return whether the electrodes may rest here and current may flow.

        Args:
            estimate: the estimate, sure or not.
            stay: the electrodes have been aligned before and may rest where they are, if they have clearance there.

        Raises:
            CriticalAngle: the target is rolled too far.
            EstimateUnsure: the estimates contradict the arm's own moves.
        """
        context, parameters = self._context, self._context.parameters
        self._estimate, context.status.aligned = estimate, False
        if not estimate.usable:
            self._passed = 0
            return False
        self._unsure_here = 0
        x, y, _ = context.position
        push = sum(context.springs.true_force(context.contact.force)) / 2.0  # gears take a share of what currents tell
        self.place.add(estimate, x, y, push, context.drawn, self._draw_share, self._estimated_here)
        self._estimated_here = True
        context.status.estimate = self.place.combined(estimate)
        if self.place.contradicts_itself and not stay:
            context.decide("contradiction", "the estimates contradict the arm's own moves", x_m=estimate.horizontal)
            cure = "check whether frames repeat, the target moves, or magnet_force is wrong"
            raise codes.EstimateUnsure(f"the pads' estimates contradict the arm's own moves; {cure}")
        verdict = self._judge(estimate)
        safe = verdict is clearance.Verdict.SAFE or (
            verdict is clearance.Verdict.PROBABLY_SAFE and self._passed >= _CLEARANCE_CONTACTS
        )
        self.place.choose(self._moves, self._reaches)
        context.status.aligned = safe and not self._pays and self.place.risk <= _ALIGNED_RISK_MAX
        settled = stay or not self._pays or self._exhausted
        if stay and not safe:  # the target has moved, so earlier contacts no longer count
            self.place = TargetPlace(parameters, context.share)
            self.place.add(estimate, x, y, push)
            self.place.choose(self._moves, self._reaches)
        return settled and safe

    def still_allows_rest(self, estimate: clearance.MisalignmentEstimate) -> bool:
        """Use the estimate made with the arm at ease; return whether clearance remains."""
        if (
            estimate.usable
            and clearance.judge(estimate, self._context.parameters, self.critical_angle).leaves_clearance
        ):
            self._context.status.estimate = self.place.settle(estimate)
            return True
        self._passed, self._context.status.aligned = 0, False
        return False

    def rest(self) -> None:
        """Record that the electrodes rest here."""
        self.place.learn()
        aligned, (x, y) = self._context.status.aligned, self.place.off
        text = "no gain is expected from another contact" if aligned else "the electrodes have clearance here"
        self._context.decide("aligned" if aligned else "exhausted", text, x_m=x, y_m=y)

    def correction(self) -> tuple[float, float]:
        """Return the move (m) before the next contact, and count it.

        Raises:
            Misaligned: clearance was not reached within the allowed alignments.
            Leaning: one pad carries nearly all the force, again in this place.
            EstimateUnsure: the estimate stayed unsure.
            CriticalAngle: it stayed unsure but shows a roll beyond the limit.
        """
        context, self._estimated_here = self._context, False
        if self._estimate is not None and not self._estimate.usable:
            return self._look_elsewhere(self._estimate)
        aside = self.place.plan.aside if self._pays else 0.0
        (x, y), risk = self.place.step(aside), self.place.risk
        if self._exhausted:
            context.decide("exhausted", "no correction is left", x_m=x, y_m=y, moves=self._moves)
            raise codes.Misaligned(
                f"after {self._moves} moves there is no sure clearance; the electrodes are {1000 * x:.1f} mm "
                f"horizontally and {1000 * y:.1f} mm vertically off"
            )
        if max(abs(x), abs(y)) > _ALIGNMENT_TOLERANCE:
            context.status.alignments += 1
            text = "to the estimated target" if not aside else "beside the target: the magnets' force shows its place"
            context.decide("move", f"the electrodes move {text}", x_m=x, y_m=y, risk=risk)
        else:
            context.status.redockings += 1
            text = "this contact is too far from the target" if self._pays else "clearance is not sure yet"
            context.decide("again", f"{text}: the contact is repeated", risk=risk, x_m=x, y_m=y)
        return x, y

    @property
    def _draw_share(self) -> float:
        """Share of its way from the command to the target that the magnets draw the platform while it lands."""
        context, p = self._context, self._context.parameters
        a, b, c = context.kinematics.jacobian(*context.position)[:3]
        arm = context.springs.stiffness / (a * a + b * b + c * c)
        magnets = _DRAWS * p.magnet_force / machine.MAGNET_WIDTH**2
        return magnets / (magnets + arm)

    @property
    def _pays(self) -> bool:
        return self.place.plan.gain > 0.0

    def _reaches(self, x: float, y: float) -> bool:
        """Return whether the platform reaches a contact at this offset (m), and the place before it."""
        here = self._context.position
        place = here[0] + x, here[1] + y, here[2]
        return not self._context.planner.reach_problem(place, (*place[:2], place[2] - release.LIFT))

    @property
    def _moves(self) -> int:
        return self._context.status.alignments + self._context.status.redockings

    @property
    def _exhausted(self) -> bool:
        return self._moves >= ALIGNMENTS_MAX

    def _judge(self, estimate: clearance.MisalignmentEstimate) -> clearance.Verdict:
        """Judge this contact; after two contacts, also the mean angle."""
        parameters = self._context.parameters
        self._angles.append(estimate.angle)
        verdict = record_verdict(self._context, estimate, self.critical_angle)
        self._passed = self._passed + 1 if verdict.leaves_clearance else 0
        mean = sum(self._angles) / len(self._angles)
        centred = replace(estimate, angle=mean, across=0.0)
        if (
            len(self._angles) >= _CLEARANCE_CONTACTS
            and clearance.judge(centred, parameters, self.critical_angle) is clearance.Verdict.CRITICAL
        ):
            raise codes.CriticalAngle(rolled_too_far(mean))
        return verdict

    def _look_elsewhere(self, estimate: clearance.MisalignmentEstimate) -> tuple[float, float]:
        """Return the move (m) before the next measurement: to where an unsure estimate points, or none.

        A pad that has lost its ridge across the bars still shows the direction. An unsure estimate only moves the arm;
        energising needs a sure one. If one pad carries nearly all the force, the cause is a lean: no move.
        """
        context = self._context
        self._unsure_here += 1
        self._unsure += 1
        place = context.position
        yaw = self.place.least_yaw(estimate, place[0], context.contact.force)
        if math.isfinite(yaw):
            if self._unsure_here >= _UNSURE_HERE_MAX:
                raise self._leaning(estimate, yaw)
            context.status.redockings += 1
            context.decide("again", "one pad carries nearly all the force: the contact is repeated", yaw_rad=yaw)
            return 0.0, 0.0
        x, y = self.place.pointed_at(estimate, place[0])
        lost = estimate.complete and math.hypot(x, y) > _UNSURE_MOVE_MIN
        reachable = lost and not context.planner.reach_problem((place[0] + x, place[1] + y, place[2]))
        if reachable and self._unsure < _UNSURE_MAX:
            self._unsure_here = 0
            context.status.alignments += 1
            context.decide("elsewhere", "a pad has lost its ridge: the arm searches for it", x_m=x, y_m=y)
            return x, y
        if self._unsure_here >= _UNSURE_HERE_MAX or self._unsure >= _UNSURE_MAX:
            self._give_up(estimate)
        context.status.redockings += 1
        context.decide("again", "the estimate is unsure: the contact is repeated", times=self._unsure)
        return 0.0, 0.0

    def _leaning(self, estimate: clearance.MisalignmentEstimate, yaw: float) -> codes.Leaning:
        """Return the error of faces that are yawed by at least this (rad), or by the detected yaw if larger."""
        electrodes = self._context.electrodes
        seen = electrodes.sure_yaw(clearance.LEAN_SIGMAS) if electrodes is not None else 0.0
        yaw = seen if seen * yaw > yaw * yaw else yaw
        x, y, z = self._context.position
        left, right = estimate.left_force, estimate.right_force
        return codes.Leaning(
            f"one pad carries nearly all the force ({left:.0f} N left, {right:.0f} N right): the target's faces are "
            f"yawed by {math.degrees(yaw):+.1f}° or more about y of charger_base, or it is far from its given place; "
            f"move the robot to suggested_base_pose, which is to {goals.in_words(yaw)}",
            (x, y, z),
            yaw,
        )

    def _give_up(self, estimate: clearance.MisalignmentEstimate) -> None:
        parameters, angle = self._context.parameters, estimate.angle
        if math.isfinite(angle) and clearance.reaches_limit(angle, parameters, self.critical_angle):
            raise codes.CriticalAngle(rolled_too_far(estimate.angle))
        what = "outside the estimator's range" if not estimate.in_range else "unsure"
        raise codes.EstimateUnsure(
            f"the tactile estimate stayed {what} in {self._unsure} contacts; check pads and target"
        )


def rolled_too_far(angle: float) -> str:
    """Return the message that an angle (rad) is too large."""
    return (
        f"the target is rolled by {math.degrees(angle):.1f}°: the electrodes would come too close to a short; "
        "level the target or the charger"
    )
