# SPDX-License-Identifier: Apache-2.0
"""The paper's dockings recorded on the simulated charger in virtual time, by docking's own movements.

For the angle set the arm starts up to 20 mm beside the target, asks the camera, moves to the seen electrodes and
presses. The remaining offset is the error of vision and Algorithm 1. The position set is commanded. Camera and mount
err as in the campaign scene `default`: the mount once for a rig, the camera at every look.
"""

import dataclasses
import json
import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltacharger_bringup.records.session import SUBSETS, Part, Rested, TouchSession, check_places
from deltacharger_core.machine import CONTACT_FORCE, FRAME_RATE
from deltacharger_docking import codes, observation
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import Vector
from deltacharger_lab.campaigns import draw, scene
from deltacharger_lab.campaigns.parts import NOMINAL
from deltacharger_lab.reports.pool import ReportTask, work
from deltacharger_sim.pads import ContactSource
from deltacharger_sim.parameters import TargetParameters, WorldParameters
from deltacharger_sim.virtual.quick_charger import QuickCharger
from deltacharger_tactile.dataset import VERSION, Dataset
from deltacharger_tactile.parameters import ANGLE_CLASSES, TactileParameters

_TRIES = 3  # of a docking that fails
_LIMIT = 120.0  # simulated s of one docking


@dataclass(frozen=True)
class Protocol:
    """Recording of one rig.

    Attributes:
        rig: seed of the device.
        seed: of offsets, noise and order.
        frames: averaged in each row.
        rows: of each docking.
        threshold: readings below it become 0, N.
        dwell_s: from rest in contact to the first frame, s.
        tare_every: dockings after each tare (a session).
        repeat: dockings of each angle, and at each offset; the paper's are (100, 20).
    """

    rig: int = 0
    seed: int = 0
    frames: int = 1
    rows: int = 1
    threshold: float = CONTACT_FORCE
    dwell_s: float = 0.5
    tare_every: int = 25
    repeat: tuple[int, int] = (100, 20)

    def parts(self) -> list[Part]:
        """Return the angle set's six parts, and the position set."""
        x, y, z = (1e3 * value for value in NOMINAL)
        by_angle, by_place = self.repeat
        angles = [Part("angle", float(degrees), by_angle, self.seed, x, y, z) for degrees in range(ANGLE_CLASSES)]
        return [*angles, Part("position", 0.0, by_place, self.seed, x, y, z)]


@dataclass(frozen=True)
class Pressed:
    """One docking: its number in the part, and the data of its rows; m, rad, N, A."""

    number: int
    session: int
    commanded: Vector
    pose: tuple[float, float, float]
    force: float
    current: float
    baseline: NDArray[Any]
    frames: NDArray[Any]


class _Keeper:
    """Records the readings of the charger's pads, with the truth."""

    def __init__(self, charger: QuickCharger, recording: Protocol) -> None:
        self.touches: list[Pressed] = []
        self.numbers: Sequence[int] = ()
        self.session = 0
        self.number = 0
        self._charger, self._recording = charger, recording
        self._since = 0.0
        self._sensed: dict[str, Any] = {}

    def begin_docking(self, number: int) -> None:
        self.number = self.numbers[number]

    def start_frames(self) -> None:
        self._since = self._charger.now

    def has_frames(self) -> bool:
        charger, recording = self._charger, self._recording
        count = recording.frames * recording.rows
        pose = charger.world.misalignment
        if charger.now - self._since < count / FRAME_RATE or pose is None:
            return False
        raw = charger.feel(count, 1.0 / FRAME_RATE)
        tared = (raw - charger.baseline).clip(min=0.0)
        frames = tared.reshape(recording.rows, recording.frames, *raw.shape[1:]).mean(axis=1)
        force = charger.world.mechanics.contact_force
        self._sensed = {"pose": pose, "force": force, "baseline": charger.baseline, "frames": frames}
        return True

    def keep(self, touch: Rested) -> None:
        known = {"commanded": touch.commanded, "current": touch.current, **self._sensed}
        self.touches.append(Pressed(self.number, self.session, **known))

    def kept(self) -> bool:
        return True


