# SPDX-License-Identifier: Apache-2.0
"""The charger as a MuJoCo model, from the light model's parameters.

Every limb is a driven arm on a hinge and a rod on a universal joint. The platform slides along x, y and z, as the
parallelograms enforce. Equality constraints tie the rods' ends to it, so that the solver closes the loops and no
formula of the light model is used. The contact faces are a sphere and a plane; the stop behind the electrodes' springs
is a second sphere further back.

Stiffnesses are set by springs.py. If target or platform lean, lean.py replaces the face.
"""

from __future__ import annotations

import math
from typing import Any

from deltacharger_core.parameters import ParameterError
from deltacharger_kinematics.geometry import LIMB_COUNT, DeltaGeometry
from deltacharger_lab.mujoco import lean as mujoco_lean
from deltacharger_lab.mujoco.springs import IMPEDANCE, spring
from deltacharger_sim.parameters import ServoParameters, WorldParameters
from deltacharger_sim.tilt import tilts

TIGHT = 0.9999  # d of stiff constraints: closed loops and dry friction
STICTION = 1e4  # stiffness of friction relative to the contact's normal; with 1, a pressed contact creeps by cm/s
END_STOP = 2000.0  # N·m/rad behind a joint limit, as in the light model
_RADIUS = 0.005  # m of the spheres that model the electrodes
_SPECK = 1e-6  # kg of an arm; its inertia is the rotor's, as in the light model
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
        ("servo.stall_sag", parameters.servo.stall_sag, "loss of stall torque"),
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
    if tilts(parameters):
        mujoco_lean.set_springs(model, parameters)
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
{mujoco_lean.hinges(parameters)}
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
    if tilts(parameters):
        turn = " ".join(map(repr, mujoco_lean.plane_turn(parameters)))
        touching = mujoco_lean.face(parameters)
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
    if tilts(parameters):
        return mujoco_lean.pairs(rub)
    how = f'condim="3" friction="{rub!r} {rub!r}" solimp="{IMPEDANCE} {IMPEDANCE} 0.001"'
    return "".join(f'<pair geom1="target" geom2="{name}" {how}/>' for name in ("electrodes", "stop"))


def _servo(index: int, stiffness: float, damping: float) -> str:
    return (
        f'<general name="servo{index}" joint="arm{index}" gainprm="{stiffness!r}" biastype="affine" '
        f'biasprm="0 {-stiffness!r} {-damping!r}" forcelimited="true" forcerange="-1 1"/>\n'
    )
