# SPDX-License-Identifier: Apache-2.0
"""A world moved by MuJoCo: the optional reference for the light model, with the same parameters.

`mujoco_world(...)` is a World: circuit, jitter, record and readings are the light model's; only the motion differs.

**The model.** Every limb is a driven arm on a hinge and a rod on a universal joint. The platform slides along x, y
and z, as the parallelograms enforce. Equality constraints tie the rods' ends to it, so that the solver closes the
loops and no formula of the light model is used. The contact faces are a sphere and a plane; the stop behind the
electrodes' springs is a second sphere further back.

**Springs.** MuJoCo regularises a constraint with R = (1 − d)/d · A (A its estimate of the bodies' inverse weight) and
restores it with solref = (−s, −b). Such a constraint is a spring of s/((1 − d) A) at rest, regardless of other
forces. s is chosen for the wanted stiffness, and b = 2√s. MuJoCo documentation, "Solver parameters".

**A leaning contact.** Two hinges hold the platform's face, `platform.lever` behind it, with springs of 1/compliance,
critical damping and an inertia; without compliance there are no hinges. The pads add a spring to the hinge about y,
at rest if both bear equally (`tilt.level_yaw`). Once one pad is empty, a moment of the total force at the other pad
replaces it. Each bar touches by points along its overlap with its mate, each with its share of the bar's stiffness
and of the stop behind it. Angles are not assumed small, the target's force is normal to its own face, and friction at
the face bends the hinges.
"""

import functools
import logging
import math
from collections.abc import Iterator
from typing import Any

from deltacharger_core.machine import BAR_GAP, BAR_HEIGHT, BAR_LENGTH
from deltacharger_core.parameters import ParameterError
from deltacharger_kinematics import passive_joints, scalar
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry, Vector
from deltacharger_sim import motion, touch, world
from deltacharger_sim.parameters import MagnetParameters, ServoParameters, WorldParameters

IMPEDANCE = 0.9  # d of contacts and joint stops: share of the solver's motion that a constraint decides


def spring(stiffness: float, inverse: float) -> tuple[float, float]:
    """Return the solref that makes a constraint a spring of `stiffness` at rest, given its inverse weight."""
    s = stiffness * (1.0 - IMPEDANCE) * inverse
    return -s, -2.0 * math.sqrt(s)


def share_impedance(count: int) -> float:
    """Return the impedance of `count` equal constraints that together are as stiff as one with IMPEDANCE.

    In parallel, their R is one constraint's divided by `count`.
    """
    return 1.0 / (1.0 + count * (1.0 - IMPEDANCE) / IMPEDANCE)


def share(stiffness: float, inverse: float, count: int) -> tuple[float, float]:
    """Return the solref of each of `count` constraints that together act as the spring and damper of `spring`."""
    softer = (1.0 - share_impedance(count)) / (1.0 - IMPEDANCE) / count
    s, b = spring(stiffness, inverse)
    return s * softer, b * softer


TIGHT = 0.9999  # d of stiff constraints: closed loops and dry friction
STICTION = 1e4  # stiffness of friction relative to the contact's normal; with 1, a pressed contact creeps by cm/s
END_STOP = 2000.0  # N·m/rad behind a joint limit, as in the light model
_RADIUS = 0.005  # m of the spheres that model the electrodes
_SPECK = 1e-6  # kg of an arm, whose inertia is the rotor's as in the light model, and of the face
INTEGRATORS = ("discrete", "implicitfast", "implicit", "Euler")


def load() -> Any:
    """Import MuJoCo.

    Raises:
        ModuleNotFoundError: it is not installed; the message states what to install.
    """
    try:
        import mujoco
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "MuJoCo, the reference of the simulation, is not installed: install deltacharger-lab[sim]", name="mujoco"
        ) from error
    return mujoco


def integrators() -> tuple[str, ...]:
    """Return the integrators of the installed MuJoCo, best first; `discrete` needs 3.13."""
    known = load().mjtIntegrator
    return tuple(name for name in INTEGRATORS if hasattr(known, f"mjINT_{name.upper()}"))


