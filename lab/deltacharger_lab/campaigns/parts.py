# SPDX-License-Identifier: Apache-2.0
"""Parameters of world, pads and docking from the values of a campaign's keys."""

import functools
import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, cast

from deltacharger_core import files, machine, parameters
from deltacharger_core.parameters import number
from deltacharger_docking.parameters import DockingParameters
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, LimbAdjustment, Vector
from deltacharger_lab.second.parameters import PlatformRestParameters, SecondParameters
from deltacharger_sim.pads import ContactSource, PadSource
from deltacharger_sim.parameters import WorldParameters
from deltacharger_tactile import PoseEstimator, default_model
from deltacharger_tactile.parameters import PadContactParameters, TactileParameters

Value = float | bool | str
_REDRAWS = 1000  # of a normal distribution outside the bounds; then the mean is used
_LOG, _SIDES = "log", "either_sign"
HELP = (
    "give a number, a range [low, high], {log: [low, high]}, {either_sign: [low, high]}, {mean: …, stddev: …} or "
    "{choose: [ … ]}"
)


@dataclass(frozen=True)
class Spread:
    """Distribution of a value.

    Attributes:
        shape: "fixed", "range", "log", "either_sign", "normal" or "choose".
        numbers: the value; low and high (of the size for "either_sign"); mean and standard deviation; or the choices.
        key: bounds and kind; a number, a truth value or a word.
    """

    shape: str
    numbers: tuple[Value, ...]
    key: parameters.Declaration

    def draw(self, source: random.Random) -> Value:
        """Return one value within the bounds."""
        first = self.numbers[0]
        if self.shape == "fixed":
            return first
        if self.shape == "choose":
            return self.numbers[source.randrange(len(self.numbers))]
        if self.shape == "normal":
            return self._normal(source)
        first, last = cast(tuple[float, float], self.numbers)
        if self.shape == _LOG:
            drawn = math.exp(source.uniform(math.log(first), math.log(last)))
            return min(max(drawn, first), last)
        if self.shape == _SIDES:
            return source.choice((-1.0, 1.0)) * source.uniform(first, last)
        return source.randint(int(first), int(last)) if self.key.kind is int else source.uniform(first, last)

    def _normal(self, source: random.Random) -> float:
        mean, stddev = cast(tuple[float, float], self.numbers)
        for _ in range(_REDRAWS):
            value = source.gauss(mean, stddev)
            if self.key.low <= value <= self.key.high:
                return value
        return float(mean)

    @property
    def ends(self) -> tuple[Value, Value]:
        """Smallest and largest value of a range or a choice; of a normal distribution its mean twice."""
        if self.shape == "normal":
            return self.numbers[0], self.numbers[0]
        if self.shape == _SIDES:
            return -float(self.numbers[1]), self.numbers[1]
        known = cast(tuple[float, ...], self.numbers)  # or words, which have an order, too
        return min(known), max(known)


def _usage(key: parameters.Declaration) -> str:
    return f"give one of {', '.join(key.choices)}, or {{choose: [ … ]}}" if key.kind is str else HELP


def _checked(key: parameters.Declaration, value: Any, where: str) -> Value:
    """Return the value in the key's own type.

    Raises:
        ParameterError: it has the wrong type or lies outside the bounds.
    """
    if key.kind is int and isinstance(value, float) and value.is_integer():
        value = int(value)
    problem = "has no value" if value is None else key.problem(value)
    if problem:
        number = isinstance(value, int | float) and key.kind is not str
        usage = "" if number else parameters.did_you_mean(value, key.choices) or f"; {_usage(key)}"
        raise parameters.ParameterError(where, value, problem + usage)
    checked: Value = key.kind(value)
    return checked


