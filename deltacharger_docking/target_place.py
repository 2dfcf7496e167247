# SPDX-License-Identifier: Apache-2.0
"""Place of the target estimated from all contacts, along and across its bars, and the choice of the next contact."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from deltacharger_core.machine import PAD_DISTANCE, PAD_YAW_STIFFNESS
from deltacharger_docking.along import HORIZONTAL_SHARED, LOAD_PER_YAW, AlongFilter, LookAlong, Plan, empty_pad_offset
from deltacharger_docking.clearance import MisalignmentEstimate, pitch_shift
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.observation import ElectrodePose
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.place import AxisFilter, Offset
from deltacharger_docking.yielding import RemainingShare

# Chosen on seeds 5 and 19.
_REDOCKING_GAIN_MIN = 0.004  # decrease of the risk of exceeding landing_limit or overlap_loss_max that pays a contact
_HORIZONTAL_SCALE = 0.83  # true / reported standard deviation of horizontal estimates
# Chosen on seed 5 of lean2, lean5 and rigid.
_PROBE_GAIN_MIN = 0.03  # more decrease of that risk that pays a contact which only probes
_PAD_FORCE_MIN = 3.0  # N, force below which a pad does not hold its ridge

_FORCE_REPEATABILITY = 0.045  # relative scatter of a pad's force between contacts; its data sheet has 0.04 to 0.045
_UNSURE_MOVE_SIGMAS = 3.0  # standard deviations at which an unsure offset is followed; the seeds were not kept
_UNKNOWN_FORCE = 1e3  # N, standard deviation of an unknown force
_ON_PAD = 0.009  # m across, within which a ridge is completely on its pad
_FAR = 0.02  # m along, where a ridge begins to leave its pad
_PRICE_GROWTH = 1.5  # each further contact must gain this many times the gain required of the one before


class TargetPlace:
    """Place of one target, estimated contact by contact.

    Args:
        parameters: of docking.
        share: of a yaw that remains in contact; learns from targets whose yaw was detected.
        electrodes: pose as detected or given; None = unknown.

    Attributes:
        off: measured offset of the target from the platform in this contact, m, along x and y.
        plan: the next contacts with the largest expected gain, less the price of each contact.
    """

    def __init__(
        self, parameters: DockingParameters, share: RemainingShare, electrodes: ElectrodePose | None = None
    ) -> None:
        self._parameters, self._share = parameters, share
        # Its yaw along the ridges: combined with the usual spread of targets, and as detected alone.
        self._yaw, self._seen = (0.0, parameters.yaw_stddev), (math.nan, math.nan)
        if electrodes is not None:
            usual = parameters.yaw_stddev
            self._yaw, self._seen = (_along_ridges(electrodes, yaw, usual) for yaw in (usual, math.inf))
        self._along = self._foreseen(electrodes)
        self._across = AxisFilter()
        self._load = math.nan  # m, offset by load in this contact, before the arm was put at ease
        self._turn = math.nan  # rad, of the bars in the first contact; defines the axis across the bars
        self.off = (math.nan, math.nan)
        self.plan = Plan(0.0, 1)

    def add(
        self,
        estimate: MisalignmentEstimate,
        x: float,
        y: float,
        push: float,
        drawn: float = math.nan,
        draw_share: float = 0.0,
        again: bool = False,
    ) -> None:
        """Add the estimate of a contact of the platform at (x, y), m, under the servos' push (N).

        The magnets drew the platform by `drawn` (m along x, NaN = unknown) while it landed; `draw_share` of its way
        from the command to the target was expected. `again`: replaces the earlier estimate of this contact.
        """
        if math.isnan(self._turn):
            self._turn = estimate.angle
        cosine, sine = math.cos(self._turn), math.sin(self._turn)
        platform = cosine * y - sine * x
        self._across.update(platform, estimate.across, estimate.across_stddev)
        own = math.sqrt(max((_HORIZONTAL_SCALE * estimate.horizontal_stddev) ** 2 - HORIZONTAL_SHARED**2, 1e-8))
        force = estimate.left_force + estimate.right_force
        spread = _FORCE_REPEATABILITY * math.hypot(estimate.left_force, estimate.right_force)
        if not (force > 0.0 and math.isfinite(push)):
            force, spread, push = 0.0, _UNKNOWN_FORCE, 0.0
        if not (draw_share > 0.0 and math.isfinite(drawn)):
            drawn, draw_share = 0.0, 0.0
        pads = estimate.horizontal, own, force, spread, push, estimate.across, estimate.angle
        self._along.update(LookAlong(x, *pads, drawn, draw_share), again)
        self._load = estimate.horizontal
        along, across = self._along.target - x, self._across.target - platform
        self.off = along, (across + along * sine) / cosine

    @property
    def contradicts_itself(self) -> bool:
        """Whether the contacts differ by more than their errors allow."""
        return self._along.contradicts_itself or self._across.contradicts_itself

    @property
    def risk(self) -> float:
        """Estimated probability that this contact is too far off, along or across the bars."""
        p = self._parameters
        return self._along.risk(p.overlap_loss_max) + self._across.contact.beyond(p.landing_limit)

    def choose(self, moves: int, reaches: Callable[[float, float], bool]) -> None:
        """Choose the next contacts after this many moves.

        Args:
            moves: number of moves made.
            reaches: whether the platform reaches a place at this offset (m, along x and y).
        """
        p = self._parameters
        price, across = _REDOCKING_GAIN_MIN * _PRICE_GROWTH**moves, self._across.gain(p.landing_limit)
        plans = [
            replace(plan, gain=plan.gain + across - price - _PROBE_GAIN_MIN * (plan.contacts - 1))
            for plan in self._along.plans(p.overlap_loss_max)
            if not plan.aside or reaches(*self.step(plan.aside))
        ]
        self.plan = max(plans, key=lambda plan: plan.gain)

    def step(self, aside: float = 0.0) -> tuple[float, float]:
        """Return the move (m) after which the target's centre is `aside` (m) along the bars from the platform."""
        x, y = self.off
        return x - aside, y - aside * math.tan(self._turn)

    def least_yaw(self, estimate: MisalignmentEstimate, x: float, push: float) -> float:
        """Return the least yaw of the faces (rad) that lets one pad carry nearly all, although both have a ridge.

        Args:
            estimate: in a contact that is not in range.
            x: of the platform, m.
            push: of the servos on the target, N.

        Returns:
            NaN if both pads carry force, the empty pad may be off its ridge, or the target's place explains it better.
        """
        p, loads = self._parameters, (estimate.left_force, estimate.right_force)
        light, force = min(loads), sum(loads)
        # With less force than at _FAR aside, or than pads measure well, an offset may also empty the pad.
        pull, _, _ = MagnetPull(p.magnet_force).at(np.array(_FAR), 0.0, 0.0)
        enough = max((push + float(pull)) / (1.0 - 2.0 * _FORCE_REPEATABILITY), 5.0 * _PAD_FORCE_MIN)
        if not (estimate.complete and light < _PAD_FORCE_MIN and force > enough):
            return math.nan
        heavy = 1.0 if loads[0] > loads[1] else -1.0  # side of the loaded pad along x
        ridge = estimate.across / math.cos(estimate.angle) - heavy * PAD_DISTANCE * math.tan(estimate.angle)
        place, lean = self._along.parts(heavy * empty_pad_offset(force), x)
        if abs(ridge) > _ON_PAD or heavy * lean < abs(place):
            return math.nan
        return heavy * PAD_DISTANCE * force * (p.platform_compliance + 1.0 / PAD_YAW_STIFFNESS)

    def pointed_at(self, estimate: MisalignmentEstimate, x: float) -> tuple[float, float]:
        """Return where (m, along x and y) an unsure estimate points, with the platform at `x` (m).

        Out of range it points across the bars only: along them, a pad off its ridge cannot be distinguished from one
        that a lean leaves empty.
        """
        if not estimate.in_range:
            return 0.0, estimate.across / math.cos(estimate.angle)
        sigmas = _UNSURE_MOVE_SIGMAS
        along, _ = self._along.parts(estimate.horizontal, x)
        return (
            along if abs(along) > sigmas * estimate.horizontal_stddev else 0.0,
            estimate.vertical if abs(estimate.vertical) > sigmas * estimate.vertical_stddev else 0.0,
        )

    def learn(self) -> None:
        """Learn, once per target with a detected yaw, the share of the yaw that remains, from its contacts alone."""
        bias, per_yaw = self._along.measured_bias, LOAD_PER_YAW
        self._share.learn(*self._seen, bias.mean / per_yaw, bias.stddev / per_yaw)
        self._seen = (math.nan, math.nan)

    def settle(self, estimate: MisalignmentEstimate) -> MisalignmentEstimate:
        """Use the estimate made with the arm at ease, and return it as `combined`."""
        self._load = estimate.horizontal
        return self.combined(estimate)

    def _foreseen(self, electrodes: ElectrodePose | None) -> AlongFilter:
        """Return the filter before contact: with the place if known, and the load bias expected from the yaw."""
        (yaw, stddev), share, per_yaw = self._yaw, self._share, LOAD_PER_YAW
        spread = per_yaw * math.hypot(share.value * stddev, share.stddev * yaw)
        place = math.nan if electrodes is None else electrodes.position[0]
        return AlongFilter(self._parameters, place, self._parameters.place_stddev, per_yaw * share.value * yaw, spread)

    def combined(self, estimate: MisalignmentEstimate, later: bool = False) -> MisalignmentEstimate:
        """Return this contact's estimate combined with all contacts, including the yaw of the faces.

        `later`: this contact was estimated before; a change of its loads since then means that the target has slid.
        """
        p, contact = self._parameters, self._along.contact
        if later:
            spread = math.hypot(contact.stddev, _HORIZONTAL_SCALE * estimate.horizontal_stddev)
            contact = Offset(contact.mean + estimate.horizontal - self._load, spread)
        angle = estimate.angle
        sine, cosine = math.sin(angle), math.cos(angle)
        pitch, pitch_stddev = _among(p.yaw_stddev, estimate.pitch, estimate.pitch_stddev)
        shifted = pitch_shift(replace(estimate, pitch_stddev=0.0))  # what a known pitch adds to the pads' own error
        yaw, yaw_stddev = self._yaw_by_contacts()
        return replace(
            estimate,
            horizontal=contact.mean,
            horizontal_stddev=contact.stddev,
            vertical=(estimate.across + contact.mean * sine) / cosine,
            vertical_stddev=math.hypot(estimate.across_stddev, shifted, contact.stddev * sine) / cosine,
            yaw=yaw + pitch * math.tan(angle),
            yaw_stddev=math.hypot(yaw_stddev, pitch_stddev * math.tan(angle)),
        )

    def _yaw_by_contacts(self) -> tuple[float, float]:
        """Return the yaw along the ridges and its standard deviation, rad: as before contact and as the contacts show.

        They show the load of the share that remains, so the share's relative error is one of the yaw.
        """
        (before, stddev), share, per_yaw = self._yaw, self._share, LOAD_PER_YAW
        load = self._along.measured_bias
        found = load.mean / per_yaw / share.value
        error = math.hypot(load.stddev / per_yaw, share.stddev * max(abs(found), abs(before))) / share.value
        weight = 1.0 / (1.0 + (error / stddev) ** 2) if stddev > 0.0 else 0.0
        return before + weight * (found - before), stddev * math.sqrt(1.0 - weight)


def _along_ridges(electrodes: ElectrodePose, usual_yaw: float, usual_pitch: float) -> tuple[float, float]:
    """Return the yaw along the ridges before contact and its standard deviation, rad.

    On rolled ridges a pitch acts as a yaw, by the tangent. The usual spread of targets is a standard deviation.
    """
    roll = math.tan(electrodes.roll)
    yaw, yaw_stddev = _among(usual_yaw, electrodes.yaw, electrodes.yaw_stddev)
    pitch, pitch_stddev = _among(usual_pitch, electrodes.pitch, electrodes.pitch_stddev)
    return yaw - roll * pitch, math.hypot(yaw_stddev, roll * pitch_stddev)


def _among(usual: float, seen: float, stddev: float) -> tuple[float, float]:
    """Return a lean (rad) and its standard deviation, by the usual spread of targets and the detected lean, if any."""
    if not (math.isfinite(seen) and math.isfinite(stddev)):
        return 0.0, usual
    weight = 1.0 / (1.0 + (stddev / usual) ** 2) if usual > 0.0 else 0.0
    return weight * seen, math.sqrt(weight) * stddev
