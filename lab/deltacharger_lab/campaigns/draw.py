# SPDX-License-Identifier: Apache-2.0
"""One drawn docking of a campaign: world, pads, docking's parameters and the goal's pose of the target."""

import math
import random
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from deltacharger_core import machine, parameters
from deltacharger_docking.observation import ElectrodePose
from deltacharger_docking.parameters import DockingParameters, TargetProfile
from deltacharger_kinematics.geometry import DeltaGeometry, Vector
from deltacharger_lab.campaigns import disturbances, keys, parts, targets
from deltacharger_lab.campaigns.scene import CampaignScene
from deltacharger_lab.second.parameters import SecondParameters
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.virtual.virtual_charger import PROFILE
from deltacharger_tactile.parameters import TactileParameters

_CAMERA: Vector = (0.0, 0.12, -0.12)  # m, charger_base; the usual mount, see deltacharger_vision.mount
_GOAL_STDDEV_LEAST = 1e-6  # rad
_REDRAWS = 10_000  # of vision's errors that put the goal too far from the target


@dataclass(frozen=True)
class Drawn:
    """All inputs of one docking.

    Attributes:
        number: of the docking in its campaign.
        values: of the scene's keys, by name.
        world: the simulated world, target included.
        tactile: the family of pads.
        docking: parameters of docking.
        goal: pose of the electrodes in the goal.
        seed: of noise and jitter.
        rig_seed: which device's pads.
        estimator: errors added to each estimate.
        geometry: the arm's dimensions that docking assumes; None = the true ones.
        pads: their contact physics.
        second: the family of pads of the second physics; None = its defaults.
        high_row: excess reading of a row of taxels after each tare, N.
        nudge: movement of the target while it charges.
        published: dock by the paper's algorithm as printed.
        scene: name of the scene that was drawn from.
        profile: of the target.
        case: the target that is charged to its end; None = docking ends the charge.
    """

    number: int
    values: Mapping[str, parts.Value]
    world: WorldParameters
    tactile: TactileParameters
    docking: DockingParameters
    goal: ElectrodePose
    seed: int
    rig_seed: int
    estimator: keys.EstimatorErrors
    geometry: DeltaGeometry | None = None
    pads: str = parts.FIRST
    second: SecondParameters | None = None
    high_row: float = 0.0
    nudge: disturbances.Nudge = field(default_factory=disturbances.Nudge)
    published: bool = False
    scene: str = ""
    profile: TargetProfile = PROFILE
    case: targets.TargetCase | None = None


def draw(scene: CampaignScene, seed: int, number: int) -> Drawn:
    """Draw docking `number` of the campaign with this `seed`.

    Each key has its own random stream. So another key does not change the others' values, and the dockings of two
    campaigns of one seed are pairs.

    Args:
        scene: distributions to draw from.
        seed: of the campaign.
        number: of the docking, from 0.

    Raises:
        ValueError: the drawn values contradict each other.
    """

    def source(what: str) -> random.Random:
        return random.Random(f"{seed} {number} {what}")

    if scene.bases:
        scene = source("based_on").choice(scene.bases)
    values = {name: spread.draw(source(name)) for name, spread in scene.spreads.items()}
    if scene.dockings:
        values.update(scene.dockings[number % len(scene.dockings)])
    goal = _goal(values, source("goal"))
    values |= _derived(values, goal, source)
    world, tactile, docking = parts.build_parts(values)
    kind = str(values.get("targets", ""))
    case = targets.CASES[kind](number, source("target")) if kind else None
    if case is not None:
        world = case.world(world)
    return Drawn(
        number=number,
        values=values,
        world=world,
        tactile=tactile,
        docking=docking,
        goal=goal,
        seed=source("seed").getrandbits(31),
        rig_seed=source("rig").getrandbits(31),
        estimator=keys.EstimatorErrors(**parts.nested(values, "estimator")),
        geometry=parts.assumed_geometry(values),
        pads=str(values.get("pads", parts.FIRST)),
        second=parts.second_family(values),
        high_row=float(values.get("taxels.high_row", 0.0)),
        nudge=disturbances.Nudge(**parts.nested(values, "nudge")),
        published=bool(values.get("published", False)),
        scene=scene.name,
        profile=replace(PROFILE, **parts.nested(values, "profile")) if case is None else case.profile,
        case=case,
    )