def read_spread(value: Any, key: parameters.Declaration, where: str) -> Spread:
    """Return the distribution that a YAML value describes.

    Args:
        value: number, truth value, word, [low, high], {mean, stddev} or {choose}.
        key: its bounds and kind.
        where: dotted key, for messages.

    Raises:
        ParameterError: it is none of these, or a number in it lies outside the bounds.
    """
    if isinstance(value, list | tuple):
        return _read_range(value, key, where)
    if isinstance(value, Mapping):
        if set(value) == {"choose"}:
            choices = value["choose"]
            if not isinstance(choices, list | tuple) or not choices:
                raise parameters.ParameterError(
                    f"{where}.choose", choices, f"{files.brief(choices)} is not a list of values"
                )
            checked = (_checked(key, item, f"{where}.choose[{index}]") for index, item in enumerate(choices))
            return Spread("choose", tuple(checked), key)
        if set(value) == {"mean", "stddev"} and key.kind is float:
            return _read_normal(value, key, where)
        if len(value) == 1 and {_LOG, _SIDES} & set(value) and key.kind is float:
            shape, ends = next(iter(value.items()))
            return _read_scale(shape, ends, key, where)
        raise parameters.ParameterError(
            where, dict(value), f"{files.brief(dict(value))} is not a distribution; {_usage(key)}"
        )
    return Spread("fixed", (_checked(key, value, where),), key)


def _read_range(value: Any, key: parameters.Declaration, where: str) -> Spread:
    if len(value) != 2 or key.kind in (bool, str):
        raise parameters.ParameterError(where, value, f"{files.brief(value)} is not a range [low, high]; {_usage(key)}")
    low, high = (cast(float, _checked(key, item, f"{where}[{index}]")) for index, item in enumerate(value))
    if low > high:
        raise parameters.ParameterError(where, value, f"{low:g} is above {high:g}; give the lower one first")
    return Spread("range", (low, high), key)


def _read_scale(shape: str, ends: Any, key: parameters.Declaration, where: str) -> Spread:
    """Return a spread over sizes: logarithmic, or linear with either sign."""
    where = f"{where}.{shape}"
    if not isinstance(ends, list | tuple):
        raise parameters.ParameterError(where, ends, f"{files.brief(ends)} is not a range [low, high]; {HELP}")
    low, high = cast(tuple[float, float], _read_range(ends, key, where).numbers)
    if shape == _LOG and low <= 0.0:
        raise parameters.ParameterError(where, ends, f"{low!r} has no logarithm; give numbers above 0")
    if shape == _SIDES:
        if low < 0.0:
            raise parameters.ParameterError(where, ends, f"{low!r} is not a size; give both ends ≥ 0")
        _checked(key, -high, where)
    return Spread(shape, (low, high), key)


def _read_normal(value: Mapping[str, Any], key: parameters.Declaration, where: str) -> Spread:
    mean, stddev = cast(float, _checked(key, value["mean"], f"{where}.mean")), value["stddev"]
    known = not isinstance(stddev, bool) and isinstance(stddev, int | float)
    if not known or not 0.0 <= stddev <= key.high - key.low:
        raise parameters.ParameterError(
            f"{where}.stddev",
            stddev,
            f"{files.brief(stddev)} is outside 0 to {key.high - key.low:g} {key.unit}".rstrip(),
        )
    return Spread("normal", (mean, float(stddev)), key)


_WRONG = 0.005  # m; a larger error is seen when the arm is built or measured
_TURNED = 0.1  # rad; a zero that errs by more puts the platform 12 mm off, which homing shows
_GEOMETRY = "assumed.geometry."
_COMMON = ("base_radius", "arm", "rod", "platform_radius", "z_offset")


@dataclass(frozen=True)
class AssumedLimb:
    """Errors of docking's parameters of one limb."""

    radius_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of base radius − platform radius of this limb")
    tangential_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of its plane, counter-clockwise about z")
    height_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of its motor axis, toward +z")
    arm: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of this arm")
    rod: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of this rod")
    angle_offset: float = number(0.0, -_TURNED, _TURNED, "rad", "error of this arm's zero: assumed − true angle")


@dataclass(frozen=True)
class AssumedGeometry:
    """Errors of docking's dimensions of the arm: assumed − true."""

    base_radius: float = number(
        0.0, -_WRONG, _WRONG, "m", "error of the base radius; only its difference to platform_radius's error counts"
    )
    arm: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of all arms")
    rod: float = number(0.0, -_WRONG, _WRONG, "m", "error of the length of all rods")
    platform_radius: float = number(0.0, -_WRONG, _WRONG, "m", "error of the platform's radius")
    z_offset: float = number(0.0, -_WRONG, _WRONG, "m", "error of the motor plane's position along z")
    limb_0: AssumedLimb = field(default_factory=AssumedLimb)
    limb_1: AssumedLimb = field(default_factory=AssumedLimb)
    limb_2: AssumedLimb = field(default_factory=AssumedLimb)