def refuse(parameters: WorldParameters) -> None:
    """Refuse parameters that the reference does not support.

    Raises:
        ParameterError: names the key.
    """
    without = (
        ("servo.backlash", parameters.servo.backlash, "play"),
        ("servo.friction_share", parameters.servo.friction_share, "friction by load"),
        ("cable.stiffness", parameters.cable.stiffness, "cable"),
        ("cable.drag", parameters.cable.drag, "cable"),
        ("stand.stiffness", parameters.stand.stiffness, "robots that give way"),
    )
    for key, value, what in without:
        if value != 0.0:
            raise ParameterError(
                key, value, f"{value!r}: the MuJoCo reference has no {what}: give 0 or use the light model"
            )


def build(parameters: WorldParameters, geometry: DeltaGeometry, step: float, integrator: str) -> Any:
    """Return the mujoco.MjModel with time step `step` (s), with contact and stop stiffnesses set.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ParameterError: the reference does not support a parameter.
        ValueError: the installed MuJoCo lacks the integrator.
    """
    mujoco = load()
    refuse(parameters)
    if integrator not in integrators():
        raise ValueError(f"unknown integrator {integrator!r}: give one of {', '.join(integrators())}")
    model = mujoco.MjModel.from_xml_string(_xml(parameters, geometry, step, integrator))
    if touch.tilts(parameters):
        set_springs(model, parameters)
    else:
        contact = parameters.contact
        inverse = float(model.body_invweight0[model.body("platform").id, 0])
        for index, stiffness in enumerate((2.0 * contact.stiffness, contact.hard_stop_stiffness)[: model.npair]):
            model.pair_solref[index] = spring(stiffness, inverse)
    for index in range(LIMB_COUNT):
        joint = model.joint(f"arm{index}").id
        inverse = float(model.dof_invweight0[model.jnt_dofadr[joint]])
        model.jnt_solref[joint] = spring(END_STOP, inverse)
    return model


def _xml(parameters: WorldParameters, geometry: DeltaGeometry, step: float, integrator: str) -> str:
    # Closed loops and friction yield by less than a micrometre with a time constant of two steps.
    tie = f'solref="{2.0 * step!r} 1" solimp="{TIGHT} {TIGHT} 0.001"'
    gravity = f"{parameters.gravity_x!r} {parameters.gravity_y!r} {parameters.gravity_z!r}"
    limbs = range(LIMB_COUNT)
    servo = parameters.servo
    return f"""<mujoco>
<compiler angle="radian" autolimits="false"/>
<option timestep="{step!r}" integrator="{integrator}" cone="elliptic" impratio="{STICTION}" gravity="{gravity}"
 tolerance="1e-12">
  <flag refsafe="disable" autoreset="disable"/>
</option>
<worldbody>
{"".join(_limb(geometry, index, servo, step) for index in limbs)}
{_platform(parameters, geometry)}
</worldbody>
<equality>
{"".join(f'<connect site1="tip{index}" site2="foot{index}" {tie}/>' for index in limbs)}
{hinges(parameters)}
</equality>
<contact>{_pairs(parameters)}</contact>
<actuator>
{"".join(_servo(index, servo.stiffness, servo.damping) for index in limbs)}
</actuator>
</mujoco>"""


def _limb(geometry: DeltaGeometry, index: int, servo: ServoParameters, step: float) -> str:
    limb = geometry.limb(index)
    radius = limb.base_radius + limb.radius_offset
    turned = math.atan2(limb.sine, limb.cosine)
    half = 0.5 * limb.angle_offset
    flexible = f"{max(geometry.rod_mass, _SPECK) * limb.rod**2 / 12.0!r}"
    return f"""<body pos="0 0 {-limb.motor_height!r}" quat="{math.cos(turned / 2)!r} 0 0 {math.sin(turned / 2)!r}">
 <body pos="{radius!r} {limb.tangential_offset!r} 0" quat="{math.cos(half)!r} 0 {-math.sin(half)!r} 0">
  <inertial pos="0 0 0" mass="{_SPECK}" diaginertia="1e-9 1e-9 1e-9"/>
  <joint name="arm{index}" axis="0 -1 0" armature="{servo.inertia!r}" damping="{servo.viscosity!r}" limited="true"
   range="{geometry.joint_min!r} {geometry.joint_max!r}" solimplimit="{IMPEDANCE} {IMPEDANCE} 0.001"
   frictionloss="1e-9" solreffriction="{2.0 * step!r} 1" solimpfriction="{TIGHT} {TIGHT} 0.001"/>
  <body pos="{limb.arm!r} 0 0">
   <inertial pos="{0.5 * limb.rod!r} 0 0" mass="{max(geometry.rod_mass, _SPECK)!r}"
    diaginertia="1e-8 {flexible} {flexible}"/>
   <joint name="pitch{index}" axis="0 -1 0"/>
   <joint name="swing{index}" axis="0 0 1"/>
   <site name="tip{index}" pos="{limb.rod!r} 0 0"/>
  </body>
 </body>
</body>
"""


