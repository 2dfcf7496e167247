# SPDX-License-Identifier: Apache-2.0
"""Pressure of the target's ridges on the taxels of both pads.

A rigid end effector meets one rigid horizontal ridge per pad. The common approach z is where the pressures of both pads
carry the total force. An elastic half-space spreads them onto the taxels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deltacharger_core import arrays, machine
from deltacharger_tactile.parameters import PadContactParameters

WAVES = 3
"""Sinusoids per ridge."""

_MISSED = 1.0
"""Gap (m) of a point beyond the ridge: far more than any indentation."""
_CHUNK = 128


@dataclass(frozen=True)
class Waviness:
    """Height error of both ridges along their length, positive away from the pad.

    Attributes:
        amplitude: (2, WAVES), m.
        number: (2, WAVES), wave number, rad/m.
        phase: (2, WAVES), rad.
    """

    amplitude: arrays.Array
    number: arrays.Array
    phase: arrays.Array

    @staticmethod
    def draw(parameters: PadContactParameters, random: np.random.Generator) -> Waviness:
        """Draw the ridges of one rig with the rms of the parameters."""
        amplitude = np.full((machine.PADS, WAVES), parameters.waviness * np.sqrt(2.0 / WAVES))
        length = random.uniform(0.008, 0.040, (machine.PADS, WAVES))
        return Waviness(amplitude, 2.0 * np.pi / length, random.uniform(0.0, 2.0 * np.pi, (machine.PADS, WAVES)))


class ContactModel:
    """Contact of ridge and pad for a family of rigs; immutable, so threads may share it."""

    def __init__(self, parameters: PadContactParameters | None = None) -> None:
        self.parameters = parameters or PadContactParameters()
        self._u, self._v = _sample_points(self.parameters)
        self._pooling = _pooling_matrix(self.parameters)
        side = self.parameters.pad_side / (machine.ROWS * self.parameters.sub_samples)
        self._unit = self.parameters.stiffness * side * side
        centre = self.parameters.pad_distance
        self._x = np.stack([self._u + centre, self._u - centre])
        self._centre = np.array([[centre], [-centre]])

    def solve(
        self,
        pose: ArrayLike,
        force: ArrayLike,
        tilt: ArrayLike = (0.0, 0.0),
        waviness: Waviness | None = None,
    ) -> arrays.Array:
        """Compute the readings of the pressed pads.

        Args:
            pose: (N, 3) or (3,) misalignment (x, y, angle), m and rad: pose of the target in end_effector.
            force: (N,) or scalar, total contact force, N; if it is not positive, readings are 0.
            tilt: (N, 2) or (2,) rad: (about x: indents +y more, about y: indents +x more).
            waviness: ridges of the rig; None = perfectly straight.

        Returns:
            (N, 2, 10, 10) N; pad 0 is left (+x); row 0 at +y, column 0 at +x. Their sum is the total force, or 0 if
            both pads miss the ridges.
        """
        poses = np.atleast_2d(np.asarray(pose, dtype=float))
        count = len(poses)
        forces = np.broadcast_to(np.asarray(force, dtype=float), (count,))
        tilts = np.broadcast_to(np.asarray(tilt, dtype=float), (count, 2))
        taxels = np.zeros((count, machine.PADS, machine.ROWS, machine.COLUMNS))
        for start in range(0, count, _CHUNK):
            part = slice(start, start + _CHUNK)
            taxels[part] = self._press(poses[part], forces[part], tilts[part], waviness)
        return taxels

    def _press(
        self, pose: arrays.Array, force: arrays.Array, tilt: arrays.Array, waviness: Waviness | None
    ) -> arrays.Array:
        count = len(pose)
        height = self._height(pose, tilt, waviness)
        highest = height.max(axis=1)
        pressed = (highest > -0.5 * _MISSED) & (force > 0.0)
        taxels = np.zeros((count, machine.PADS, machine.ROWS, machine.COLUMNS))
        if pressed.any():
            chosen = height if pressed.all() else height[pressed]
            depth = self._carry(chosen, highest[pressed], force[pressed])
            load = self._unit * depth * (1.0 + depth / self.parameters.hardening)
            spread = load.reshape(-1, load.shape[1] // machine.PADS) @ self._pooling.T
            taxels[pressed] = spread.reshape(-1, machine.PADS, machine.ROWS, machine.COLUMNS)
        return taxels

    def _height(self, pose: arrays.Array, tilt: arrays.Array, waviness: Waviness | None) -> arrays.Array:
        """(N, 1800) how far the ridge stands out toward each point of both pads, m."""
        x, y, angle = (pose[:, i, None, None] for i in range(3))
        cosine, sine = np.cos(angle), np.sin(angle)
        dx, dy = self._x - x, self._v - y
        qx = cosine * dx + sine * dy - self._centre
        qy = cosine * dy - sine * dx
        gap = self._gap(qx, qy)
        if waviness is not None and self.parameters.waviness > 0.0:
            for wave in range(WAVES):
                phase = waviness.number[:, wave, None] * qx + waviness.phase[:, wave, None]
                gap += waviness.amplitude[:, wave, None] * np.sin(phase)
        height = tilt[:, 0, None, None] * self._v + tilt[:, 1, None, None] * self._x - gap
        return np.asarray(height.reshape(len(pose), -1))

    def _gap(self, qx: arrays.Array, qy: arrays.Array) -> arrays.Array:
        p = self.parameters
        radius = p.edge_radius
        across, along = np.abs(qy), np.abs(qx)
        gap = qy * qy * (0.5 / p.crown_radius)
        for distance, half in ((across, 0.5 * p.ridge_height), (along, 0.5 * p.ridge_length)):
            inside = np.maximum(distance - (half - radius), 0.0)
            gap += radius - np.sqrt(np.maximum(radius * radius - inside * inside, 0.0))
            gap += (inside > radius) * _MISSED
        if p.hole > 0.0:
            gap += (qx * qx + qy * qy < 0.25 * p.hole * p.hole) * _MISSED
        return np.asarray(gap)

    def _carry(self, height: arrays.Array, highest: arrays.Array, force: arrays.Array) -> arrays.Array:
        """Return the indentations. The approach is found by Newton's method.

        The force is convex in it, so steps from above never overshoot.
        """
        hardening = self.parameters.hardening
        target = force / self._unit
        approach = 3e-4 - highest
        for _ in range(60):
            depth = np.maximum(approach[:, None] + height, 0.0)
            first = depth.sum(axis=1)
            carried = first + np.einsum("ij,ij->i", depth, depth) / hardening
            slope = np.count_nonzero(depth, axis=1) + 2.0 * first / hardening
            step = (carried - target) / slope
            approach = np.maximum(approach - step, 1e-9 - highest)
            if np.all(np.abs(step) <= 1e-13):
                break
        return np.maximum(approach[:, None] + height, 0.0)


def _sample_points(parameters: PadContactParameters) -> tuple[arrays.Array, arrays.Array]:
    """Sub-sample coordinates (900,) in the pad: row-major from +y, columns from +x."""
    count = machine.ROWS * parameters.sub_samples
    line = parameters.pad_side * (0.5 - (np.arange(count) + 0.5) / count)
    v, u = np.meshgrid(line, line, indexing="ij")
    return u.ravel(), v.ravel()


def _pooling_matrix(parameters: PadContactParameters) -> arrays.Array:
    """(100, 900) share of each sub-sample's force on each taxel; columns sum to 1: no force is lost.

    Kernel of an elastic half-space at depth h under a point load (Boussinesq): 3 h³ / (2π (r² + h²)^2.5). What
    would leave the pad is distributed over its taxels.
    """
    u, v = _sample_points(parameters)
    squared = (u[:, None] - u) ** 2 + (v[:, None] - v) ** 2
    depth = parameters.spread_depth
    kernel = 3.0 * depth**3 / (2.0 * np.pi * (squared + depth * depth) ** 2.5)
    fine = parameters.sub_samples
    pooled = (
        kernel.reshape(machine.ROWS, fine, machine.COLUMNS, fine, -1)
        .sum(axis=(1, 3))
        .reshape(machine.ROWS * machine.COLUMNS, -1)
    )
    return np.asarray(pooled / pooled.sum(axis=0))