@dataclass(frozen=True)
class Assumed:
    """Docking's assumptions about arm and gravity."""

    servo_stiffness: float = number(1.0, 0.25, 4.0, "", "servo stiffness that docking assumes, over the true one")
    torque_constant: float = number(
        1.0, 0.5, 2.0, "", "torque constant that docking and servo_node assume, over the true one"
    )
    gravity_tilt: float = number(
        0.0, 0.0, math.pi, "rad", "angle from true gravity to the gravity that docking assumes"
    )
    gravity_azimuth: float = number(0.0, -math.pi, math.pi, "rad", "direction of that angle, as gravity.azimuth")
    geometry: AssumedGeometry = field(default_factory=AssumedGeometry)


def assumed_gravity(values: Mapping[str, Value], true: Vector) -> Vector:
    """Return the gravity (m/s², charger_base) that docking assumes.

    `assumed.gravity_tilt` turns the true gravity: first −y, as `gravity.tilt` and `gravity.azimuth` do, then the result
    by the shortest rotation that brings −y to the true direction. Without it docking assumes the true gravity if
    `gravity.known`, else −y.
    """
    if "assumed.gravity_tilt" not in values:
        return true if values.get("gravity.known", False) else machine.GRAVITY
    tilt, azimuth = float(values["assumed.gravity_tilt"]), float(values.get("assumed.gravity_azimuth", 0.0))
    return _turned(tilted_gravity(tilt, azimuth), true)


def tilted_gravity(tilt: float, azimuth: float) -> Vector:
    """Return gravity (m/s², charger_base) of a robot tilted by `tilt` toward `azimuth` (0 = +z, π/2 = +x)."""
    level = machine.GRAVITY_STRENGTH * math.sin(tilt)
    return level * math.sin(azimuth), -machine.GRAVITY_STRENGTH * math.cos(tilt), level * math.cos(azimuth)


def _turned(vector: Vector, true: Vector) -> Vector:
    """Return a vector turned by the shortest rotation from −y to the direction of `true`.

    With b = −y and the unit vector a of `true` this is v − ((a + b)·v / (1 + a·b)) (a + b) + 2 (b·v) a (Rodrigues).
    If they are opposite, all half turns about an axis across y are equally short: the one about x is taken.
    """
    size = math.hypot(*true)
    ax, ay, az = (each / size for each in true)
    x, y, z = vector
    along = 1.0 - ay
    if along < 1e-9:
        return x, -y, -z
    share = (ax * x + (ay - 1.0) * y + az * z) / along
    return x - share * ax - 2.0 * y * ax, y - share * (ay - 1.0) - 2.0 * y * ay, z - share * az - 2.0 * y * az


def assumed_geometry(values: Mapping[str, Value]) -> DeltaGeometry | None:
    """Return the dimensions that docking assumes for the arm; None = the true ones."""
    names = (name for name in values if name.startswith(_GEOMETRY))
    errors = {name.removeprefix(_GEOMETRY): float(values[name]) for name in names}
    if not any(errors.values()):
        return None
    true = DeltaGeometry()
    common = replace(true, **{name: getattr(true, name) + errors.get(name, 0.0) for name in _COMMON})
    first, second, third = (_limb(common, index, errors) for index in range(LIMB_COUNT))
    return replace(common, limbs=(first, second, third))


def _limb(common: DeltaGeometry, index: int, errors: Mapping[str, float]) -> LimbAdjustment:
    """Return the assumed differences of a limb from the common dimensions."""
    found: dict[str, Any] = {}
    for item in parameters.declared(AssumedLimb):
        error = errors.get(f"limb_{index}.{item.name}", 0.0)
        if error:
            found[item.name] = error + (getattr(common, item.name) if item.name in ("arm", "rod") else 0.0)
    return LimbAdjustment(**found)