def _platform(parameters: WorldParameters, geometry: DeltaGeometry) -> str:
    feet = []
    for index in range(LIMB_COUNT):
        limb = geometry.limb(index)
        along, across = limb.platform_radius * limb.cosine, limb.platform_radius * limb.sine
        feet.append(f'<site name="foot{index}" pos="{along!r} {across!r} 0"/>')
    sphere = f'type="sphere" size="{_RADIUS}" mass="0" contype="0" conaffinity="0"'
    slides = "".join(
        f'<joint name="{axis}" type="slide" axis="{way}"/>'
        for axis, way in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"))  # noqa: B905
    )
    turn = "0 1 0 0"
    if touch.tilts(parameters):
        turn = " ".join(map(repr, plane_turn(parameters)))
        touching = face(parameters)
    else:
        touching = f"""<geom name="electrodes" {sphere} pos="0 0 {-_RADIUS}"/>
 <geom name="stop" {sphere} pos="0 0 {-_RADIUS - parameters.contact.hard_stop!r}"/>"""
    plane = f'<geom name="target" type="plane" size="1 1 1" pos="0 0 {parameters.target.z!r}" quat="{turn}" '
    plane += 'contype="0" conaffinity="0"/>'
    return f"""<body name="platform">
 <inertial pos="0 0 0" mass="{geometry.platform_mass!r}" diaginertia="1e-4 1e-4 1e-4"/>
 {slides}{"".join(feet)}
 {touching}
</body>
{plane if parameters.target.present else ""}"""


def _pairs(parameters: WorldParameters) -> str:
    if not parameters.target.present:
        return ""
    rub = max(parameters.contact.friction, 1e-5)  # MuJoCo's minimum
    if touch.tilts(parameters):
        return pairs(rub)
    how = f'condim="3" friction="{rub!r} {rub!r}" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"'
    return "".join(f'<pair geom1="target" geom2="{name}" {how}/>' for name in ("electrodes", "stop"))


def _servo(index: int, stiffness: float, damping: float) -> str:
    return (
        f'<general name="servo{index}" joint="arm{index}" gainprm="{stiffness!r}" biastype="affine" '
        f'biasprm="0 {-stiffness!r} {-damping!r}" forcelimited="true" forcerange="-1 1"/>\n'
    )


POINTS = 24  # of each bar; with 8, a contact with one lifted end presses up to 1 % less
INERTIA = 2.3e-4  # kg·m² of the platform about x and about y: 0.274 kg over a plate of 0.1 m
_POINT_RADIUS = 1e-5  # m of a point; on a tilted face a larger one would touch too early
# Equidistant, slightly wider than the middles of equal pieces: with the line's own ∫ w² dw.
_PLACES = tuple(
    (2 * index + 1 - POINTS) / (POINTS * math.sqrt(1.0 - 1.0 / POINTS**2)) for index in range(POINTS)
)  # of half the overlap
_HINGES = ("lean_x", "lean_y")
_PADS = "pads"
_NAMES = tuple((layer, side, index) for layer in ("bar", "stop") for side in (1, -1) for index in range(POINTS))


def face(parameters: WorldParameters) -> str:
    """Return the XML of the platform's face."""
    platform, joints = parameters.platform, ""
    if platform.compliance > 0.0:
        joints = '<joint name="lean_x" axis="1 0 0"/><joint name="lean_y" axis="0 1 0"/>'
    # A body held by a spring of impedance d moves like one with 1/(1 − d) of its inertia.
    inertia = (1.0 - IMPEDANCE) * INERTIA
    points = "".join(
        f'<geom name="{layer}{side}_{index}" type="sphere" size="{_POINT_RADIUS}" pos="{u!r} {v!r} {w!r}" mass="0" '
        'contype="0" conaffinity="0"/>'
        for (layer, side, index), (u, v, w) in zip(_NAMES, places(parameters, 0.0, 0.0), strict=True)
    )
    return f"""<body name="face" pos="0 0 {-platform.lever!r}">
 <inertial pos="0 0 0" mass="{_SPECK}" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>
 {joints}{points}
</body>"""


