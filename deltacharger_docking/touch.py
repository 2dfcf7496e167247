# SPDX-License-Identifier: Apache-2.0
"""What the pads tell: the misalignment, where the target is, whether the electrodes may rest here, else where to."""

from __future__ import annotations

import math
from dataclasses import replace

from deltacharger_docking.clearance import FeltPose, Verdict, clearance, clearance_stddev, judge
from deltacharger_docking.codes import CriticalAngle, EstimateUnsure, Misaligned, NoTactileContact, State, TactileStale
from deltacharger_docking.context import Context
from deltacharger_docking.observation import Service
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.script import Script

_LEAST = 1e-12  # m²; below it a variance would divide by nothing


def measure(context: Context) -> Script[FeltPose]:
    """Return what the pads feel, sure or not.

    Raises:
        NoTactileContact: they feel nothing.
        TactileStale: no estimate came.
    """
    parameters = context.parameters
    context.enter(State.MEASURE, parameters.measure_timeout)
    context.doubtful = bool(context.observation.duplicate_sources)
    reply = yield from context.ask(
        Service.ESTIMATE, TactileStale, parameters.service_timeout, parameters.estimate_frames
    )
    felt = reply.estimate
    if not reply.success or felt is None:
        raise TactileStale(f"no misalignment estimate: {reply.message}")
    context.status.estimate = felt
    context.decide(
        "measured",
        "sure" if felt.sure and felt.in_range else "unsure" if felt.in_range else "out of range",
        angle_rad=felt.angle,
        angle_stddev_rad=felt.angle_stddev,
        vertical_m=felt.vertical,
        vertical_stddev_m=felt.vertical_stddev,
        horizontal_m=felt.horizontal,
        horizontal_stddev_m=felt.horizontal_stddev,
    )
    if not felt.contact:
        raise NoTactileContact("the pads lost contact before the misalignment was measured")
    return felt


class PlaceFilter:
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
            land = self._land(axis, place - offset, offset, max(felt, _LEAST))
            self.landing = max(self.landing, land, parameters.landing_felt_sigmas * stddev)
            weight = 1.0 / max(variance, _LEAST)
            if self._information[axis] > 0.0:
                expected = variance + 1.0 / self._information[axis]
                self._innovations[axis] += (place - self._mean[axis]) ** 2 / max(expected, _LEAST)
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
            known = 1.0 / (self._parameters.docking_jitter**2 + 1.0 / information + _LEAST)
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


