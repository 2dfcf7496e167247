# SPDX-License-Identifier: Apache-2.0
"""Place of the target along its bars, estimated although a lean loads the pads like an offset.

A single contact cannot distinguish an offset x along the bars from a lean of the faces. The pads' loads give h = x + L,
with a load bias L that all contacts on one target share. The contact force depends on x alone, because the magnets'
part of it decreases with the distance of the centres. So contacts at different places of the platform give both.

For a given place of the target, all else is normal and linear. All contacts share the load bias, the gain error of h,
and the scale errors of the pads' force, of the magnets and of their width. Each contact has its own landing error
beside the commanded place (`docking_jitter`), which encoders do not see. So the likelihood of a place is a normal
density. It is calculated on a grid of places, since it can have two peaks: the force is even in x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_docking.magnet_pull import MagnetPull
from deltacharger_docking.parameters import DockingParameters
from deltacharger_docking.place import Offset, contradicts, expected_gain

_HALF_WIDTH, _POINTS = 0.024, 65  # m around the expected place; number of places of the grid
_NEGLIGIBLE = 1e-6  # weight of a place
_LEAST = 1e-12  # m²


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
    """

    platform: float
    load: float
    load_stddev: float
    force: float
    force_stddev: float
    push: float
    across: float
    angle: float


@dataclass(frozen=True)
class Plan:
    """Expected gain of one or more further contacts.

    Attributes:
        gain: expected decrease of the risk of exceeding the limit.
        contacts: their number; the last one is made at the target and remains.
        aside: offset of the target's centre in the first contact, m along the bars; 0 = at the target.
    """

    gain: float
    contacts: int
    aside: float = 0.0


def empty_pad_offset(parameters: DockingParameters, force: float) -> float:
    """Return the offset by load (m) from which a contact under this force (N) leaves a pad almost empty."""
    p = parameters
    return p.load_share_max * force * p.pad_distance / p.pad_yaw_stiffness * p.load_per_yaw


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
        p = parameters
        self._parameters, self._pull = p, MagnetPull(p)
        self._foreseen, self._foreseen_stddev, self._bias = place, place_stddev, bias
        shared = math.hypot(bias_stddev, p.horizontal_shared)
        self._prior = np.array([shared, p.gain_error, p.force_error, p.magnet_error, p.magnet_width_error]) ** 2
        self._looks: list[LookAlong] = []
        self._weights, self._means, self._spread = np.ones(1), np.full(1, math.nan), math.inf
        self._innovations = 0.0
        self.target = math.nan
        self.bias, self.bias_stddev = bias, shared

    def update(self, look: LookAlong, again: bool = False) -> None:
        """Add the measurements of one contact; `again`: they replace the last ones."""
        self._looks[-1 if again else len(self._looks) :] = [look]
        places = self._grid()
        rows, residual, noise, landing = self._rows(places)
        joint = np.einsum("gik,k,gjk->gij", rows, self._prior, rows) + noise
        last = np.zeros_like(residual)
        last[:, -2:] = landing[:, -2:]
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
        variance = self._parameters.docking_jitter**2
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
        return contradicts(self._parameters, self._innovations, 2 * len(self._looks))

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
        far, near = self._parameters.probe_offset, 0.5 * self._parameters.probe_offset
        plans = []
        for way in ((), (far,), (-far,), (near,), (-near,), (far, -far), (-far, far)):
            if any(self._empties(aside) for aside in way):
                continue
            after = known
            for aside in way:
                rows, noise, landing = self._foresee(aside)
                after = after + rows.T @ np.linalg.solve(noise + np.outer(landing, landing), rows)
            foreseen, measured = self._landing(after)
            plans.append(Plan(expected_gain(now, foreseen, measured, limit), len(way) + 1, way[0] if way else 0.0))
        return plans

    def _empties(self, aside: float) -> bool:
        """Return whether a contact with the target's centre `aside` m off would leave a pad almost empty."""
        pull, _, _ = self._pull.at(np.array(aside), 0.0, self._looks[-1].angle)
        return abs(self.bias + aside) > empty_pad_offset(self._parameters, float(pull) + self._looks[-1].push)

    def _grid(self) -> Array:
        """Return the places (G,) of the grid, m."""
        first = self._looks[0]
        middle = self._foreseen if math.isfinite(self._foreseen) else first.platform + first.load - self._bias
        return middle + _HALF_WIDTH * np.linspace(-1.0, 1.0, _POINTS)

    def _rows(self, places: Array) -> tuple[Array, Array, Array, Array]:
        """Return rows (G, 2N, 5) of all contacts, residuals, noise, and the landing's part (G, 2N) for each place."""
        count, jitter = len(self._looks), self._parameters.docking_jitter
        rows = np.zeros((len(places), 2 * count, 5))
        residual, landing = np.zeros((2, len(places), 2 * count))
        noise = np.zeros((len(places), 2 * count, 2 * count))
        for index, look in enumerate(self._looks):
            load, force = 2 * index, 2 * index + 1
            x = places - look.platform
            pull, slope, by_width = self._pull.at(x, look.across, look.angle)
            rows[:, load, 0], rows[:, load, 1] = 1.0, x
            rows[:, force, 2], rows[:, force, 3], rows[:, force, 4] = pull + look.push, pull, by_width
            residual[:, load] = look.load - x - self._bias
            residual[:, force] = look.force - pull - look.push
            landing[:, load], landing[:, force] = 1.0, slope
            part = landing[:, load : force + 1]
            block = jitter**2 * part[:, :, None] * part[:, None, :]
            block[:, 0, 0] += look.load_stddev**2
            block[:, 1, 1] += look.force_stddev**2
            noise[:, load : force + 1, load : force + 1] = block
        return rows, residual, noise, landing

    def _information(self) -> Array:
        """Return the inverse covariance (6, 6) of place and shared errors, linearized at the estimated place."""
        place = 1.0 / self._foreseen_stddev**2 if math.isfinite(self._foreseen) else 0.0
        known = np.diag([place, *1.0 / np.maximum(self._prior, _LEAST)])
        rows, _, noise, landing = self._rows(np.array([self.target]))
        for index in range(len(self._looks)):
            part = slice(2 * index, 2 * index + 2)
            full = np.column_stack([landing[0, part], rows[0, part]])
            known = known + full.T @ np.linalg.solve(noise[0, part, part], full)
        return known

    def _foresee(self, aside: float) -> tuple[Array, Array, Array]:
        """Return rows (2, 6), noise (2, 2) and landing (2,) of a contact `aside` m off the target's centre."""
        last = self._looks[-1]
        pull, slope, by_width = (float(each) for each in self._pull.at(np.array(aside), 0.0, last.angle))
        landing = np.array([1.0, slope])
        shared = [[1.0, aside, 0.0, 0.0, 0.0], [0.0, 0.0, pull + last.push, pull, by_width]]
        noise = np.diag([last.load_stddev**2, last.force_stddev**2])
        return np.column_stack([landing, shared]), noise, landing * self._parameters.docking_jitter

    def _landing(self, known: Array) -> tuple[float, float]:
        """Return the variance (m²) of the offset of a contact at the target, before and after it is measured."""
        rows, noise, _ = self._foresee(0.0)
        covariance = np.zeros((7, 7))
        covariance[:6, :6] = np.linalg.inv(known)
        covariance[6, 6] = self._parameters.docking_jitter**2
        full = np.column_stack([rows, rows[:, 0]])
        offset = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        seen = covariance @ full.T
        left = covariance - seen @ np.linalg.solve(full @ seen + noise, seen.T)
        return float(offset @ covariance @ offset), max(float(offset @ left @ offset), _LEAST)