def hinges(parameters: WorldParameters) -> str:
    """Return the XML of the springs of the hinges.

    They are constraints: with springs and dampers of the joints themselves, MuJoCo's integrator `discrete` makes the
    contacts softer, by 5 % at 0.2 ms.
    """
    if parameters.platform.compliance == 0.0:
        return ""
    how = f'solimp="{IMPEDANCE} {IMPEDANCE} 0.001"'
    held = [(name, name, 0.0) for name in _HINGES] + [(_PADS, _HINGES[1], touch.level_yaw(parameters))]
    return "".join(
        f'<joint name="{name}" joint1="{hinge}" polycoef="{rest!r} 0 0 0 0" {how}/>' for name, hinge, rest in held
    )


def places(parameters: WorldParameters, x: float, y: float) -> list[tuple[float, float, float]]:
    """Return every point's position in the face (m) with the target's centre at (x, y) in end_effector, m."""
    half, up = 0.5 * max(BAR_LENGTH - abs(x), 0.0), 0.5 * (BAR_GAP + BAR_HEIGHT)
    front = parameters.platform.lever - _POINT_RADIUS
    back = front - parameters.contact.hard_stop
    return [
        (0.5 * x + half * _PLACES[index], 0.5 * y + side * up, back if layer == "stop" else front)
        for layer, side, index in _NAMES
    ]


def plane_turn(parameters: WorldParameters) -> tuple[float, float, float, float]:
    """Return the quaternion (w, x, y, z) that turns a plane's normal from +z to the target's, which points along −z."""
    half_x, half_y = 0.5 * parameters.target.tilt_x, 0.5 * parameters.target.tilt_y
    sine_x, cosine_x, sine_y, cosine_y = math.sin(half_x), math.cos(half_x), math.sin(half_y), math.cos(half_y)
    # About y, then about x, of a plane turned by π about x.
    return -sine_x * cosine_y, cosine_x * cosine_y, -sine_x * sine_y, -cosine_x * sine_y


def pairs(friction: float) -> str:
    """Return the XML of the contacts with the target, with a coefficient of friction."""
    d = share_impedance(2 * POINTS)
    how = f'condim="3" friction="{friction!r} {friction!r}" solimp="{d!r} {d!r} 0.001"'
    return "".join(f'<pair geom1="target" geom2="{layer}{side}_{index}" {how}/>' for layer, side, index in _NAMES)


def set_springs(model: Any, parameters: WorldParameters) -> None:
    """Set the stiffness of a compiled model's contacts and hinges."""
    contact, inverse = parameters.contact, float(model.body_invweight0[model.body("face").id, 0])
    for index in range(model.npair):
        stiffness = 2.0 * contact.stiffness if index < 2 * POINTS else contact.hard_stop_stiffness
        model.pair_solref[index] = share(stiffness, inverse, 2 * POINTS)
    if (compliance := parameters.platform.compliance) == 0.0:
        return
    for name, hinge, stiffness in (
        *((hinge, hinge, 1.0 / compliance) for hinge in _HINGES),
        (_PADS, _HINGES[1], touch.PADS_TURN),
    ):
        inverse = float(model.dof_invweight0[model.jnt_dofadr[model.joint(hinge).id]])
        model.eq_solref[model.equality(name).id] = spring(stiffness, inverse)


