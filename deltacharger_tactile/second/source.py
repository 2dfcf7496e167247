# SPDX-License-Identifier: Apache-2.0
"""The tactile arrays of a simulated charger by the second contact physics, sampled by a world."""

from __future__ import annotations

import functools

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_tactile.second.device import Device, Touches
from deltacharger_tactile.second.equilibrium import Equilibrium
from deltacharger_tactile.second.parameters import SecondParameters
from deltacharger_tactile.second.sheet import SheetSensor

Pose = tuple[float, float, float]


@functools.lru_cache(maxsize=4)
def _model(parameters: SecondParameters) -> Equilibrium:
    """Return the model of these parameters, which dockings share."""
    return Equilibrium(parameters)


class SecondSource:
    """Both pads of one rig as a world that knows pose and force sees them; stands where a ContactSource stands.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose (to which the
    world has added the returned jitter) until `sample` is called with None. Not safe for threads.

    Frames that nobody reads may be left out, up to this: between two frames the pads have borne what the later one
    finds, nothing before the first of a contact; so creep of an unread change of force is off by what its part of the
    pause tells, and a force that rose and fell unread leaves no loop in the hysteresis. Times that do not rise pass
    nothing.

    Args:
        parameters: family of rigs; None = defaults.
        rig_seed: which device (gains, offsets, dead taxels, ridges, line of action, leans).
        seed: course of the run (jitter, leans, repeatability, noise).
    """

    def __init__(self, parameters: SecondParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        self.parameters = parameters or SecondParameters()
        self.rig = Device.draw(self.parameters, rig_seed)
        self._random = np.random.default_rng([0x2E0, rig_seed, seed])
        self._sensor = SheetSensor(self.parameters.sheet, self.rig.sheets, self._random)
        self._touch: Touches | None = None
        self._fresh = True  # whether nothing of this contact has been read
        self._last: float | None = None
        self._pressed: tuple[tuple[Pose, float, float], Array] | None = None  # by what, and what the taxels bear

    def begin_docking(self) -> Pose:
        """Start a new contact: draw its jitter, leans and repeatability.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._touch = Touches.draw(self.parameters, self._random)
        self._release()
        x, y, angle = self._touch.jitter[0]
        return float(x), float(y), float(angle)

    def sample(self, time: float, pose: Pose | None, force: float, share: float = 0.5) -> tuple[Array, Array]:
        """Read both pads once.

        Args:
            time: s, rising.
            pose: (x m, y m, angle rad) of the target in end_effector, jitter included; None = no contact.
            force: total contact force, N, of which bars bear a part.
            share: of the force that the left pad would bear if pads alone bore it.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        left, right = self.frames(time, pose, force, 1, 0.0, share)[0]
        return left, right

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, share: float = 0.5
    ) -> Array:
        """Return `count` frames (count, 2, 10, 10) N raw that end at `time`, a `period` (s) apart, all at one pose.

        Args:
            time: of the last frame, s, rising.
            pose: as of `sample`.
            force: total contact force, N.
            count: frames.
            period: between them, s.
            share: as of `sample`.
        """
        pressed = self._press(pose, force, share)
        repeat = 1.0 if self._touch is None else self._touch.repeat
        first = time - (count - 1) * period
        passed = 0.0 if self._last is None else first - self._last
        self._last = time if self._last is None else max(time, self._last)
        if pressed is None or self._fresh:
            self._sensor.pass_time(passed)
        else:
            self._sensor.pass_time(passed, pressed, repeat)
        self._fresh = pressed is None
        return np.asarray(self._sensor.read(pressed, repeat, count, period)[:, 0])

    def _release(self) -> None:
        self._sensor.pass_time(0.0)
        self._fresh, self._pressed = True, None

    def _press(self, pose: Pose | None, force: float, share: float) -> Array | None:
        """Return what the taxels bear (1, 2, 10, 10) N; None where nothing touches."""
        if pose is None:
            self._touch = self._pressed = None
            return None
        if not force > 0.0:
            return None
        if self._touch is None:
            self._touch = Touches.draw(self.parameters, self._random)
        if self._pressed is None or self._pressed[0] != (pose, force, share):  # at rest all frames have one
            model = _model(self.parameters)
            self._pressed = (pose, force, share), self._touch.press(model, self.rig, np.array([pose]), force, share)
        return self._pressed[1]
