# SPDX-License-Identifier: Apache-2.0
"""Place of the target, estimated from all contacts along and across its bars, and whether another contact is worth it.

Across the bars a Kalman filter is enough. Along them a lean loads the pads like an offset.

A single contact cannot distinguish an offset x along the bars from a lean of the faces. The pads' loads give h = x + L,
with a load bias L that all contacts on one target share. The contact force depends on x alone, because the magnets'
part of it decreases with the distance of the centres. So contacts at different places of the platform give both.

While the platform lands, the magnets also draw it from its command toward the target, as far as the arm yields. That
is a third measurement, d = share · (target − command). The share follows from the arm's lateral stiffness and the
magnets', of which the reach is not known.

For a given place of the target, all else is normal and linear. All contacts share the load bias, the gain error of h,
and the scale errors of the pads' force, of the magnets, of their width and of their draw. Each contact has its own
landing error beside the commanded place (DOCKING_JITTER), which encoders do not see. So the likelihood of a place is
a normal density. It is calculated on a grid of places, since it can have two peaks: the force is even in x.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from deltacharger_core import arrays, machine
from deltacharger_docking import arm, clearance, observation
from deltacharger_docking.parameters import DockingParameters

# Chosen in earlier campaigns whose seeds were not kept.
_CONTRADICTION_START = 25.0  # squared innovations that contradict the arm's moves
_CONTRADICTION_EACH = 4.0  # more of them per measured number
GAIN_ERROR = 0.15  # error of a misalignment estimate relative to its size; chosen on seeds 5 and 19

_LEAST = 1e-12  # m²; avoids division by zero
_QUANTILES = tuple(NormalDist().inv_cdf((index + 0.5) / 16) for index in range(16))


@dataclass(frozen=True)
class Offset:
    """Offset (m) of a contact along one axis, normally distributed."""

    mean: float
    stddev: float

    def beyond(self, limit: float) -> float:
        """Return the probability that it exceeds `limit` (m), either way."""
        scale = math.sqrt(2.0) * max(self.stddev, math.sqrt(_LEAST))
        return 0.5 * (math.erfc((limit - self.mean) / scale) + math.erfc((limit + self.mean) / scale))


def expected_gain(now: float, foreseen: float, measured: float, limit: float) -> float:
    """Return the expected decrease of the risk of exceeding `limit` by another contact at the target.

    The mean of its offset is distributed around zero, with the variance that the contact will resolve. A contact worse
    than this one gains nothing, since it can be repeated.

    Args:
        now: risk of this contact.
        foreseen: variance of the other one's offset before it is measured, m².
        measured: variance after it is measured, m².
        limit: m.
    """
    spread, stddev = math.sqrt(max(foreseen - measured, 0.0)), math.sqrt(measured)
    risks = (Offset(spread * each, stddev).beyond(limit) for each in _QUANTILES)
    return sum(max(now - risk, 0.0) for risk in risks) / len(_QUANTILES)


def contradicts(innovations: float, values: int) -> bool:
    """Return whether these values differ by more than their errors allow: they do not follow the arm's moves.

    Args:
        innovations: sum of squares, each divided by its variance.
        values: how many were measured.
    """
    return innovations > _CONTRADICTION_START + _CONTRADICTION_EACH * values


class AxisFilter:
    """Kalman filter of the target's place along one axis, as measured by contacts.

    The axis may have any direction that is fixed in charger_base; docking uses the one across the bars.

    A contact differs from its commanded place by DOCKING_JITTER (standard deviation, m), which encoders do not see.
    The error of an estimate has two parts: one of this contact alone, and one that grows with the offset by
    GAIN_ERROR, so that a first contact 8 mm away has little weight once the platform is close.
    """

    def __init__(self) -> None:
        self._information = 0.0  # 1/m²
        self._innovations = 0.0
        self._looks = 0
        self.target = math.nan
        """Estimated place of the target, m; NaN before the first contact."""
        self.contact = Offset(math.nan, math.nan)
        """Offset of this contact."""

    def update(self, platform: float, offset: float, stddev: float) -> None:
        """Add one contact: platform and offset (m), and the offset's reported standard deviation (m)."""
        own = max(stddev**2, _LEAST) + (GAIN_ERROR * offset) ** 2
        variance, place, weight = machine.DOCKING_JITTER**2 + own, platform + offset, 1.0 / own
        mean = offset
        self._looks += 1
        if self._information > 0.0:
            ahead = 1.0 / self._ahead
            mean = (weight * offset + ahead * (self.target - platform)) / (weight + ahead)
            weight += ahead
            self._innovations += (place - self.target) ** 2 / (variance + 1.0 / self._information)
        else:
            self.target = place
        self.contact = Offset(mean, 1.0 / math.sqrt(weight))
        self._information += 1.0 / variance
        self.target += (place - self.target) / (variance * self._information)

    @property
    def _ahead(self) -> float:
        """Variance (m²) with which the filter predicts the offset of a contact."""
        return machine.DOCKING_JITTER**2 + 1.0 / self._information + _LEAST

    @property
    def contradicts_itself(self) -> bool:
        """Whether the contacts differ by more than their errors allow."""
        return contradicts(self._innovations, self._looks)

    def gain(self, limit: float) -> float:
        """Return the expected decrease of the risk of exceeding `limit` (m) by another contact."""
        return expected_gain(self.contact.beyond(limit), self._ahead, self.contact.stddev**2, limit)


