# SPDX-License-Identifier: Apache-2.0
"""Steps 5 and 6 of Algorithm 1: measure the misalignment, judge it, move, and press again."""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_docking.clearance import FeltPose, Verdict, clearance, clearance_stddev, judge
from deltacharger_docking.codes import CriticalAngle, EstimateUnsure, Misaligned, NoTactileContact, State, TactileStale
from deltacharger_docking.context import Context
from deltacharger_docking.ease import ease
from deltacharger_docking.observation import Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.press import contact
from deltacharger_docking.release import take_off
from deltacharger_docking.script import Script


class AlignmentFilter:
    """Kalman filter of a fixed target position (x, y in charger_base) seen by touch.

    One docking lands beside its commanded place by `docking_jitter` (a standard deviation, m), and an estimate's error
    grows with its size by `gain_error`, added in quadrature, so a first look from 8 mm away weighs little once the
    platform stands close.
    """

    def __init__(self, parameters: DockingParameters) -> None:
        self._parameters = parameters
        self._mean = [0.0, 0.0]
        self._information = [0.0, 0.0]
        self._innovations = [0.0, 0.0]
        self._looks = 0
        self.landing = math.inf
        """How far (m) the last contact may lie off on its worse axis: |mean| + landing_sigmas σ, at least
        landing_felt_sigmas σ felt: a landing far out is rare, and rarer where the pads see well."""

    def update(self, platform: tuple[float, float], estimate: FeltPose) -> None:
        """Take one estimate made with the platform at (x, y) m of charger_base."""
        readings = (
            (platform[0] + estimate.horizontal, estimate.horizontal, estimate.horizontal_stddev),
            (platform[1] + estimate.vertical, estimate.vertical, estimate.vertical_stddev),
        )
        parameters = self._parameters
        self.landing = 0.0
        self._looks += 1
        for axis, (place, offset, stddev) in enumerate(readings):
            felt = stddev**2 + (parameters.gain_error * offset) ** 2
            variance = parameters.docking_jitter**2 + felt
            land = self._land(axis, place - offset, offset, max(felt, 1e-12))
            self.landing = max(self.landing, land, parameters.landing_felt_sigmas * stddev)
            weight = 1.0 / max(variance, 1e-12)
            if self._information[axis] > 0.0:
                expected = variance + 1.0 / self._information[axis]
                self._innovations[axis] += (place - self._mean[axis]) ** 2 / max(expected, 1e-12)
            self._information[axis] += weight
            self._mean[axis] += (place - self._mean[axis]) * weight / self._information[axis]

    @property
    def contradicts_itself(self) -> bool:
        """Whether the looks differ by more than their errors allow: the pads do not feel where the arm has gone."""
        start, each = self._parameters.contradiction_start, self._parameters.contradiction_each
        return max(self._innovations) > start + each * self._looks

    def _land(self, axis: int, platform: float, offset: float, variance: float) -> float:
        """Return |mean| + landing_sigmas σ (m) of this contact, from what is felt and where earlier ones saw it."""
        information = self._information[axis]
        mean, weight = offset, 1.0 / variance
        if information > 0.0:
            known = 1.0 / (self._parameters.docking_jitter**2 + 1.0 / information + 1e-12)
            mean = (weight * offset + known * (self._mean[axis] - platform)) / (weight + known)
            weight += known
        return abs(mean) + self._parameters.landing_sigmas / math.sqrt(weight)

    @property
    def target(self) -> tuple[float, float]:
        """Filtered (x, y) m of the target in charger_base; NaN before the first estimate."""
        if self._information[0] == 0.0:
            return math.nan, math.nan
        return self._mean[0], self._mean[1]

    def misalignment(self, platform: tuple[float, float]) -> tuple[float, float]:
        """Return the filtered (horizontal, vertical) m for the platform at (x, y) m."""
        x, y = self.target
        return x - platform[0], y - platform[1]


