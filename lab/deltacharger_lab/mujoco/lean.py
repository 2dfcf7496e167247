# SPDX-License-Identifier: Apache-2.0
"""A leaning contact in MuJoCo: tilted target face, platform that yields about x and y, bars that may lift.

Two hinges hold the platform's face, `platform.lever` behind it, with springs of 1/compliance, critical damping and an
inertia; without compliance there are no hinges. The pads add a spring to the hinge about y, at rest if both bear
equally (`tilt.level_yaw`). Once one pad is empty, a moment of the total force at the other pad replaces it. Each bar
touches by points along its overlap with its mate, each with its share of the bar's stiffness and of the stop behind it.
Angles are not assumed small, the target's force is normal to its own face, and friction at the face bends the hinges.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from deltacharger_lab.mujoco.springs import IMPEDANCE, share, share_impedance, spring
from deltacharger_sim.bars import Bars
from deltacharger_sim.parameters import WorldParameters
from deltacharger_sim.tilt import PAD, PADS_TURN, level_yaw

POINTS = 24  # of each bar; with 8, a contact with one lifted end presses up to 1 % less
INERTIA = 2.3e-4  # kg·m² of the platform about x and about y: 0.274 kg over a plate of 0.1 m
_RADIUS = 1e-5  # m of a point; on a tilted face a larger one would touch too early
_SPECK = 1e-6  # kg of the face; its mass belongs to the platform
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
        f'<geom name="{layer}{side}_{index}" type="sphere" size="{_RADIUS}" pos="{u!r} {v!r} {w!r}" mass="0" '
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
    held = [(name, name, 0.0) for name in _HINGES] + [(_PADS, _HINGES[1], level_yaw(parameters))]
    return "".join(
        f'<joint name="{name}" joint1="{hinge}" polycoef="{rest!r} 0 0 0 0" {how}/>' for name, hinge, rest in held
    )


def places(parameters: WorldParameters, x: float, y: float) -> list[tuple[float, float, float]]:
    """Return every point's position in the face (m) with the target's centre at (x, y) in end_effector, m."""
    terminal = parameters.terminal
    half, up = 0.5 * max(terminal.length - abs(x), 0.0), 0.5 * (terminal.gap + terminal.height)
    front = parameters.platform.lever - _RADIUS
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
        (_PADS, _HINGES[1], PADS_TURN),
    ):
        inverse = float(model.dof_invweight0[model.jnt_dofadr[model.joint(hinge).id]])
        model.eq_solref[model.equality(name).id] = spring(stiffness, inverse)


class MujocoLean:
    """Places the points of a leaning model, and reads its state.

    Args:
        model: of `mujoco_model.build`.
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
        self._tip, self._yaw = PADS_TURN, level_yaw(parameters)

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
        most = PAD * sum(force for _, force in self._pressed(data))
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

    def read(self, data: Any) -> tuple[float, tuple[float, float], Bars]:
        """Return force along z (N), tilt about x and y (rad), and forces on the bars."""
        forces, points = {1: 0.0, -1: 0.0}, {1: 0, -1: 0}
        for number, force in self._pressed(data):
            layer, side, _ = _NAMES[number]
            forces[side] += force
            points[side] += layer == "bar"
        tilt = tuple(float(data.qpos[hinge]) for hinge in self._hinges)
        bars = Bars(forces[1], forces[-1], points[1] / POINTS, points[-1] / POINTS)
        return forces[1] + forces[-1], (tilt[0], tilt[1]) if tilt else (0.0, 0.0), bars
