# SPDX-License-Identifier: Apache-2.0
"""Changes to the estimates of one docking, and the record of them with the truth."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, replace

from deltacharger_docking.clearance import MisalignmentEstimate
from deltacharger_docking.observation import Reply, Service
from deltacharger_lab.campaigns import keys, parts
from deltacharger_sim.virtual.virtual_charger import VirtualCharger

AXES = ("horizontal", "vertical", "angle")


class EstimateLog:
    """Intercepts the estimates on their way to docking: adds the drawn errors, and keeps the first and the last.

    Args:
        charger: source of the estimates.
        errors: to add.
        seed: of the docking.

    Attributes:
        count: estimates so far.
        first, last: of the estimates in contact, compared with the truth; None before it.
        frozen: whether to keep no later ones.
    """

    def __init__(self, charger: VirtualCharger, errors: keys.EstimatorErrors, seed: int) -> None:
        self._charger = charger
        self._errors = errors
        self._noise = random.Random(f"{seed} estimator")
        self._tail = random.Random(f"{seed} estimator.tail")
        self.count = 0
        self.first: Kept | None = None
        self.last: Kept | None = None
        self.frozen = False
        if errors.paper:
            from deltacharger_lab.campaigns.published import PaperClasses

            charger.model = PaperClasses()
        elif errors.model == parts.FROM_ONE_NEWTON:
            charger.model = parts.pose_model_from_one_newton()
        charger.answer[Service.ESTIMATE] = self._answer

    def _answer(self, reply: Reply) -> Reply | None:
        if reply.estimate is None:
            return reply
        world = self._charger.world
        truth = world.misalignment
        estimate = self._spoil(reply.estimate, truth)
        if not self.frozen:
            self.count += 1
            if truth is not None:
                self.last = Kept.of(estimate, truth, world.snapshot().clearance)
                self.first = self.first or self.last
        return replace(reply, estimate=estimate)

    def _spoil(self, estimate: MisalignmentEstimate, truth: tuple[float, float, float] | None) -> MisalignmentEstimate:
        wrong = self._errors
        gauss = self._noise.gauss
        noise = [wrong.position_stddev * gauss(0.0, 1.0), wrong.position_stddev * gauss(0.0, 1.0)]
        noise += [wrong.angle_stddev * gauss(0.0, 1.0)]
        values = {axis: getattr(estimate, axis) for axis in (*AXES, "across")}
        if wrong.tail is not None and truth is not None:
            x, y, angle = truth
            cosine, sine = math.cos(angle), math.sin(angle)
            for axis, real in (("horizontal", x), ("across", y * cosine - x * sine), ("angle", angle)):
                values[axis] = real + getattr(estimate, f"{axis}_stddev") * self._student(wrong.tail)
            values["vertical"] = (values["across"] + values["horizontal"] * sine) / cosine
        off = [getattr(wrong, f"bias_{axis}") + more for axis, more in zip(AXES, noise, strict=True)]
        moved = {axis: values[axis] + more for axis, more in zip(AXES, off, strict=True)}
        moved["across"] = values["across"] + off[1] * math.cos(estimate.angle) - off[0] * math.sin(estimate.angle)
        spread = {name: wrong.stddev_scale * getattr(estimate, name) for name in (f"{axis}_stddev" for axis in values)}
        return replace(estimate, **moved, **spread)

    def _student(self, freedom: float) -> float:
        """Return a draw of Student's t, scaled to variance 1."""
        chi = self._tail.gammavariate(0.5 * freedom, 2.0)
        return self._tail.gauss(0.0, 1.0) * math.sqrt((freedom - 2.0) / max(chi, 1e-300))


@dataclass(frozen=True)
class Kept:
    """An estimate and the truth at its time: by axis error and standard deviation (m, m, rad).

    Attributes:
        across_stddev: reported standard deviation across the bars, m.
        clearance: true one, m.
    """

    error: Mapping[str, float]
    stddev: Mapping[str, float]
    across_stddev: float
    clearance: float

    @classmethod
    def of(cls, estimate: MisalignmentEstimate, truth: tuple[float, float, float], clearance: float) -> Kept:
        """Compare an estimate with the pose of the target in end_effector (m, m, rad)."""
        errors = {axis: getattr(estimate, axis) - real for axis, real in zip(AXES, truth, strict=True)}
        stddevs = {axis: getattr(estimate, f"{axis}_stddev") for axis in AXES}
        return cls(errors, stddevs, estimate.across_stddev, clearance)