class MujocoLean:
    """Places the points of a leaning model, and reads its state.

    Args:
        model: of `build`.
        parameters: of the world.
    """

    def __init__(self, model: Any, parameters: WorldParameters) -> None:
        self._model, self._parameters = model, parameters
        self._points = int(model.geom("bar1_0").id)
        self._plane = int(model.geom("target").id) if parameters.target.present else -1
        names = _HINGES if parameters.platform.compliance > 0.0 else ()
        self._hinges = [int(model.joint(name).qposadr[0]) for name in names]
        self._pads = int(model.equality(_PADS).id) if names else -1
        self._about_y = int(model.joint(_HINGES[1]).dofadr[0]) if names else -1
        self._tip, self._yaw = touch.PADS_TURN, touch.level_yaw(parameters)

    def lie(self, position: tuple[float, float, float], x: float, y: float) -> None:
        """Place the points on the bars' overlap with the target's centre at (x, y) in end_effector, m.

        Args:
            position: of the platform, m; the target's face stays where it leaves the centre.
            x: m.
            y: m.
        """
        place = places(self._parameters, x, y)
        self._model.geom_pos[self._points : self._points + len(place)] = place
        self._model.geom_pos[self._plane] = (position[0] + x, position[1] + y, self._parameters.target.z)

    def turn_back(self, data: Any) -> None:
        """Set the pads' effect in MuJoCo's next step from force and tilt of the last one."""
        if not self._hinges:
            return
        moment = self._tip * (float(data.qpos[self._hinges[1]]) - self._yaw)
        most = touch.PAD * sum(force for _, force in self._pressed(data))
        both = abs(moment) <= most
        data.eq_active[self._pads] = both
        data.qfrc_applied[self._about_y] = 0.0 if both else -math.copysign(most, moment)

    def _pressed(self, data: Any) -> Iterator[tuple[int, float]]:
        """Yield the number of every point in contact and its force along z, N."""
        contacts = data.contact
        for index in range(data.ncon):
            row = int(contacts.efc_address[index])
            if row >= 0:
                # The rows of the contact's frame are its axes; the third column has their z components.
                pressed = -float(contacts.frame[index].reshape(3, 3)[:, 2] @ data.efc_force[row : row + 3])
                yield max(contacts.geom[index]) - self._points, pressed

    def read(self, data: Any) -> tuple[float, tuple[float, float], touch.Bars]:
        """Return force along z (N), tilt about x and y (rad), and forces on the bars."""
        forces, points = {1: 0.0, -1: 0.0}, {1: 0, -1: 0}
        for number, force in self._pressed(data):
            layer, side, _ = _NAMES[number]
            forces[side] += force
            points[side] += layer == "bar"
        tilt = tuple(float(data.qpos[hinge]) for hinge in self._hinges)
        bars = touch.Bars(forces[1], forces[-1], points[1] / POINTS, points[-1] / POINTS)
        return forces[1] + forces[-1], (tilt[0], tilt[1]) if tilt else (0.0, 0.0), bars


STEP = 0.001  # s; with `discrete`, the settled force is as accurate as at a tenth of it

_LOG = logging.getLogger(__name__)
_DEAD = 1e-12  # N·m, torque range of an unpowered servo; MuJoCo needs a range