class Target:
    """What is known of one target by touch, from its first contact until it is left, and what follows from it.

    Attributes:
        critical_angle: limit of the goal, rad.
        depth: largest z (m, charger_base) at which contact is looked for.
        aligned: whether the filtered misalignment lies within the tolerance.
    """

    def __init__(self, context: Context, critical_angle: float) -> None:
        self._context = context
        self.critical_angle = critical_angle
        self.depth = math.inf
        self.aligned = False
        self._filter = PlaceFilter(context.parameters)
        self._off = (math.nan, math.nan)  # filtered misalignment of this contact, m
        self._landed = False  # this contact lies within landing_limit, as far as is known
        self.begin()

    def begin(self) -> None:
        """Forget what earlier goals have counted; the target's place stays known."""
        self._angles: list[float] = []
        self._passed = 0  # contacts in a row that leave clearance
        self._unsure = self._unsure_here = 0
        self._felt: FeltPose | None = None  # in this contact

    def allows_rest(self, felt: FeltPose, stay: bool) -> bool:
        """Take what is felt in this contact; return whether the electrodes may rest here and current may flow.

        Args:
            felt: sure or not.
            stay: they have been aligned before and may rest where they are, if they have clearance there.

        Raises:
            CriticalAngle: the target is tilted too far.
            EstimateUnsure: what is felt contradicts the arm's own moves.
        """
        self._felt = felt
        if not felt.usable:
            self._passed = 0
            return False
        context, parameters = self._context, self._context.parameters
        self._unsure_here = 0
        place = context.position[0], context.position[1]
        self._filter.update(place, felt)
        if self._filter.contradicts_itself and not stay:
            context.decide("contradiction", "the pads do not feel the arm's own moves", x_m=felt.horizontal)
            raise EstimateUnsure(
                "what the pads feel contradicts the arm's own moves; do their frames repeat themselves, or does the "
                "target move?"
            )
        verdict = self._judge(felt)
        safe = verdict is Verdict.SAFE or (
            verdict is Verdict.PROBABLY_SAFE and self._passed >= parameters.clearance_contacts
        )
        self._off = x, y = self._filter.misalignment(place)
        self.aligned = max(abs(x), abs(y)) <= parameters.alignment_tolerance
        self._landed = self._filter.landing <= parameters.landing_limit
        settled = stay or (self.aligned and self._landed) or (self._exhausted and parameters.charge_when_not_aligned)
        if stay and not safe:
            self._filter = PlaceFilter(parameters)  # the target is not any more where it was
        return settled and safe

    def still_allows_rest(self, felt: FeltPose) -> bool:
        """Take what is felt once the arm is at ease; return whether it has left the clearance."""
        if felt.usable and judge(felt, self._context.parameters, self.critical_angle).leaves_clearance:
            return True
        self._passed = 0
        return False

    def rest(self) -> None:
        """Tell that the electrodes rest here."""
        text = "the target lies within the tolerance" if self.aligned else "the electrodes have clearance here"
        self._context.decide("aligned" if self.aligned else "exhausted", text, x_m=self._off[0], y_m=self._off[1])

    def correction(self) -> tuple[float, float]:
        """Return by how much (m) to move before the next contact, and count it.

        Raises:
            Misaligned: clearance was not reached within the allowed alignments.
            EstimateUnsure: the estimate stayed unsure.
            CriticalAngle: it did, and tells a tilt beyond the limit.
        """
        context = self._context
        if self._felt is not None and not self._felt.usable:
            return self._look_elsewhere(self._felt)
        x, y = self._off
        if self._exhausted:
            context.decide("exhausted", "no correction is left", x_m=x, y_m=y, moves=context.status.alignments)
            raise Misaligned(
                f"after {context.status.alignments} alignments no clearance is sure; the electrodes are "
                f"{1000 * x:.1f} mm horizontally and {1000 * y:.1f} mm vertically off"
            )
        context.status.alignments += 1
        if self.aligned:
            text = "clearance is not sure yet" if self._landed else "this landing lies too far beside the target"
            context.decide("again", f"{text}: docking again", beside_m=self._filter.landing, x_m=x, y_m=y)
        else:
            context.decide("move", "the electrodes are taken to where the target was felt", x_m=x, y_m=y)
        return x, y

    @property
    def _exhausted(self) -> bool:
        return self._context.status.alignments >= self._context.parameters.alignments_max

    def _judge(self, felt: FeltPose) -> Verdict:
        """Judge this contact, and the mean angle once two have been made."""
        parameters = self._context.parameters
        self._angles.append(felt.angle)
        verdict = judge(felt, parameters, self.critical_angle)
        gap, length = parameters.electrode_half_gap, parameters.electrode_half_length
        left, sigma = clearance(felt.angle, felt.vertical, gap, length), clearance_stddev(felt, gap, length)
        self._context.decide(
            "verdict",
            verdict.value,
            clearance_m=left,
            margin_3_sigma_m=left - parameters.clearance_sigmas * sigma - parameters.clearance_min,
            margin_6_sigma_m=left - parameters.clearance_sigmas_sure * sigma - parameters.clearance_min,
        )
        self._passed = self._passed + 1 if verdict.leaves_clearance else 0
        mean = sum(self._angles) / len(self._angles)
        centred = replace(felt, angle=mean, vertical=0.0)
        if (
            len(self._angles) >= parameters.clearance_contacts
            and judge(centred, parameters, self.critical_angle) is Verdict.CRITICAL
        ):
            raise CriticalAngle(_too_tilted(mean))
        return verdict

    def _look_elsewhere(self, felt: FeltPose) -> tuple[float, float]:
        """Return by how much (m) to move before measuring again: where an unsure estimate points, or nowhere.

        A pad that has lost its ridge still tells the direction. It only moves the arm; energising needs a sure one.
        """
        context, parameters = self._context, self._context.parameters
        self._unsure_here += 1
        self._unsure += 1
        place = context.position
        x, y = _pointed_at(felt, parameters.unsure_move_sigmas)
        lost = felt.complete and math.hypot(x, y) > parameters.unsure_move_min
        reachable = lost and not context.planner.reachable((place[0] + x, place[1] + y, place[2]))
        if reachable and self._unsure < parameters.unsure_max:
            self._unsure_here = 0
            context.status.alignments += 1
            context.decide("elsewhere", "a pad has lost its ridge: it is looked for", x_m=x, y_m=y)
            return x, y
        if self._unsure_here >= parameters.unsure_here_max or self._unsure >= parameters.unsure_max:
            self._give_up(felt)
        context.decide("again", "the estimate is unsure and is made anew by docking again", times=self._unsure)
        return 0.0, 0.0

    def _give_up(self, felt: FeltPose) -> None:
        limit = min(self.critical_angle, self._context.parameters.critical_angle)
        if math.isfinite(felt.angle) and abs(felt.angle) >= limit:
            raise CriticalAngle(_too_tilted(felt.angle))
        what = "outside what the estimator knows" if not felt.in_range else "unsure"
        raise EstimateUnsure(f"the tactile estimate stayed {what} after {self._unsure} dockings; check pads and target")


def _pointed_at(felt: FeltPose, sigmas: float) -> tuple[float, float]:
    """Return where (m) an unsure estimate points: out of range all of it, else along axes known at `sigmas`."""
    x, y = felt.horizontal, felt.vertical
    if felt.in_range:
        x = x if abs(x) > sigmas * felt.horizontal_stddev else 0.0
        y = y if abs(y) > sigmas * felt.vertical_stddev else 0.0
    return x, y


def _too_tilted(angle: float) -> str:
    return (
        f"the target is tilted by {math.degrees(angle):.1f}°: the electrodes would come too close to a short; "
        "level the target or the charger"
    )