FIRST, SECOND = "first", "second"
PADS = (FIRST, SECOND)
PACKAGED, FROM_ONE_NEWTON = "packaged", "1N"
POSE_MODELS = (PACKAGED, FROM_ONE_NEWTON)


def make_pads(
    pads: str, tactile: TactileParameters, second: SecondParameters | None, rig_seed: int, seed: int
) -> PadSource:
    """Return the pads of a docking.

    Args:
        pads: contact physics, one of `PADS`.
        tactile: family of rigs of the first physics.
        second: family of rigs of the second one; None = its defaults.
        rig_seed: seed of the device.
        seed: of noise and jitter.
    """
    if pads == SECOND:
        from deltacharger_lab.second.generator import SecondSource

        return SecondSource(second, rig_seed, seed)
    return ContactSource(tactile, rig_seed, seed)


@functools.cache
def pose_model_from_one_newton() -> PoseEstimator:
    """Return the packaged pose model for sensors that read nothing below 1 N, read once per process."""
    return default_model(machine.CONTACT_FORCE)


NOMINAL: Vector = (0.0, 0.0, machine.DOCK_DISTANCE)  # m, charger_base; origin of a target's offsets
AXES = ("x", "y", "z", "roll")
_COMPLIANCE = {key.name: key for key in parameters.declared(PlatformRestParameters)}["compliance"]


def build_parts(values: Mapping[str, Value]) -> tuple[WorldParameters, TactileParameters, DockingParameters]:
    """Return the parameters of world, pads and docking for these values of the scene's keys.

    Raises:
        ParameterError: world, pads or docking refuses them.
    """
    place = {axis: float(values.get(f"target.{axis}", 0.0)) + float(values.get(f"shift.{axis}", 0.0)) for axis in AXES}
    gravity = tilted_gravity(float(values.get("gravity.tilt", 0.0)), float(values.get("gravity.azimuth", 0.0)))
    content = nested(values, "world")
    target = content.setdefault("target", {})
    target.update(place, z=NOMINAL[2] + place["z"])
    target["tilt_x"], target["tilt_y"] = target_lean(values)
    content.update(_axes(gravity))
    world = parameters.from_mapping(content, WorldParameters, "world")
    factor, constant = (float(values.get(f"assumed.{name}", 1.0)) for name in ("servo_stiffness", "torque_constant"))
    given: dict[str, Any] = {
        "servo_stiffness": factor * world.servo.stiffness,
        "torque_constant": constant * world.servo.torque_constant,
        "power": "none" if world.circuit.wired else "board",
        "gravity": assumed_gravity(values, gravity),
    }
    if world.magnets.force == 0.0:  # a charger built without magnets is known to have none
        given["magnet_force"] = 0.0
    docking = parameters.from_mapping(given | nested(values, "docking"), DockingParameters, "docking")
    contact = replace(PadContactParameters(), **nested(values, "electrode"))
    return world, TactileParameters(contact=contact), docking


def target_lean(values: Mapping[str, Value]) -> tuple[float, float]:
    """Return pitch and yaw of the target's faces against the platform, rad."""
    pitch, yaw = (float(values.get(f"world.target.tilt_{axis}", 0.0)) for axis in "xy")
    return pitch, yaw - float(values.get("parked.heading", 0.0))


def second_family(values: Mapping[str, Value]) -> SecondParameters | None:
    """Return the family of rigs of the second physics; None = its defaults.

    Its platform takes the world's compliance, if the world has one and the family has none.

    Raises:
        ParameterError: the values contradict each other.
    """
    content = nested(values, "second")
    if compliance := float(values.get("world.platform.compliance", 0.0)):
        content.setdefault("platform", {}).setdefault("compliance", max(compliance, _COMPLIANCE.low))
    return parameters.from_mapping(content, SecondParameters, "second") if content else None


def nested(values: Mapping[str, Value], section: str) -> dict[str, Any]:
    """Return a section's values as nested mappings."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        first, *path = name.split(".")
        if first != section:
            continue
        level = result
        for part in path[:-1]:
            level = level.setdefault(part, {})
        level[path[-1]] = value
    return result


def _axes(gravity: Vector) -> dict[str, float]:
    return {f"gravity_{axis}": value for axis, value in zip("xyz", gravity, strict=True)}
