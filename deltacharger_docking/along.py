# SPDX-License-Identifier: Apache-2.0
"""Place of the target along its bars, estimated although a lean loads the pads like an offset.

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

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_core.machine import DOCKING_JITTER, PAD_DISTANCE, PAD_YAW_STIFFNESS
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.place import GAIN_ERROR, Offset, contradicts, expected_gain

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
_LEAST = 1e-12  # m²
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
    return _LOAD_SHARE_MAX * force * PAD_DISTANCE / PAD_YAW_STIFFNESS * LOAD_PER_YAW


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
        variance = DOCKING_JITTER**2
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

    def _grid(self) -> Array:
        """Return the places (G,) of the grid, m."""
        first = self._looks[0]
        middle = self._foreseen if math.isfinite(self._foreseen) else first.platform + first.load - self._bias
        return middle + _HALF_WIDTH * np.linspace(-1.0, 1.0, _POINTS)

    def _rows(self, places: Array, looks: list[LookAlong]) -> tuple[Array, Array, Array, Array]:
        """Return rows (G, 3N, 6) of contacts, residuals, noise, and the landing's part (G, 3N) for each place."""
        size, jitter = _EACH * len(looks), DOCKING_JITTER
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

    def _information(self) -> Array:
        """Return the inverse covariance (7, 7) of place and shared errors, linearized at the estimated place."""
        place = 1.0 / self._foreseen_stddev**2 if math.isfinite(self._foreseen) else 0.0
        known = np.diag([place, *1.0 / np.maximum(self._prior, _LEAST)])
        return known + sum(map(self._informs, self._looks))

    def _linear(self, look: LookAlong) -> tuple[Array, Array, Array]:
        """Return rows (3, 7) by place and shared errors, noise (3, 3) and landing (3,) of a contact on the target."""
        rows, _, noise, landing = self._rows(np.array([self.target]), [look])
        return np.column_stack([landing[0] + [0.0, 0.0, look.draw_share], rows[0]]), noise[0], landing[0]

    def _informs(self, look: LookAlong) -> Array:
        rows, noise, _ = self._linear(look)
        return rows.T @ np.linalg.solve(noise, rows)

    def _expected(self, aside: float) -> LookAlong:
        """Return what a contact commanded `aside` m off the target's centre would be."""
        last = self._looks[-1]
        drawn = last.draw_share * aside
        return replace(last, platform=self.target - aside + drawn, across=0.0, drawn=drawn)

    def _landing(self, known: Array) -> tuple[float, float]:
        """Return the variance (m²) of the offset of a contact at the target, before and after it is measured."""
        look, jitter = self._expected(0.0), DOCKING_JITTER**2
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