class Alignment:
    """The loop of measuring and moving. One instance serves one target, from its first contact until it is left.

    Attributes:
        critical_angle: limit of the goal, rad.
        aligned: whether the filtered misalignment lies within the tolerance.
    """

    def __init__(self, context: Context, critical_angle: float, depth: float) -> None:
        self._context = context
        self.critical_angle = critical_angle
        self._depth = depth
        self._filter = AlignmentFilter(context.parameters)
        self._angles: list[float] = []
        self._unsure = self._unsure_here = 0
        self._passed = 0
        self.aligned = False

    def run(self, stay: bool = False) -> Script[None]:
        """Align until the estimate allows current to flow, with the arm at ease.

        Args:
            stay: the electrodes have been aligned before and may rest where they are, if they have clearance there.

        Raises:
            CriticalAngle: the target is tilted too far.
            Misaligned: clearance was not reached within the allowed alignments.
            EstimateUnsure: the estimate stayed unsure.
            NoTactileContact: the pads feel nothing.
        """
        context, parameters = self._context, self._context.parameters
        self._passed, self._angles = 0, []
        self._unsure = self._unsure_here = 0
        while True:
            estimate = yield from self._measure()
            if not estimate.usable:
                self._passed, stay = 0, False
                yield from self._dock_again(*self._look_elsewhere(estimate))
                continue
            self._unsure_here = 0
            place = context.position[0], context.position[1]
            self._filter.update(place, estimate)
            if self._filter.contradicts_itself and not stay:
                context.decide("contradiction", "the pads do not feel the arm's own moves", x_m=estimate.horizontal)
                raise EstimateUnsure(
                    "what the pads feel contradicts the arm's own moves; do their frames repeat themselves, or does "
                    "the target move?"
                )
            verdict = self._judge(estimate)
            x, y = self._filter.misalignment(place)
            self.aligned = max(abs(x), abs(y)) <= parameters.alignment_tolerance
            landed = self._filter.landing <= parameters.landing_limit
            exhausted = context.status.alignments >= parameters.alignments_max
            settled = stay or (self.aligned and landed) or (exhausted and parameters.charge_when_not_aligned)
            safe = verdict is Verdict.SAFE or (verdict is Verdict.PROBABLY_SAFE and self._passed >= 2)
            if stay and not safe:
                self._filter = AlignmentFilter(parameters)  # the target is not any more where it was
            stay = False
            if settled and safe and (yield from self._stands()):
                text = "the target lies within the tolerance" if self.aligned else "the electrodes have clearance here"
                context.decide("aligned" if self.aligned else "exhausted", text, x_m=x, y_m=y)
                return
            if exhausted:
                context.decide("exhausted", "no correction is left", x_m=x, y_m=y, moves=context.status.alignments)
                raise Misaligned(
                    f"after {context.status.alignments} alignments no clearance is sure; the electrodes are "
                    f"{1000 * x:.1f} mm horizontally and {1000 * y:.1f} mm vertically off"
                )
            context.status.alignments += 1
            if self.aligned:
                text = "clearance is not sure yet" if landed else "this landing lies too far beside the target"
                context.decide("again", f"{text}: docking again", beside_m=self._filter.landing, x_m=x, y_m=y)
            else:
                context.decide("move", "the electrodes are taken to where the target was felt", x_m=x, y_m=y)
            yield from self._dock_again(x, y)

    def _stands(self) -> Script[bool]:
        """Put the arm at ease and return whether the electrodes still have clearance: it may have slipped."""
        if not (yield from ease(self._context)):
            return True
        estimate = yield from self._measure()
        if estimate.usable and judge(estimate, self._context.parameters, self.critical_angle).leaves_clearance:
            return True
        self._passed = 0
        return False

    def _measure(self) -> Script[FeltPose]:
        """Return what the pads feel, sure or not.

        Raises:
            NoTactileContact: they feel nothing.
            TactileStale: no estimate came.
        """
        context, parameters = self._context, self._context.parameters
        context.enter(State.MEASURE, parameters.measure_timeout)
        context.doubtful = bool(context.observation.duplicate_sources)
        reply = yield from context.ask(
            Service.ESTIMATE, TactileStale, parameters.service_timeout, parameters.estimate_frames
        )
        if not reply.success or reply.estimate is None:
            raise TactileStale(f"no misalignment estimate: {reply.message}")
        context.status.estimate = reply.estimate
        self._tell(reply.estimate)
        if not reply.estimate.contact:
            raise NoTactileContact("the pads lost contact before the misalignment was measured")
        return reply.estimate

    def _look_elsewhere(self, estimate: FeltPose) -> tuple[float, float]:
        """Return by how much (m) to move before measuring again: where an unsure estimate points, or nowhere.

        A pad that has lost its ridge still tells the direction. It only moves the arm; energising needs a sure one.
        """
        parameters = self._context.parameters
        self._unsure_here += 1
        self._unsure += 1
        place = self._context.position
        x, y = _pointed_at(estimate, parameters.unsure_move_sigmas)
        lost = estimate.complete and math.hypot(x, y) > parameters.unsure_move_min
        reachable = lost and not self._context.planner.reachable((place[0] + x, place[1] + y, place[2]))
        if reachable and self._unsure < parameters.unsure_max:
            self._unsure_here = 0
            self._context.status.alignments += 1
            self._context.decide("elsewhere", "a pad has lost its ridge: it is looked for", x_m=x, y_m=y)
            return x, y
        if self._unsure_here >= parameters.unsure_here_max or self._unsure >= parameters.unsure_max:
            self._give_up(estimate)
        self._context.decide("again", "the estimate is unsure and is made anew by docking again", times=self._unsure)
        return 0.0, 0.0

    def _tell(self, estimate: FeltPose) -> None:
        self._context.decide(
            "measured",
            "sure" if estimate.sure and estimate.in_range else "unsure" if estimate.in_range else "out of range",
            angle_rad=estimate.angle,
            angle_stddev_rad=estimate.angle_stddev,
            vertical_m=estimate.vertical,
            vertical_stddev_m=estimate.vertical_stddev,
            horizontal_m=estimate.horizontal,
            horizontal_stddev_m=estimate.horizontal_stddev,
        )

    def _tell_verdict(self, estimate: FeltPose, verdict: Verdict) -> None:
        parameters = self._context.parameters
        gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
        left = clearance(estimate.angle, estimate.vertical, gap, length)
        sigma = clearance_stddev(estimate, gap, length)
        self._context.decide(
            "verdict",
            verdict.value,
            clearance_m=left,
            margin_3_sigma_m=left - 3.0 * sigma - parameters.clearance_min,
            margin_6_sigma_m=left - 6.0 * sigma - parameters.clearance_min,
        )

    def _give_up(self, estimate: FeltPose) -> None:
        limit = min(self.critical_angle, self._context.parameters.critical_angle)
        if math.isfinite(estimate.angle) and abs(estimate.angle) >= limit:
            raise CriticalAngle(_too_tilted(estimate.angle))
        what = "outside what the estimator knows" if not estimate.in_range else "unsure"
        raise EstimateUnsure(f"the tactile estimate stayed {what} after {self._unsure} dockings; check pads and target")

    def _judge(self, estimate: FeltPose) -> Verdict:
        """Judge this docking, and the mean angle once two have been made."""
        parameters = self._context.parameters
        self._angles.append(estimate.angle)
        verdict = judge(estimate, parameters, self.critical_angle)
        self._tell_verdict(estimate, verdict)
        self._passed = self._passed + 1 if verdict.leaves_clearance else 0
        if len(self._angles) >= 2:
            mean = sum(self._angles) / len(self._angles)
            if judge(replace(estimate, angle=mean, vertical=0.0), parameters, self.critical_angle) is Verdict.CRITICAL:
                raise CriticalAngle(_too_tilted(mean))
        return verdict

    def _dock_again(self, x: float, y: float) -> Script[None]:
        """Lift off, move the command by (x, y) m and press again.

        The command moves by what the measured pose is off, so that friction and a soft servo, which keep the platform
        short of its command, are corrected as well.

        Raises:
            Unreachable: the way there leaves the arm's reach; the platform was not lifted.
        """
        context, parameters = self._context, self._context.parameters
        commanded, z = context.commanded, context.position[2]
        place = commanded[0] + x, commanded[1] + y, z - parameters.lift
        context.check_way((*context.position[:2], place[2]), place, (*place[:2], z))
        context.enter(State.ALIGN, parameters.align_timeout)
        yield from take_off(context, place[2])
        yield from context.move(place, parameters.travel_speed)
        yield from contact(context, self._depth)


def _pointed_at(estimate: FeltPose, sigmas: float) -> tuple[float, float]:
    """Return where (m) an unsure estimate points: out of range all of it, else along axes known at `sigmas`."""
    x, y = estimate.horizontal, estimate.vertical
    if estimate.in_range:
        x = x if abs(x) > sigmas * estimate.horizontal_stddev else 0.0
        y = y if abs(y) > sigmas * estimate.vertical_stddev else 0.0
    return x, y


def _too_tilted(angle: float) -> str:
    return (
        f"the target is tilted by {math.degrees(angle):.1f}°: the electrodes would come too close to a short; "
        "level the target or the charger"
    )
