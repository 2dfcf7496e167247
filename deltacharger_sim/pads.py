# SPDX-License-Identifier: Apache-2.0
"""The pads of a simulated charger: what a world asks of them, one rig's sensor, and data sets of dockings.

From force on a taxel to the board's reading: one rig's sensor, stateful for the world, batched for data sets.
Order: hysteresis, creep, gain spread, cross-talk, offsets, noise, clip, quantisation, dead taxels.

Data sets from the contact and sensor models: the paper's two protocols and a continuous, signed one.
A row is one docking (attempt): commanded pose, pose in contact (commanded plus jitter), and both pads averaged over
`frames` frames, tared, clipped at 0 as the board does, and thresholded.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_tactile import dataset, errors
from deltacharger_tactile.contact import ContactModel, Waviness
from deltacharger_tactile.parameters import (
    ANGLE_CLASSES,
    ANGLE_LIMIT,
    POSITION_CLASSES,
    POSITION_LIMIT,
    SHAPE,
    PadContactParameters,
    PadDockingParameters,
    SensorParameters,
    TactileParameters,
)

Pose = tuple[float, float, float]
Turn = tuple[float, float]  # rad about x and about y


class Lean(NamedTuple):
    """Lean of the platform relative to its target: right-handed turns about x and y of end_effector.

    Attributes:
        residual: rad, with all moments in balance; affects the taxels.
        free: rad, without any moment.
    """

    residual: Turn = (0.0, 0.0)
    free: Turn = (0.0, 0.0)


def approach(turn: Turn) -> arrays.Array:
    """Convert a turn of a lean to the signs of contact models (2,), rad: about x brings +y closer, about y +x.

    A right-handed turn about y moves +x away.
    """
    about_x, about_y = turn
    return np.array([about_x, -about_y])


class PadSource(ABC):
    """Both pads of one rig, for a world that knows pose and force.

    One docking is one contact: `begin_docking` at its first touch, then `sample` with the relative pose plus the
    returned jitter, until `sample` with None ends it. Not thread-safe: the world's lock protects it.

    Args:
        random: source of all random values.
    """

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random
        self._contact: Any = None
        self._last: float | None = None  # s, time of the last frame
        self._pressed: tuple[tuple[Pose, float, Lean | None], arrays.Array] | None = (
            None  # arguments and forces on taxels
        )

    def begin_docking(self) -> Pose:
        """Start a new contact with new random values.

        Returns:
            Displacement (x m, y m, angle rad) to add to the relative pose until contact ends.
        """
        self._end_contact()
        self._contact = self._draw()
        x, y, angle = self._contact.jitter[0]
        return float(x), float(y), float(angle)

    def sample(
        self, time: float, pose: Pose | None, force: float, lean: Lean | None = None
    ) -> tuple[arrays.Array, arrays.Array]:
        """Read both pads once; arguments as in `frames`.

        Returns:
            left, right: (10, 10) N raw (before tare; NaN = dead); row 0 at +y, column 0 at +x.
        """
        left, right = self.frames(time, pose, force, 1, 0.0, lean)[0]
        return left, right

    @abstractmethod
    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> arrays.Array:
        """Return `count` frames (count, 2, 10, 10) N raw at one pose, `period` (s) apart, the last at `time`.

        Args:
            time: of the last frame, s, increasing.
            pose: (x m, y m, angle rad) of the target in end_effector, including jitter; None = no contact.
            force: total contact force, N; electrode bars carry part of it, if the physics has them.
            count: number of frames.
            period: s between frames.
            lean: of the platform against the target; None = flat.
        """

    @abstractmethod
    def _draw(self) -> Any:
        """Draw a new contact, whose `jitter` (N, 3) displaces the relative pose (x, y, angle), m and rad."""

    @abstractmethod
    def _solve(self, contact: Any, pose: arrays.Array, force: float, lean: Lean | None) -> arrays.Array:
        """Return the forces on the taxels (1, 2, 10, 10) N at a pose (1, 3)."""

    def _end_contact(self) -> None:
        self._contact = self._pressed = None

    def _press(self, pose: Pose | None, force: float, lean: Lean | None) -> arrays.Array | None:
        """Return the forces on the taxels (1, 2, 10, 10) N; None without contact."""
        if pose is None:
            self._end_contact()
            return None
        if not force > 0.0:
            return None
        if self._contact is None:
            self._contact = self._draw()
        if self._pressed is None or self._pressed[0] != (pose, force, lean):  # unchanged at rest
            self._pressed = (pose, force, lean), self._solve(self._contact, np.array([pose]), force, lean)
        return self._pressed[1]


@dataclass(frozen=True)
class Rig:
    """Constant properties of one device and its target.

    Attributes:
        gain: (2, 10, 10) relative gain of each taxel.
        offset: (2, 10, 10) N, removed by a tare.
        dead: (2, 10, 10) taxels that read NaN.
        tilt: (2,) rad, constant tilt (about x, about y).
        magnets: relative strength of the magnets.
        waviness: the target's ridges.
    """

    gain: arrays.Array
    offset: arrays.Array
    dead: arrays.Mask
    tilt: arrays.Array
    magnets: float
    waviness: Waviness

    @staticmethod
    def draw(parameters: TactileParameters, seed: int) -> Rig:
        """Draw a device; the same seed gives the same device."""
        random = np.random.default_rng([0x7A9, seed])
        sensor, docking = parameters.sensor, parameters.docking
        dead = np.zeros(machine.PADS * machine.ROWS * machine.COLUMNS, dtype=bool)
        dead[random.permutation(dead.size)[: sensor.dead_taxels]] = True
        return Rig(
            gain=np.clip(1.0 + sensor.gain_spread * random.standard_normal(SHAPE), 0.3, 2.0),
            offset=sensor.fixed_offset * np.clip(random.standard_normal(SHAPE), -3.0, 3.0),
            dead=dead.reshape(SHAPE),
            tilt=docking.tilt_bias * random.standard_normal(2),
            magnets=float(np.clip(1.0 + docking.magnet_spread * random.standard_normal(), 0.5, 1.5)),
            waviness=Waviness.draw(parameters.contact, random),
        )


@dataclass(frozen=True)
class Dockings:
    """Random values of N dockings.

    Attributes:
        jitter: (N, 3) displacement of the relative pose (x, y, angle), m and rad.
        tilt: (N, 2) rad, added to the rig's and to what the offset causes.
        tilt: (N, 2) rad, added to the tilts by the rig and by the offset.
        offset: (N, 2, 10, 10) N.
    """

    jitter: arrays.Array
    tilt: arrays.Array
    hysteresis: arrays.Array
    offset: arrays.Array

    @staticmethod
    def draw(parameters: TactileParameters, random: np.random.Generator, count: int = 1) -> Dockings:
        """Draw `count` dockings."""
        docking, sensor = parameters.docking, parameters.sensor
        spread = np.array([docking.position_jitter, docking.position_jitter, docking.angle_jitter])
        return Dockings(
            jitter=spread * random.standard_normal((count, 3)),
            tilt=docking.tilt_spread * random.standard_normal((count, 2)),
            hysteresis=np.clip(sensor.hysteresis * random.standard_normal((count, machine.PADS)), -0.5, 0.5),
            offset=sensor.docking_offset * random.standard_normal((count, *SHAPE)),
        )

    def tilts(self, parameters: TactileParameters, rig: Rig, pose: arrays.Array) -> arrays.Array:
        """Tilt (N, 2) of each docking at its pose (N, 3): off-centre contact tilts the end effector."""
        per = np.array([parameters.docking.tilt_per_y, parameters.docking.tilt_per_x])
        return np.asarray(rig.tilt + per * pose[:, 1::-1] + self.tilt)


class Sensor:
    """The electronics of one rig for N dockings at once: a deterministic part and noise with memory."""

    def __init__(self, parameters: SensorParameters, rig: Rig, random: np.random.Generator, count: int = 1) -> None:
        self._parameters = parameters
        self._rig = rig
        self._random = random
        self._slow = random.standard_normal((count, *SHAPE))
        self._levels = 2**parameters.bits - 1
        self._top = parameters.full_scale + parameters.pedestal
        self._share = (math.sqrt(1.0 - parameters.noise_memory), math.sqrt(parameters.noise_memory))

    def read(
        self, force: arrays.Array | None, docking: Dockings | None, contact_time: arrays.Array | float, step: float
    ) -> arrays.Array:
        """Read both pads once.

        Args:
            force: (N, 2, 10, 10) N on the taxels; None = no contact.
            docking: hysteresis and offsets of this contact; None = no contact.
            contact_time: s since contact began, (N,) or scalar.
            step: s since the last reading.

        Returns:
            (N, 2, 10, 10) N raw: with pedestal, offsets and noise; NaN where dead.
        """
        signal = self._respond(force, docking, contact_time)
        return self._digitise(signal + self._noise(force, (step,))[0])

    def course(
        self, force: arrays.Array | None, docking: Dockings | None, times: arrays.Array, steps: Sequence[float]
    ) -> arrays.Array:
        """Read both pads of one docking T times, like T calls of `read` but much faster.

        Args:
            force: (1, 2, 10, 10) N on the taxels, constant; None = no contact.
            docking: as in `read`.
            times: (T,) s since contact began.
            steps: (T,) s since the previous reading.

        Returns:
            (T, 2, 10, 10) N raw.
        """
        signal = self._respond(force, docking, times)
        return self._digitise(signal + self._noise(force, steps)[:, 0])

    def _respond(
        self, force: arrays.Array | None, docking: Dockings | None, contact_time: arrays.Array | float
    ) -> arrays.Array:
        p = self._parameters
        base = self._rig.offset + p.pedestal
        if docking is not None:
            base = base + docking.offset
        if force is None:
            return base
        creep = 1.0 + p.creep * np.log10(1.0 + np.maximum(contact_time, 0.0) / p.creep_time)
        factor = np.asarray(creep).reshape(-1, 1)
        if docking is not None:
            factor = factor * (1.0 + docking.hysteresis)
        signal = force * factor[:, :, None, None] * self._rig.gain
        # Sums are faster: means of so few numbers take half as long again.
        rows = np.add.reduce(signal, axis=-1, keepdims=True) / machine.COLUMNS
        columns = np.add.reduce(signal, axis=-2, keepdims=True) / machine.ROWS
        return np.asarray(signal + p.cross_talk * (rows + columns) + base)

    def _noise(self, force: arrays.Array | None, steps: Sequence[float]) -> arrays.Array:
        """Return the noise (T, N, 2, 10, 10) N of T readings."""
        p = self._parameters
        normal = self._random.standard_normal((len(steps), 2, *self._slow.shape))
        unit = self._share[0] * normal[:, 1]
        for step, fresh, now in zip(steps, normal[:, 0], unit, strict=True):
            keep = math.exp(-max(step, 0.0) / p.noise_time)
            self._slow *= keep
            self._slow += math.sqrt(1.0 - keep * keep) * fresh
            now += self._share[1] * self._slow
        return np.asarray(unit * (p.noise if force is None else p.noise + p.noise_gain * np.abs(force)))

    def _digitise(self, signal: arrays.Array) -> arrays.Array:
        """Quantise a signal (N) in place; NaN where a taxel is dead."""
        quantum = self._top / self._levels
        signal.clip(0.0, self._top, out=signal)
        signal /= quantum
        np.rint(signal, out=signal)
        signal *= quantum
        np.copyto(signal, np.nan, where=self._rig.dead)
        return signal


@functools.lru_cache(maxsize=8)
def _model(parameters: PadContactParameters) -> ContactModel:
    """Return the model of these dimensions, shared because its matrices cost more than a docking."""
    return ContactModel(parameters)


class ContactSource(PadSource):
    """Both pads of one rig in the first contact physics.

    A frame's noise correlates with the last one by the time between them, so unneeded frames may be skipped.

    Args:
        parameters: family of rigs; None = the defaults.
        rig_seed: of the device (gains, offsets, dead taxels, ridges).
        seed: of the run (jitter, tilt, hysteresis, offsets, noise).
    """

    def __init__(self, parameters: TactileParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        super().__init__(np.random.default_rng([0x50C, rig_seed, seed]))
        self.parameters = parameters or TactileParameters()
        self.rig = Rig.draw(self.parameters, rig_seed)
        self._sensor = Sensor(self.parameters.sensor, self.rig, self._random)
        self._model = _model(self.parameters.contact)  # now, as emulators must answer in time at the first touch
        self._began: float | None = None  # s, time of the first frame of this contact

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> arrays.Array:
        """Return frames (count, 2, 10, 10) N raw; arguments as in `PadSource.frames`."""
        pressed = self._press(pose, force, lean)
        times = time - period * np.arange(count - 1, -1, -1)
        if pressed is not None and self._began is None:
            self._began = float(times[0])
        first = 1.0 / machine.FRAME_RATE if self._last is None else float(times[0]) - self._last
        self._last = time
        in_contact = times - (times[0] if self._began is None else self._began)
        return self._sensor.course(pressed, self._contact, in_contact, (first, *[period] * (count - 1)))

    def _draw(self) -> Dockings:
        return Dockings.draw(self.parameters, self._random)

    def _end_contact(self) -> None:
        super()._end_contact()
        self._began = None

    def _solve(self, contact: Dockings, pose: arrays.Array, force: float, lean: Lean | None) -> arrays.Array:
        tilt = contact.tilts(self.parameters, self.rig, pose)
        if lean is not None:
            tilt = tilt + approach(lean.residual)
        return self._model.solve(pose, force, tilt, self.rig.waviness)


SESSIONS = 5
_TARE_FRAMES = 60
_CHUNK = 512


def generate_paper(
    parameters: TactileParameters | None = None,
    rigs: Sequence[int] = (0,),
    seed: int = 0,
    frames: int = 1,
    threshold: float = machine.CONTACT_FORCE,
) -> dataset.Dataset:
    """Generate the paper's protocol on each rig: 600 dockings by angle and 500 by position.

    Angle set: 0, 1, … 5° × 100 dockings. Start positions vary over ±20 mm in 4 mm steps; a tenth of that is assumed to
    remain. (The docked protocol records what they really leave.)
    Position set: 5 × 5 offsets × 20 dockings at zero angle.

    Args:
        parameters: family of rigs; None = the defaults.
        rigs: seeds of the devices.
        seed: seed of the dockings.
        frames: frames averaged per row; the paper has 1.
        threshold: lower readings are stored as 0, N.
    """
    random = np.random.default_rng([0x9A9E, seed])
    grid = np.array([(x, y) for x in POSITION_CLASSES for y in POSITION_CLASSES])
    poses, subset = (
        [],
        np.repeat([dataset.SUBSET_ANGLE, dataset.SUBSET_POSITION], [100 * ANGLE_CLASSES, 20 * len(grid)]),
    )
    for _ in rigs:
        classes = np.repeat(np.arange(ANGLE_CLASSES), 100)
        start = 0.1 * 0.004 * random.integers(-5, 6, (len(classes), 2))
        by_angle = np.column_stack([start, np.radians(classes)])
        by_position = np.column_stack([np.repeat(grid, 20, axis=0), np.zeros(20 * len(grid))])
        poses.append(np.concatenate([by_angle, by_position]))
    return _generate("paper", parameters, rigs, poses, subset, seed, frames, threshold)


def generate_continuous(
    parameters: TactileParameters | None = None,
    rigs: Sequence[int] = (0, 1, 2, 3, 4),
    count: int = 400,
    seed: int = 0,
    frames: int = 1,
    threshold: float = machine.CONTACT_FORCE,
    position_limit: float = POSITION_LIMIT,
    angle_limit: float = ANGLE_LIMIT,
) -> dataset.Dataset:
    """Generate signed poses, uniform over ±position_limit and ±angle_limit.

    Args:
        parameters: family of rigs; None = the defaults.
        rigs: seeds of the devices.
        count: dockings per rig.
        seed: seed of the dockings.
        frames: frames averaged per row.
        threshold: lower readings are stored as 0, N.
        position_limit: largest |x| and |y|, m.
        angle_limit: largest |angle|, rad.
    """
    random = np.random.default_rng([0xC047, seed])
    limit = np.array([position_limit, position_limit, angle_limit])
    poses = [random.uniform(-limit, limit, (count, 3)) for _ in rigs]
    subset = np.full(count, dataset.SUBSET_CONTINUOUS)
    return _generate("continuous", parameters, rigs, poses, subset, seed, frames, threshold)


def contact_force(
    parameters: PadDockingParameters, offset: arrays.Array, current: arrays.Array, magnets: float = 1.0
) -> arrays.Array:
    """Total contact force (N,), N: magnets, weaker with lateral offset (N, 2) m, plus the push of the servos."""
    squared = np.sum(offset * offset, axis=1) / parameters.magnet_width**2
    pull = parameters.magnet_force * magnets * np.maximum(parameters.magnet_floor, 1.0 / (1.0 + squared))
    return np.asarray(pull + parameters.push_per_ampere * current)


def _generate(
    protocol: str,
    parameters: TactileParameters | None,
    rigs: Sequence[int],
    poses: Sequence[arrays.Array],
    subset: NDArray[np.int64],
    seed: int,
    frames: int,
    threshold: float,
) -> dataset.Dataset:
    if not rigs or frames < 1:
        raise errors.DatasetError(protocol, f"{len(rigs)} rigs, {frames} frames; each must be at least 1")
    chosen = parameters or TactileParameters()
    parts = []
    for index, (rig_seed, pose) in enumerate(zip(rigs, poses, strict=True)):
        rig = Rig.draw(chosen, rig_seed)
        random = np.random.default_rng([0xD0C, seed, rig_seed])
        part = measure(chosen, rig, pose, random, frames, threshold)
        part["attempt"] = part["attempt"] + len(pose) * index
        part["session"] = part["session"] + SESSIONS * index
        part["rig"] = np.full(len(pose), rig_seed)
        part["subset"] = subset
        parts.append(part)
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    meta = {
        "version": dataset.VERSION,
        "protocol": protocol,
        "seed": seed,
        "rigs": list(rigs),
        "frames": frames,
        "rows": 1,
        "threshold": threshold,
        "parameters": json.loads(chosen.to_json()),
        "digest": chosen.digest(),
    }
    return dataset.Dataset(meta=meta, **joined)


def measure(
    parameters: TactileParameters,
    rig: Rig,
    pose: arrays.Array,
    random: np.random.Generator,
    frames: int,
    threshold: float,
    current: arrays.Array | None = None,
    lean: arrays.Array | None = None,
) -> dict[str, Any]:
    """Dock once at each commanded pose (N, 3); return a Dataset's columns without subset.

    `lean` (N, 2), rad: tilt about x and y of the resting platform, relative to the target; None = level.
    """
    count = len(pose)
    dockings = Dockings.draw(parameters, random, count)
    docking = parameters.docking
    if current is None:
        current = random.uniform(docking.current_low, docking.current_high, count)
    actual = pose + dockings.jitter
    push = current * np.exp(docking.push_spread * random.standard_normal(count))
    force = contact_force(docking, actual[:, :2], push, rig.magnets)
    dwell = random.uniform(0.3, 3.0, count)
    tares = np.stack([_tare(parameters, rig, random) for _ in range(SESSIONS)])
    session = random.integers(0, SESSIONS, count)
    model = ContactModel(parameters.contact)
    readings = np.empty((count, *SHAPE))
    for start in range(0, count, _CHUNK):
        part = slice(start, start + _CHUNK)
        chosen = Dockings(*(getattr(dockings, item.name)[part] for item in dataclasses.fields(Dockings)))
        tilt = chosen.tilts(parameters, rig, actual[part])
        if lean is not None:
            tilt = tilt + lean[part]
        taxels = model.solve(actual[part], force[part], tilt, rig.waviness)
        sensor = Sensor(parameters.sensor, rig, random, len(taxels))
        total = np.zeros(taxels.shape)
        for frame in range(frames):
            raw = sensor.read(taxels, chosen, dwell[part] + frame / machine.FRAME_RATE, 1.0 / machine.FRAME_RATE)
            total += np.maximum(raw - tares[session[part]], 0.0)
        readings[part] = total / frames
    dead = np.isnan(readings)
    cut = np.where(dead | (readings < threshold), 0.0, readings).astype(np.float32)
    return {
        "left": cut[:, 0],
        "right": cut[:, 1],
        "dead": dead,
        "tare": np.nan_to_num(tares[session]).astype(np.float32),
        "angle": pose[:, 2],
        "vertical": pose[:, 1],
        "horizontal": pose[:, 0],
        "contact_pose": actual,
        "attempt": np.arange(count),
        "session": session,
        "current": current,
        "force": force,
    }


def _tare(parameters: TactileParameters, rig: Rig, random: np.random.Generator) -> arrays.Array:
    sensor = Sensor(parameters.sensor, rig, random)
    frames = [sensor.read(None, None, 0.0, 1.0 / machine.FRAME_RATE)[0] for _ in range(_TARE_FRAMES)]
    return np.asarray(np.mean(frames, axis=0))