class MagnetPull:
    """Pull over offsets along the bars, with its derivatives: F = force · max(floor, 1/(1 + (r/width)²)).

    Args:
        force: in contact without offset, N.
        width: offset that halves it, m.
    """

    def __init__(self, force: float, width: float = machine.MAGNET_WIDTH) -> None:
        self._force, self._width = force, width

    def at(self, x: arrays.Array, across: float, angle: float) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
        """Return pull (N), its slope along x (N/m) and by the logarithm of the width (N).

        Args:
            x: of the target's centre in end_effector, m.
            across: its offset across the bars, m.
            angle: of the bars, rad.
        """
        lean = np.tan(angle)
        y = across / np.cos(angle) + x * lean
        square = (x * x + y * y) / self._width**2
        share = 1.0 / (1.0 + square)
        falls = share > machine.MAGNET_FLOOR
        steep = np.where(falls, share * share, 0.0) * (2.0 * self._force)
        pull = self._force * np.maximum(share, machine.MAGNET_FLOOR)
        return pull, -steep * (x + y * lean) / self._width**2, steep * square


HORIZONTAL_SHARED = 0.00055  # m, error of horizontal estimates that all contacts share; chosen on seeds 5 and 19
LOAD_PER_YAW = 5.73  # m/rad, offset along the bars that loads the pads like a yaw; their generator tilts by 10° per m
# Chosen on seed 5 of lean2, lean5 and rigid.
_LOAD_SHARE_MAX = 0.85  # largest share of the moment that empties a pad, for contacts made to probe
_PROBE_OFFSET = 0.006  # m, offset from the target where the magnets' pull is probed
# The spread of gains and magnets in the pads' generator (5 %), set a little higher; the width by judgement.
FORCE_ERROR = 0.06  # relative error of the pads' force that all contacts share
_MAGNET_ERROR = 0.06  # relative error of magnet_force
_MAGNET_WIDTH_ERROR = 0.12  # relative error of MAGNET_WIDTH

_HALF_WIDTH, _POINTS = 0.024, 65  # m around the expected place; number of places of the grid
_NEGLIGIBLE = 1e-6  # weight of a place
_EACH = 3  # measured numbers of a contact: load, force and draw
_DRAW_ERROR = 1.0  # of the logarithm of the share's odds; magnets that reach 1 or 4 mm, not 2, are about so far off
_DRAW_STDDEV = 0.001  # m, by friction of the gears and of the faces; chosen on seed 43


@dataclass(frozen=True)
class LookAlong:
    """Measurements of one contact along the bars.

    Attributes:
        platform: its measured place along x, m, charger_base.
        load: offset by the pads' loads, m.
        load_stddev: its own standard deviation, m.
        force: sum over both pads, N.
        force_stddev: N.
        push: force of the servos on the target, N.
        across: offset across the bars, m.
        angle: rad.
        drawn: m along x that the magnets drew the platform while it landed.
        draw_share: share of its way from the command to the target that they are expected to draw; 0 = unknown.
    """

    platform: float
    load: float
    load_stddev: float
    force: float
    force_stddev: float
    push: float
    across: float
    angle: float
    drawn: float = 0.0
    draw_share: float = 0.0