class MujocoMechanics(motion.Motion):
    """Motion by MuJoCo; NaN once MuJoCo has diverged.

    Args:
        parameters: of the world.
        geometry: of the delta.
        start: of the platform, m, charger_base.
        step: of MuJoCo, s; a world's step consists of several.
        integrator: one of `integrators()`; "" = the best of them.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ParameterError: the reference does not support a parameter.
        ValueError: the integrator is unknown.
    """

    def __init__(
        self,
        parameters: WorldParameters,
        geometry: DeltaGeometry,
        start: Vector,
        step: float = STEP,
        integrator: str = "",
    ) -> None:
        super().__init__(parameters, start)
        self._mujoco = load()
        # Otherwise MuJoCo writes a file to the current folder when it diverges.
        self._mujoco.set_mju_user_warning(_LOG.warning)
        self._step = step
        self.model: Any = build(parameters, geometry, step, integrator or integrators()[0])
        self.data: Any = self._mujoco.MjData(self.model)
        names = [f"arm{index}" for index in range(LIMB_COUNT)]
        self._arms = [int(self.model.joint(name).qposadr[0]) for name in names]
        self._axes = [int(self.model.joint(axis).qposadr[0]) for axis in "xyz"]
        self._leaning = (
            MujocoLean(self.model, parameters) if touch.tilts(parameters) and parameters.target.present else None
        )
        self._begin(geometry, start)
        self._read()

    def _begin(self, geometry: DeltaGeometry, start: Vector) -> None:
        """Place arms, rods and platform so that the loops are closed."""
        angles = scalar.ScalarDelta(geometry).inverse(*start)
        if math.isnan(angles[0]):
            raise ValueError(f"start {start!r} is out of the arm's reach: give a point in its workspace (m)")
        for index, angle in enumerate(angles):
            pitch, swing = passive_joints.rod_angles(geometry, index, start, angle)
            for name, value in (("arm", angle), ("pitch", pitch), ("swing", swing)):
                self.data.joint(f"{name}{index}").qpos[0] = value
        for axis, value in zip(self._axes, start, strict=True):
            self.data.qpos[axis] = value

    def step(
        self, dt: float, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector, x: float, y: float
    ) -> None:
        """Advance by `dt` s, rounded to whole steps of MuJoCo; arguments as of `Motion.step`."""
        inputs = (enabled, reference, limit)
        if inputs != self._inputs:
            self._inputs = inputs
            self._command(enabled, reference, limit)
        data, model, present = self.data, self.model, self._parameters.target.present
        if self._leaning is not None:
            self._leaning.lie(self.position, x, y)
        magnets, applied, (along_x, along_y, along_z) = self._parameters.magnets, data.qfrc_applied, self._axes
        centre_x, centre_y = self.position[0] + x, self.position[1] + y
        for _ in range(max(1, round(dt / self._step))):
            if present:
                side_x, side_y = centre_x - float(data.qpos[along_x]), centre_y - float(data.qpos[along_y])
                gap, offset = self._target_z - float(data.qpos[along_z]), math.hypot(side_x, side_y)
                self.magnet_force, aligning = pull(magnets, gap, offset), side_pull(magnets, gap, offset)
                applied[along_x], applied[along_y], applied[along_z] = (
                    aligning * side_x,
                    aligning * side_y,
                    self.magnet_force,
                )
            if self._leaning is not None:
                self._leaning.turn_back(data)
            self._mujoco.mj_step(model, data)
        self._read()

    def _command(self, enabled: tuple[bool, bool, bool], reference: Vector, limit: Vector) -> None:
        servo, model = self._parameters.servo, self.model
        for index, (on, goal, bound, gain, braking) in enumerate(
            zip(enabled, reference, limit, self.gains, self.brakes, strict=True)
        ):
            k, d = servo.stiffness * gain, servo.damping * braking
            most = min(bound * servo.torque_constant, servo.stall_torque) if on else 0.0
            model.actuator_forcerange[index] = (-max(most, _DEAD), max(most, _DEAD))
            model.actuator_gainprm[index, 0] = k if on else 0.0
            model.actuator_biasprm[index, 1:3] = (-k, -d) if on else (0.0, 0.0)
            model.dof_frictionloss[self._arms[index]] = servo.friction if on else servo.unpowered_friction
            self.data.ctrl[index] = goal

    def _read(self) -> None:
        data = self.data
        place, speed, force = data.qpos.tolist(), data.qvel.tolist(), data.actuator_force.tolist()
        x, y, z = self._axes
        first, second, third = self._arms
        self.position = (place[x], place[y], place[z])
        self.velocity = (speed[x], speed[y], speed[z])
        self.angles = (place[first], place[second], place[third])
        self.rates = (speed[first], speed[second], speed[third])
        self.torques = (force[0], force[1], force[2])
        if self._leaning is not None:
            self.contact_force, self.tilt, self._bars = self._leaning.read(data)
        else:
            rows = [int(row) for row in data.contact.efc_address] if data.ncon else []
            self.contact_force = float(sum(data.efc_force[row] for row in rows if row >= 0))
        self.peak_force = self.contact_force


def mujoco_world(
    parameters: WorldParameters,
    tactile: Any = None,
    seed: int = 0,
    geometry: DeltaGeometry | None = None,
    step: float = STEP,
    integrator: str = "",
) -> world.World:
    """Return a World moved by MuJoCo in steps of `step` s; arguments as of World and MujocoMechanics.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ParameterError: the reference does not support a parameter.
        ValueError: the integrator is unknown.
    """

    moved = functools.partial(MujocoMechanics, step=step, integrator=integrator)
    return world.World(parameters, tactile, seed, geometry, mechanics=moved)


def pull(magnets: MagnetParameters, gap: float, offset: float) -> float:
    """Return the pull (N, toward the target) at a `gap` and lateral `offset` (m)."""
    share = max(magnets.floor, 1.0 / (1.0 + (offset / magnets.width) ** 2))
    ratio = 1.0 + max(gap, 0.0) / magnets.range
    return magnets.force * share / (ratio * ratio)


def side_pull(magnets: MagnetParameters, gap: float, offset: float) -> float:
    """Return the pull toward the target's centre per lateral offset (N/m) at a `gap` and `offset` (m)."""
    share = 1.0 / (1.0 + (offset / magnets.width) ** 2)
    if share <= magnets.floor:
        return 0.0
    return 2.0 * magnets.force * magnets.range * share**2 / (magnets.width**2 * (1.0 + max(gap, 0.0) / magnets.range))
