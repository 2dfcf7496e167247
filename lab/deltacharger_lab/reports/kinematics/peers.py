# SPDX-License-Identifier: Apache-2.0
"""General solvers that a user could apply to the delta instead, each set up as in its manual.

All solve every pose separately from the same start, arms level, with the tightest possible tolerances. A solver that
is not installed is reported as absent, with the reason.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from deltacharger_core.arrays import Array
from deltacharger_kinematics import DeltaGeometry
from deltacharger_kinematics.geometry import LIMB_DIRECTIONS

_TIGHT = 1e-16  # requested residual; below the precision of doubles, so that a solver stops at its best
_STEPS = 50
_START_POSITION = (0.0, 0.0, 0.055)  # of forward solvers: the middle of the workspace box


@dataclass(frozen=True)
class Peer:
    """One general solver.

    Attributes:
        name: in the tables.
        setup: its equations and settings.
        inverse: arm angles (3,) of one point (3,); None = no inverse here.
        inverse_array: arm angles (n, 3) of points (n, 3) in one call; None = no such call.
        forward: position (3,) of arm angles (3,); None = no forward here.
    """

    name: str
    setup: str
    inverse: Callable[[Array], Any] | None = None
    inverse_array: Callable[[Array], Array] | None = None
    forward: Callable[[Array], Any] | None = None


def load(geometry: DeltaGeometry) -> tuple[list[Peer], dict[str, str]]:
    """Return the peers that can be imported, and for others name and reason."""
    found: list[Peer] = []
    absent: dict[str, str] = {}
    for name, build in (("casadi", _casadi), ("pinocchio", _pinocchio), ("scipy", _scipy)):
        try:
            found += build(geometry)
        except (ImportError, OSError) as error:  # OSError: one of the module's libraries is missing
            hint = "" if name == "scipy" else "; install deltacharger-lab[peers]"
            absent[name] = f"{error}{hint}"
    return found, absent


def _casadi(geometry: DeltaGeometry) -> list[Peer]:
    import casadi

    angles, position = casadi.SX.sym("angles", 3), casadi.SX.sym("position", 3)
    gaps = []
    for index, (cosine, sine) in enumerate(LIMB_DIRECTIONS):
        radius = geometry.radius_difference + geometry.arm * casadi.cos(angles[index])
        height = geometry.arm * casadi.sin(angles[index]) - geometry.z_offset
        rod = position - casadi.vertcat(radius * cosine, radius * sine, height)
        gaps.append(casadi.sumsqr(rod) - geometry.rod**2)
    closure = casadi.vertcat(*gaps)
    options = {"abstol": _TIGHT, "abstolStep": _TIGHT, "max_iter": _STEPS, "error_on_fail": False}
    setup = (
        f"rootfinder on the three closure equations, abstol and abstolStep {_TIGHT:g}, at most {_STEPS} steps; "
        "arrays by Function.map"
    )
    peers = []
    for plugin in ("newton", "fast_newton"):
        inverse = casadi.rootfinder("inverse", plugin, {"x": angles, "p": position, "g": closure}, options)
        forward = casadi.rootfinder("forward", plugin, {"x": position, "p": angles, "g": closure}, options)
        one, back = _casadi_one(inverse, 0.0), _casadi_one(forward, _START_POSITION)
        peers.append(Peer(f"casadi {plugin}", setup, one, _casadi_array(inverse), back))
    buffered = "the same through Function.buffer, which avoids the conversion of arguments and results"
    peers.append(Peer("casadi fast_newton, buffers", buffered, _casadi_buffered(inverse, np.zeros(3))))
    return peers


def _casadi_one(solver: Any, start: Any) -> Callable[[Array], Any]:
    def solve(parameter: Array) -> Any:
        return solver(start, parameter).nonzeros()

    return solve


def _casadi_buffered(solver: Any, start: Array) -> Callable[[Array], Any]:
    buffer, trigger = solver.buffer()
    parameter, answer = np.zeros(3), np.zeros(3)
    for index, values in enumerate((start, parameter)):
        buffer.set_arg(index, memoryview(values.data))
    buffer.set_res(0, memoryview(answer.data))

    def solve(given: Array, keep: Any = (buffer, start)) -> Array:  # casadi keeps no reference to the memory
        parameter[:] = given
        trigger()
        return answer.copy()

    return solve


def _casadi_array(solver: Any) -> Callable[[Array], Array]:
    mapped: dict[int, Any] = {}  # casadi needs one function per size; built outside the timed calls

    def solve(points: Array) -> Array:
        size = len(points)
        if size not in mapped:
            mapped[size] = solver.map(size)
        return np.asarray(mapped[size](np.zeros((3, size)), points.T), dtype=np.float64).T

    return solve


def _scipy(geometry: DeltaGeometry) -> list[Peer]:
    from scipy.optimize import root

    cosines, sines = np.array(LIMB_DIRECTIONS).T
    square = geometry.rod**2

    def rods(position: Array, angles: Array) -> tuple[Array, Array, Array]:
        radius = geometry.radius_difference + geometry.arm * np.cos(angles)
        height = position[2] + geometry.z_offset - geometry.arm * np.sin(angles)
        return position[0] - radius * cosines, position[1] - radius * sines, height

    def gaps(angles: Array, position: Array) -> Array:
        x, y, z = rods(position, angles)
        return np.asarray(x * x + y * y + z * z - square)

    def slopes(angles: Array, position: Array) -> Array:
        x, y, z = rods(position, angles)
        outward = x * cosines + y * sines
        return np.diag(2.0 * geometry.arm * (outward * np.sin(angles) - z * np.cos(angles)))

    def forward_slopes(position: Array, angles: Array) -> Array:
        return 2.0 * np.stack(rods(position, angles), axis=-1)

    def inverse(point: Array) -> Any:
        return root(gaps, np.zeros(3), args=(point,), jac=slopes, tol=_TIGHT).x

    def forward(angles: Array) -> Any:
        return root(lambda p, a: gaps(a, p), _START_POSITION, args=(angles,), jac=forward_slopes, tol=_TIGHT).x

    return [
        Peer("scipy root", f"hybr on the closure equations, exact Jacobian, tol {_TIGHT:g}", inverse, None, forward)
    ]


def _pinocchio(geometry: DeltaGeometry) -> list[Peer]:
    import pinocchio

    model, frames = _pinocchio_model(pinocchio, geometry)
    data = model.createData()
    inward = max(-1.0, -(geometry.radius_difference + geometry.arm) / geometry.rod)
    start = np.tile([0.0, math.acos(inward), 0.0], 3)  # arms level, rods meeting on the axis: a pose of the delta
    world = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    damping = 1e-12 * np.eye(9)  # from the manual's example of inverse kinematics

    def inverse(point: Array) -> Array:
        joints, best, least = start, start, math.inf
        for _ in range(_STEPS):
            pinocchio.computeJointJacobians(model, data, joints)
            pinocchio.updateFramePlacements(model, data)
            error = np.concatenate([point - data.oMf[frame].translation for frame in frames])
            size = float(np.abs(error).max())
            if size < least:
                best, least = joints, size
            elif size > 0.5 * least and least < 1e-12:
                break
            if size <= _TIGHT:
                break
            jacobian = np.vstack([pinocchio.getFrameJacobian(model, data, frame, world)[:3] for frame in frames])
            step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping, error)
            joints = pinocchio.integrate(model, joints, step)
        return np.asarray(best[0::3], dtype=np.float64)

    setup = (
        "one open chain per limb, arm and universal joint; the three rod ends driven to the platform by damped Newton "
        f"(damping 1e-12) until the error stops falling, at most {_STEPS} steps"
    )
    return [Peer("pinocchio Newton", setup, inverse)]


def _pinocchio_model(pinocchio: Any, geometry: DeltaGeometry) -> tuple[Any, list[int]]:
    """Return three limbs as open chains, their platform joints shifted inward, and the frames of the rod ends."""
    model = pinocchio.Model()
    frames = []
    for limb, (cosine, sine) in enumerate(LIMB_DIRECTIONS):
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        radius = geometry.radius_difference
        shoulder = pinocchio.SE3(turn, np.array([radius * cosine, radius * sine, -geometry.z_offset]))
        elbow = pinocchio.SE3(np.eye(3), np.array([geometry.arm, 0.0, 0.0]))
        upward = pinocchio.JointModelRevoluteUnaligned(0.0, -1.0, 0.0)  # from outward toward +z
        arm = model.addJoint(0, upward, shoulder, f"arm_{limb}")
        rod = model.addJoint(arm, upward, elbow, f"rod_{limb}")
        swing = model.addJoint(rod, pinocchio.JointModelRZ(), pinocchio.SE3.Identity(), f"swing_{limb}")
        tip = pinocchio.SE3(np.eye(3), np.array([geometry.rod, 0.0, 0.0]))
        frame = pinocchio.Frame(f"tip_{limb}", swing, tip, pinocchio.FrameType.OP_FRAME)
        frames.append(model.addFrame(frame))
    return model, frames