@dataclass(frozen=True)
class Plan:
    """Expected gain of one or more further contacts.

    Attributes:
        gain: expected decrease of the risk of exceeding the limit.
        contacts: their number; the last one is made at the target and remains.
        aside: offset of the target's centre from the first contact's command, m along the bars; 0 = at the target.
    """

    gain: float
    contacts: int
    aside: float = 0.0


def empty_pad_offset(force: float) -> float:
    """Return the offset by load (m) from which a contact under this force (N) leaves a pad almost empty."""
    return _LOAD_SHARE_MAX * force * machine.PAD_DISTANCE / machine.PAD_YAW_STIFFNESS * LOAD_PER_YAW


class AlongFilter:
    """Place of one target along x of charger_base, and the load bias of its lean.

    Args:
        parameters: of docking.
        place: expected place of the target, m; NaN = unknown.
        place_stddev: m.
        bias: expected load bias, m.
        bias_stddev: m.

    Attributes:
        target: estimated place, m; NaN before the first contact.
        bias, bias_stddev: the load bias, m.
    """

    def __init__(
        self,
        parameters: DockingParameters,
        place: float = math.nan,
        place_stddev: float = math.inf,
        bias: float = 0.0,
        bias_stddev: float = 0.0,
    ) -> None:
        self._pull = MagnetPull(parameters.magnet_force)
        self._foreseen, self._foreseen_stddev, self._bias = place, place_stddev, bias
        shared = math.hypot(bias_stddev, HORIZONTAL_SHARED)
        errors = GAIN_ERROR, FORCE_ERROR, _MAGNET_ERROR, _MAGNET_WIDTH_ERROR, _DRAW_ERROR
        self._prior = np.array([shared, *errors]) ** 2
        self._looks: list[LookAlong] = []
        self._weights, self._means, self._spread = np.ones(1), np.full(1, math.nan), math.inf
        self._innovations = 0.0
        self.target = math.nan
        self.bias, self.bias_stddev = bias, shared

    def update(self, look: LookAlong, again: bool = False) -> None:
        """Add the measurements of one contact; `again`: they replace the last ones."""
        self._looks[-1 if again else len(self._looks) :] = [look]
        places = self._grid()
        rows, residual, noise, landing = self._rows(places, self._looks)
        joint = np.einsum("gik,k,gjk->gij", rows, self._prior, rows) + noise
        last = np.zeros_like(residual)
        last[:, -_EACH:] = landing[:, -_EACH:]
        of_bias = rows[:, :, 0]
        score, of_last, by_bias = np.moveaxis(np.linalg.solve(joint, np.stack([residual, last, of_bias], axis=2)), 2, 0)
        square = (residual * score).sum(axis=1)
        self._innovations = float(square.min())
        logs = -0.5 * (square + np.linalg.slogdet(joint)[1])
        if math.isfinite(self._foreseen):
            logs -= 0.5 * ((places - self._foreseen) / self._foreseen_stddev) ** 2
        weights = np.exp(logs - logs.max())
        self._weights = weights = weights / weights.sum()
        self.target = float(weights @ places)
        variance = machine.DOCKING_JITTER**2
        self._means = places - look.platform + variance * (last * score).sum(axis=1)
        left = variance - variance**2 * (last * of_last).sum(axis=1)
        self._spread = math.sqrt(max(float(weights @ left), _LEAST))
        prior = self._prior[0]
        bias, within = prior * (of_bias * score).sum(axis=1), prior - prior**2 * (of_bias * by_bias).sum(axis=1)
        mean = float(weights @ bias)
        self.bias = self._bias + mean
        self.bias_stddev = math.sqrt(max(float(weights @ (within + (bias - mean) ** 2)), 0.0))

    @property
    def contact(self) -> Offset:
        """Offset (m) of this contact: mean and standard deviation."""
        mean = float(self._weights @ self._means)
        return Offset(mean, math.sqrt(self._spread**2 + float(self._weights @ (self._means - mean) ** 2)))

    @property
    def measured_bias(self) -> Offset:
        """The load bias (m) from contacts alone, without the expectation; infinite error = no information."""
        before, after = 1.0 / self._prior[0], 1.0 / max(self.bias_stddev**2, _LEAST)
        gained = float(after - before)
        if not gained > 1e-9 * before:
            return Offset(self._bias, math.inf)
        return Offset(float(after * self.bias - before * self._bias) / gained, 1.0 / math.sqrt(gained))

    @property
    def contradicts_itself(self) -> bool:
        """Whether the contacts differ by more than their errors allow."""
        return contradicts(self._innovations, _EACH * len(self._looks))

    def parts(self, load: float, platform: float) -> tuple[float, float]:
        """Return the parts of an offset by load (m) that the target's place and its lean cause, as expected.

        Args:
            load: as measured; if a pad is empty, the least that empties it, m.
            platform: its place, m, charger_base.
        """
        if not math.isfinite(self._foreseen):
            return load, 0.0
        place, lean = self._foreseen_stddev**2, float(self._prior[0])
        aside = self._foreseen - platform
        excess = (load - aside - self._bias) / (place + lean)
        return aside + excess * place, self._bias + excess * lean

    def risk(self, limit: float) -> float:
        """Return the probability that the offset of this contact exceeds `limit` (m), either way."""
        parts = zip(self._weights.tolist(), self._means.tolist(), strict=True)
        return sum(weight * Offset(mean, self._spread).beyond(limit) for weight, mean in parts if weight > _NEGLIGIBLE)

    def plans(self, limit: float) -> list[Plan]:
        """Return the expected gains of a contact at the target, alone or after probes beside it."""
        now, known = self.risk(limit), self._information()
        far, near = _PROBE_OFFSET, 0.5 * _PROBE_OFFSET
        plans = []
        for way in ((), (far,), (-far,), (near,), (-near,), (far, -far), (-far, far)):
            if any(self._empties(aside) for aside in way):
                continue
            after = known
            for aside in way:
                after = after + self._informs(self._expected(aside))
            foreseen, measured = self._landing(after)
            plans.append(Plan(expected_gain(now, foreseen, measured, limit), len(way) + 1, way[0] if way else 0.0))
        return plans

    def _empties(self, aside: float) -> bool:
        """Return whether a contact with the target's centre `aside` m off would leave a pad almost empty."""
        last = self._looks[-1]
        aside *= 1.0 - last.draw_share
        pull, _, _ = self._pull.at(np.array(aside), 0.0, last.angle)
        return abs(self.bias + aside) > empty_pad_offset(float(pull) + last.push)

    def _grid(self) -> arrays.Array:
        """Return the places (G,) of the grid, m."""
        first = self._looks[0]
        middle = self._foreseen if math.isfinite(self._foreseen) else first.platform + first.load - self._bias
        return middle + _HALF_WIDTH * np.linspace(-1.0, 1.0, _POINTS)

    def _rows(
        self, places: arrays.Array, looks: list[LookAlong]
    ) -> tuple[arrays.Array, arrays.Array, arrays.Array, arrays.Array]:
        """Return rows (G, 3N, 6) of contacts, residuals, noise, and the landing's part (G, 3N) for each place."""
        size, jitter = _EACH * len(looks), machine.DOCKING_JITTER
        rows = np.zeros((len(places), size, 6))
        residual, landing = np.zeros((2, len(places), size))
        noise = np.zeros((len(places), size, size))
        for index, look in enumerate(looks):
            load, force, draw = range(_EACH * index, _EACH * index + _EACH)
            x = places - look.platform
            pull, slope, by_width = self._pull.at(x, look.across, look.angle)
            rows[:, load, 0], rows[:, load, 1] = 1.0, x
            rows[:, force, 2], rows[:, force, 3], rows[:, force, 4] = pull + look.push, pull, by_width
            residual[:, load] = look.load - x - self._bias
            residual[:, force] = look.force - pull - look.push
            landing[:, load], landing[:, force] = 1.0, slope
            residual[:, draw] = look.drawn - look.draw_share * (x + look.drawn)
            rows[:, draw, 5] = look.draw_share * (1.0 - look.draw_share) * (x + look.drawn)
            part = landing[:, load : draw + 1]
            block = jitter**2 * part[:, :, None] * part[:, None, :]
            block += np.diag([look.load_stddev, look.force_stddev, _DRAW_STDDEV]) ** 2
            noise[:, load : draw + 1, load : draw + 1] = block
        return rows, residual, noise, landing

    def _information(self) -> arrays.Array:
        """Return the inverse covariance (7, 7) of place and shared errors, linearized at the estimated place."""
        place = 1.0 / self._foreseen_stddev**2 if math.isfinite(self._foreseen) else 0.0
        known = np.diag([place, *1.0 / np.maximum(self._prior, _LEAST)])
        return known + sum(map(self._informs, self._looks))

    def _linear(self, look: LookAlong) -> tuple[arrays.Array, arrays.Array, arrays.Array]:
        """Return rows (3, 7) by place and shared errors, noise (3, 3) and landing (3,) of a contact on the target."""
        rows, _, noise, landing = self._rows(np.array([self.target]), [look])
        return np.column_stack([landing[0] + [0.0, 0.0, look.draw_share], rows[0]]), noise[0], landing[0]

    def _informs(self, look: LookAlong) -> arrays.Array:
        rows, noise, _ = self._linear(look)
        return rows.T @ np.linalg.solve(noise, rows)

    def _expected(self, aside: float) -> LookAlong:
        """Return what a contact commanded `aside` m off the target's centre would be."""
        last = self._looks[-1]
        drawn = last.draw_share * aside
        return replace(last, platform=self.target - aside + drawn, across=0.0, drawn=drawn)

    def _landing(self, known: arrays.Array) -> tuple[float, float]:
        """Return the variance (m²) of the offset of a contact at the target, before and after it is measured."""
        look, jitter = self._expected(0.0), machine.DOCKING_JITTER**2
        rows, noise, landing = self._linear(look)
        covariance = np.diag(np.full(8, jitter))
        covariance[:7, :7] = np.linalg.inv(known)
        full = np.column_stack([rows, landing])
        offset = np.eye(8)[0] + np.eye(8)[7]
        seen = covariance @ full.T
        noise = noise - jitter * np.outer(landing, landing)
        left = covariance - seen @ np.linalg.solve(full @ seen + noise, seen.T)
        # Before, the magnets will draw the platform toward the target, wherever that is.
        before = (1.0 - look.draw_share) ** 2 * covariance[0, 0] + _DRAW_STDDEV**2 + jitter
        return float(before), max(float(offset @ left @ offset), _LEAST)


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
        self,
        parameters: DockingParameters,
        share: arm.RemainingShare,
        electrodes: observation.ElectrodePose | None = None,
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
        estimate: clearance.MisalignmentEstimate,
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

    def least_yaw(self, estimate: clearance.MisalignmentEstimate, x: float, push: float) -> float:
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
        ridge = estimate.across / math.cos(estimate.angle) - heavy * machine.PAD_DISTANCE * math.tan(estimate.angle)
        place, lean = self._along.parts(heavy * empty_pad_offset(force), x)
        if abs(ridge) > _ON_PAD or heavy * lean < abs(place):
            return math.nan
        return heavy * machine.PAD_DISTANCE * force * (p.platform_compliance + 1.0 / machine.PAD_YAW_STIFFNESS)

    def pointed_at(self, estimate: clearance.MisalignmentEstimate, x: float) -> tuple[float, float]:
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

    def settle(self, estimate: clearance.MisalignmentEstimate) -> clearance.MisalignmentEstimate:
        """Use the estimate made with the arm at ease, and return it as `combined`."""
        self._load = estimate.horizontal
        return self.combined(estimate)

    def _foreseen(self, electrodes: observation.ElectrodePose | None) -> AlongFilter:
        """Return the filter before contact: with the place if known, and the load bias expected from the yaw."""
        (yaw, stddev), share, per_yaw = self._yaw, self._share, LOAD_PER_YAW
        spread = per_yaw * math.hypot(share.value * stddev, share.stddev * yaw)
        place = math.nan if electrodes is None else electrodes.position[0]
        return AlongFilter(self._parameters, place, self._parameters.place_stddev, per_yaw * share.value * yaw, spread)

    def combined(self, estimate: clearance.MisalignmentEstimate, later: bool = False) -> clearance.MisalignmentEstimate:
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
        shifted = clearance.pitch_shift(
            replace(estimate, pitch_stddev=0.0)
        )  # what a known pitch adds to the pads' own error
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


def _along_ridges(electrodes: observation.ElectrodePose, usual_yaw: float, usual_pitch: float) -> tuple[float, float]:
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