def record_part(recording: Protocol, part: Part) -> list[Pressed]:
    """Run the dockings of one part, in order.

    Raises:
        DockingError: one failed three times.
    """
    where = f"{recording.rig} {recording.seed} {part.name}"
    world = WorldParameters(target=TargetParameters(roll=math.radians(part.angle_deg)))
    parameters = DockingParameters(servo_stiffness=world.servo.stiffness)
    seed = random.Random(where).getrandbits(31)
    charger = QuickCharger(world, parameters, ContactSource(None, recording.rig, seed), seed, recording.rig)
    keeper, look = _Keeper(charger, recording), part.set == "angle"
    offsets = part.starts() if look else [(pose.horizontal, pose.vertical) for pose in part.poses()]
    x, y, z = part.target
    commands = [(x - float(dx), y - float(dy), z) for dx, dy in offsets]
    check_places(charger.machine, commands)
    charger.answer[observation.Service.DETECT] = lambda reply: _seen(reply, part, keeper.number, recording)
    failures = 0
    while left := sorted(set(range(len(commands))) - {touch.number for touch in keeper.touches}):
        keeper.numbers, before = left[: recording.tare_every], len(keeper.touches)
        places = [commands[number] for number in keeper.numbers]
        holding = recording.frames * recording.rows / FRAME_RATE
        charger.start(TouchSession(places, recording.dwell_s, holding, keeper, look).run)
        outcome = charger.finish(_LIMIT * len(places))
        keeper.session += 1
        failures = 0 if outcome.success or len(keeper.touches) > before else failures + 1
        if failures == _TRIES:
            raise codes.DockingError(
                f"{part.name}: a docking failed {_TRIES} times, {outcome.code.name}: {outcome.message}"
            )
    return sorted(keeper.touches, key=lambda touch: touch.number)


def _seen(reply: observation.Reply, part: Part, number: int, recording: Protocol) -> observation.Reply:
    """Return the pose of the electrodes that the camera sees in a docking."""
    errs = {name: spread.numbers[0] for name, spread in scene.load_campaign_scene(scene.DEFAULT).spreads.items()}
    place = {name: value for name, value in errs.items() if name.startswith("hand_eye.")}
    look = {name: value for name, value in errs.items() if name.startswith("camera.")}
    mounted = random.Random(f"{recording.rig} hand_eye")
    believed, roll, _ = draw.seen_at(place, part.target, math.radians(part.angle_deg), mounted)
    errors = random.Random(f"{recording.rig} {recording.seed} {part.name} {number}")
    return dataclasses.replace(
        reply, detection=observation.ElectrodePose(*draw.seen_at(look, believed, roll, errors)[:2])
    )


def record_paper(recording: Protocol, progress: Callable[[str], None]) -> Dataset:
    """Record the paper's two sets on one simulated rig, two parts at a time.

    Args:
        recording: the plan.
        progress: called with the progress.

    Raises:
        DockingError: a docking failed three times.
        KeyboardInterrupt: interrupted; all processes have ended.
    """
    parts = recording.parts()
    tasks = [ReportTask(part.name, record_part, (recording, part), float(len(part.poses()))) for part in parts]
    found = work(tasks, progress)
    return dataset(recording, [(part, touch) for part in parts for touch in found[part.name][0]])


def dataset(recording: Protocol, touches: Sequence[tuple[Part, Pressed]]) -> Dataset:
    """Return the rows of dockings, in order."""
    rows = recording.rows

    def column(values: Sequence[Any]) -> NDArray[Any]:
        return np.repeat(np.array(values), rows, axis=0)

    loads = np.concatenate([touch.frames for _, touch in touches])
    dead = np.isnan(loads)
    loads = np.where(dead | (loads < recording.threshold), 0.0, loads).astype(np.float32)
    sessions = {name: index for index, name in enumerate(dict.fromkeys((p.name, t.session) for p, t in touches))}
    parameters = TactileParameters()
    return Dataset(
        left=loads[:, 0],
        right=loads[:, 1],
        tare=column([np.nan_to_num(touch.baseline) for _, touch in touches]).astype(np.float32),
        dead=dead,
        angle=column([math.radians(part.angle_deg) for part, _ in touches]),
        vertical=column([part.target[1] - touch.commanded[1] for part, touch in touches]),
        horizontal=column([part.target[0] - touch.commanded[0] for part, touch in touches]),
        contact_pose=column([touch.pose for _, touch in touches]),
        attempt=column(range(len(touches))),
        session=column([sessions[part.name, touch.session] for part, touch in touches]),
        rig=np.full(len(loads), recording.rig),
        subset=column([SUBSETS[part.set] for part, _ in touches]),
        current=column([touch.current for _, touch in touches]),
        force=column([touch.force for _, touch in touches]),
        meta={
            "version": VERSION,
            "protocol": "paper",
            "recorded": True,
            "simulated": True,
            **{name: getattr(recording, name) for name in ("seed", "frames", "rows", "threshold", "dwell_s")},
            "rigs": [recording.rig],
            "parameters": json.loads(parameters.to_json()),
            "digest": parameters.digest(),
        },
    )