def _goal(values: Mapping[str, parts.Value], source: random.Random) -> ElectrodePose:
    """Return the target's pose as camera and hand-eye calibration report it."""
    position = [parts.NOMINAL[index] + float(values.get(f"target.{axis}", 0.0)) for index, axis in enumerate("xyz")]
    standing = float(values.get("target.roll", 0.0))
    limit = float(values.get("shift.limit", math.inf))
    moved = float(values.get("shift.x", 0.0)), float(values.get("shift.y", 0.0))
    for _ in range(_REDRAWS):
        (x, y, z), roll, turn = seen_at(values, position, standing, source)
        if max(abs(position[0] + moved[0] - x), abs(position[1] + moved[1] - y)) <= limit:
            break
    else:
        raise parameters.ParameterError(
            "shift.limit", limit, "is too small for these errors of vision; give a larger one"
        )
    stddev = math.hypot(*(float(values.get(f"{key}_stddev", 0.0)) for key in ("camera.roll", "hand_eye.rotation")))
    pose = ElectrodePose((x, y, z), roll, stddev if stddev > _GOAL_STDDEV_LEAST else 0.0)
    return _with_lean(pose, values, turn, source) if values.get("camera.lean_stddev") else pose


def _with_lean(
    pose: ElectrodePose, values: Mapping[str, parts.Value], turn: tuple[float, float], source: random.Random
) -> ElectrodePose:
    """Return `pose` with the faces' yaw and pitch as seen by a camera whose mount errs by `turn` about x and y, rad."""
    seen = float(values["camera.lean_stddev"])
    stddev = math.hypot(seen, float(values.get("hand_eye.rotation_stddev", 0.0)))
    pitch, yaw = parts.target_lean(values)
    return replace(
        pose,
        pitch=pitch + turn[0] + seen * source.gauss(0.0, 1.0),
        yaw=yaw + turn[1] + seen * source.gauss(0.0, 1.0),
        pitch_stddev=stddev,
        yaw_stddev=stddev,
    )


def seen_at(
    values: Mapping[str, parts.Value], position: Sequence[float], roll: float, source: random.Random
) -> tuple[Vector, float, tuple[float, float]]:
    """Return the electrodes' pose as a camera sees it.

    Three values: position (m, charger_base), roll (rad), and the turn of the camera about x and y by the mount's
    error (rad). A lean that it sees errs by the same turn.

    Args:
        values: of the keys `camera` and `hand_eye`; 0 if one is missing.
        position: true one, m, charger_base.
        roll: true one, rad.
        source: random generator of the errors.
    """
    seen, turned = (float(values.get(f"camera.{name}_stddev", 0.0)) for name in ("position", "roll"))
    place, turn = (float(values.get(f"hand_eye.{name}_stddev", 0.0)) for name in ("position", "rotation"))
    ax, ay, az = (point - camera for point, camera in zip(position, _CAMERA, strict=True))
    noise = [source.gauss(0.0, 1.0) for _ in range(10)]
    rx, ry, rz = (turn * each for each in noise[6:9])
    swung = (ry * az - rz * ay, rz * ax - rx * az, rx * ay - ry * ax)  # a small rotation about the camera
    x, y, z = (position[index] + seen * noise[index] + place * noise[3 + index] + swung[index] for index in range(3))
    return (x, y, z), roll + turned * noise[9] + rz, (rx, ry)


def _derived(
    values: Mapping[str, parts.Value], goal: ElectrodePose, source: Callable[[str], random.Random]
) -> dict[str, parts.Value]:
    """Return the derived values.

    These are the tilt for gravity from any direction, and the roll for a given clearance.
    """
    found: dict[str, parts.Value] = {}
    if "gravity.anywhere" in values:
        found |= {"gravity.tilt": 0.0, "gravity.azimuth": 0.0}
    if values.get("gravity.anywhere", False):
        stream = source("gravity.anywhere direction")
        x, y, z = (stream.gauss(0.0, 1.0) for _ in range(3))
        found |= {"gravity.tilt": math.atan2(math.hypot(x, z), -y), "gravity.azimuth": math.atan2(x, z)}
    if "shift.beyond_zero" in values:
        offset = goal.position[1] - float(values.get("target.y", 0.0)) - float(values.get("shift.y", 0.0))
        size = max(
            zero_angle(offset, 0.5 * machine.BAR_GAP, 0.5 * machine.BAR_LENGTH) + float(values["shift.beyond_zero"]),
            0.0,
        )
        side = source("shift.beyond_zero side").choice((-1.0, 1.0))
        found["shift.roll"] = side * size - float(values.get("target.roll", 0.0))
    return found


def zero_angle(vertical: float, half_gap: float, half_length: float) -> float:
    """Return the angle (rad) at which a vertical error (m) leaves no clearance: g (1 + cos a) − h sin a = |y|."""
    size = math.hypot(half_gap, half_length)
    return max(math.acos(min((abs(vertical) - half_gap) / size, 1.0)) - math.atan2(half_length, half_gap), 0.0)
