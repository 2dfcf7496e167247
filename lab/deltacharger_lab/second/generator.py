# SPDX-License-Identifier: Apache-2.0
"""Data sets of the second contact physics, only for testing: nothing may be trained on them.

Each row is one docking with its own history: a tare within the first minute, a pause, another contact of the device
(which leaves creep and hysteresis), 5 to 60 s in free air, then this contact. It is pressed in steps to its force, a
little beyond and back, and read after 0.3 to 3 s.
"""

import functools
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_core import arrays, machine
from deltacharger_lab.second.device import Device, SheetSensor, Touches
from deltacharger_lab.second.equilibrium import Equilibrium
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.pads import Lean, PadSource, Pose, approach, contact_force
from deltacharger_tactile import dataset, errors

LONG_AGO, JUST_NOW = 1800.0, 20.0
"""Longest time from tare to contacts, s: in a session of many dockings, and in one docking."""
_TARE_FRAMES = 60
_CHUNK = 96
_RAMP = ((0.4, 0.3), (1.05, 0.1))  # steps before the contact: share of the force, duration in s


def dock_anew(
    known: dataset.Dataset,
    seed: int = 0,
    frames: int = 1,
    threshold: float = 0.0,
    since_tare: float = LONG_AGO,
    parameters: SecondParameters | None = None,
) -> dataset.Dataset:
    """Dock devices of the second physics at the commanded poses of a data set of the first physics.

    Args:
        known: one row per docking; its rigs' seeds are the devices' seeds.
        seed: of the dockings.
        frames: averaged per row.
        threshold: lower readings are stored as 0, N.
        since_tare: s, longest time from tare to contacts.
        parameters: family of devices; None = the defaults.

    Raises:
        DatasetError: a docking has several rows, or `frames` < 1.
    """
    if frames < 1 or len(np.unique(known.attempt)) != len(known):
        raise errors.DatasetError(
            "second physics", f"{frames} frames of {len(known)} rows; give 1 or more, a row a docking"
        )
    chosen = parameters or SecondParameters()
    pose = np.column_stack([known.horizontal, known.vertical, known.angle])
    columns: dict[str, list[NDArray[Any]]] = {}
    order: list[NDArray[np.int64]] = []
    model = Equilibrium(chosen)
    for rig in np.unique(known.rig):
        rows, device = np.flatnonzero(known.rig == rig), Device.draw(chosen, int(rig))
        random = np.random.default_rng([0x2DA, seed, int(rig)])
        for part in np.split(rows, range(_CHUNK, len(rows), _CHUNK)):
            order.append(part)
            for name, column in _measure(model, device, pose[part], random, frames, since_tare).items():
                columns.setdefault(name, []).append(column)
    back = np.argsort(np.concatenate(order))
    found: dict[str, NDArray[Any]] = {name: np.concatenate(parts)[back] for name, parts in columns.items()}
    readings = found.pop("readings")
    dead = np.isnan(readings)
    cut = np.where(dead | (readings < threshold), 0.0, readings).astype(np.float32)
    same = {name: getattr(known, name) for name in ("angle", "vertical", "horizontal", "attempt", "rig", "subset")}
    meta = {
        "version": dataset.VERSION, "protocol": "second physics", "seed": seed, "frames": frames,
        "threshold": threshold,
        "parameters": json.loads(chosen.to_json()), "digest": chosen.digest(),
    }  # fmt: skip
    return dataset.Dataset(
        meta=meta, left=cut[:, 0], right=cut[:, 1], dead=dead, session=known.attempt, **same, **found
    )


def _measure(
    model: Equilibrium, device: Device, pose: arrays.Array, random: np.random.Generator, frames: int, since_tare: float
) -> dict[str, NDArray[Any]]:
    """Dock once at each commanded pose (N, 3); returns columns of a data set, and readings (N, 2, 10, 10) N."""
    count, docking = len(pose), model.parameters.docking
    touches = Touches.draw(model.parameters, random, count)
    actual = pose + touches.jitter
    current = random.uniform(docking.current_low, docking.current_high, count)
    push = current * np.exp(docking.push_spread * random.standard_normal(count))
    force = contact_force(docking, actual[:, :2], push, device.magnets)
    taxels = touches.press(model, device, actual, force)
    sensor = SheetSensor(model.parameters.sheet, device.sheets, random, count)
    sensor.pass_time(random.uniform(0.0, 60.0, count))
    tare = sensor.read(None, 1.0, _TARE_FRAMES, 1.0 / machine.FRAME_RATE).mean(axis=0)
    sensor.pass_time(random.uniform(0.0, since_tare, count))
    other = random.permutation(count)
    sensor.pass_time(random.uniform(2.0, 20.0, count), taxels[other], touches.repeat[other])
    sensor.pass_time(random.uniform(5.0, 60.0, count))
    for share, held in _RAMP:
        sensor.pass_time(held, share * taxels, touches.repeat)
    sensor.pass_time(random.uniform(0.3, 3.0, count), taxels, touches.repeat)
    raw = sensor.read(taxels, touches.repeat, frames, 1.0 / machine.FRAME_RATE)
    return {
        "readings": np.maximum(raw - tare, 0.0).mean(axis=0), "tare": np.nan_to_num(tare).astype(np.float32),
        "contact_pose": actual, "current": current, "force": force,
    }  # fmt: skip


@functools.lru_cache(maxsize=4)
def _model(parameters: SecondParameters) -> Equilibrium:
    """Return the model of these parameters, shared by dockings."""
    return Equilibrium(parameters)


class SecondSource(PadSource):
    """Both pads of one rig in the second contact physics.

    Unneeded frames may be skipped, with limits. Between two frames the pads carry the force of the later one, and none
    before the first frame of a contact. After an unread change of force, creep therefore starts at the earlier frame.
    A force that rises and falls between two frames leaves no hysteresis. No time passes if `time` does not increase.

    Args:
        parameters: family of rigs; None = the defaults.
        rig_seed: of the device (gains, offsets, dead taxels, ridges, line of action, leans).
        seed: of the run (jitter, leans, repeatability, noise).
    """

    def __init__(self, parameters: SecondParameters | None = None, rig_seed: int = 0, seed: int = 0) -> None:
        super().__init__(np.random.default_rng([0x2E0, rig_seed, seed]))
        self.parameters = parameters or SecondParameters()
        self.rig = Device.draw(self.parameters, rig_seed)
        self._sensor = SheetSensor(self.parameters.sheet, self.rig.sheets, self._random)
        self._model = _model(self.parameters)  # now, as emulators must answer in time at the first touch
        self._fresh = True  # no frame of this contact has been read

    def begin_docking(self) -> Pose:
        """Unload the sheets and start a new contact as in `PadSource.begin_docking`."""
        self._sensor.pass_time(0.0)
        self._fresh = True
        return super().begin_docking()

    def frames(
        self, time: float, pose: Pose | None, force: float, count: int, period: float, lean: Lean | None = None
    ) -> arrays.Array:
        """Return frames (count, 2, 10, 10) N raw; arguments as in `PadSource.frames`."""
        pressed = self._press(pose, force, lean)
        repeat = 1.0 if self._contact is None else self._contact.repeat
        first = time - (count - 1) * period
        passed = 0.0 if self._last is None else first - self._last
        self._last = time if self._last is None else max(time, self._last)
        if pressed is None or self._fresh:
            self._sensor.pass_time(passed)
        else:
            self._sensor.pass_time(passed, pressed, repeat)
        self._fresh = pressed is None
        return np.asarray(self._sensor.read(pressed, repeat, count, period)[:, 0])

    def _draw(self) -> Touches:
        return Touches.draw(self.parameters, self._random)

    def _solve(self, contact: Touches, pose: arrays.Array, force: float, lean: Lean | None) -> arrays.Array:
        free = 0.0 if lean is None else approach(lean.free)
        return contact.press(self._model, self.rig, pose, force, free)
