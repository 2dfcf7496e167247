# SPDX-License-Identifier: Apache-2.0
"""Every solver of the report behind one interface: ours, the closed forms and the peers."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from deltacharger_core.arrays import Array, Mask
from deltacharger_kinematics import Delta, DeltaGeometry
from deltacharger_kinematics.limb_arrays import LimbArrays
from deltacharger_kinematics.modes import KNEE_OUT
from deltacharger_kinematics.scalar import ScalarDelta
from deltacharger_lab.reports.kinematics import forms
from deltacharger_lab.reports.kinematics.peers import Peer

Family = Literal["ours", "form", "peer"]
ARRAY, PRECISE, POINT, SCALAR = "Delta.inverse, array", "Delta.inverse, precise", "Delta.inverse, point", "ScalarDelta"
OURS = (ARRAY, PRECISE, POINT, SCALAR)
_CLOSED = 1e-9  # m; a peer's answer with a larger error of a rod's length does not count
_BELIEVED = 1e-12  # m; with smaller errors of the rods a user would assume "reachable"


@dataclass(frozen=True)
class Solver:
    """A function from triples (points or angles) to triples.

    Attributes:
        name: in the tables.
        family: ours, a closed form or a peer.
        array: (n, 3) to (n, 3) in one call; None = no such call.
        one: a single triple; None = arrays only.
        takes: argument of `one`: three floats, one tuple, or one array.
        rods: of this robot must close for a valid answer; None = every answer is valid.
    """

    name: str
    family: Family
    array: Callable[[Array], Array] | None = None
    one: Callable[..., Any] | None = None
    takes: Literal["floats", "tuple", "array"] = "floats"
    rods: DeltaGeometry | None = None

    def each(self, triples: Array) -> Callable[[], list[Any]] | None:
        """Return a call that solves triples (n, 3) one by one; None without `one`."""
        one = self.one
        if one is None:
            return None
        rows = triples if self.takes == "array" else [tuple(row) for row in triples.tolist()]
        arguments = rows if self.takes == "floats" else [(row,) for row in rows]
        return lambda: [one(*each) for each in arguments]

    def solve(self, triples: Array) -> Array:
        """Return the valid answers (n, 3), from the array call if there is one; NaN for others."""
        if self.array is not None:
            answers = self.array(triples)
        else:
            one_by_one = self.each(triples)
            assert one_by_one is not None
            answers = np.array(one_by_one(), dtype=np.float64).reshape(-1, 3)
        if self.rods is None:
            return answers
        return np.where(rod_errors(self.rods, triples, answers) <= _CLOSED, answers, np.nan)


def inverse_solvers(geometry: DeltaGeometry, peers: Sequence[Peer]) -> list[Solver]:
    """Return all solvers from points to angles."""
    delta, scalar = Delta(geometry), ScalarDelta(geometry)

    def precise(points: Any) -> Any:
        return delta.inverse(points, precise=True).angles

    return [
        Solver(ARRAY, "ours", lambda points: delta.inverse(points).angles),
        Solver(PRECISE, "ours", precise, precise, "tuple"),
        Solver(POINT, "ours", None, lambda point: delta.inverse(point).angles, "tuple"),
        Solver(SCALAR, "ours", None, scalar.inverse),
        *_closed(forms.INVERSE_FORMS, forms.inverse_array, forms.inverse_one, geometry),
        *(
            Solver(peer.name, "peer", peer.inverse_array, peer.inverse, "array", geometry)
            for peer in peers
            if peer.inverse
        ),
    ]


def forward_solvers(geometry: DeltaGeometry, peers: Sequence[Peer]) -> list[Solver]:
    """Return all solvers from angles to points."""
    delta, scalar = Delta(geometry), ScalarDelta(geometry)
    return [
        Solver("Delta.forward, array", "ours", lambda angles: delta.forward(angles).position),
        Solver("Delta.forward, point", "ours", None, lambda angles: delta.forward(angles).position, "tuple"),
        Solver(SCALAR, "ours", None, scalar.forward),
        *_closed(forms.FORWARD_FORMS, forms.forward_array, forms.forward_one, geometry),
        *(Solver(peer.name, "peer", None, peer.forward, "array") for peer in peers if peer.forward),
    ]


def _closed(
    solved: Mapping[str, Any], array: Callable[..., Array], one: Callable[..., Any], geometry: DeltaGeometry
) -> list[Solver]:
    return [
        Solver(name, "form", functools.partial(array, form, geometry), functools.partial(one, form, geometry))
        for name, form in solved.items()
    ]


def rod_errors(geometry: DeltaGeometry, points: Array, angles: Array) -> Array:
    """Return the error of each rod's length (n, 3), m, in plain doubles."""
    with np.errstate(invalid="ignore"):
        x, y, z = LimbArrays(geometry, KNEE_OUT).elbows(np.cos(angles.T), np.sin(angles.T))
        elbows = np.stack([x, y, z - geometry.z_offset], axis=-1)
        return np.asarray(np.abs(np.linalg.norm(points - elbows, axis=-1) - geometry.rod).T)


def calls_reachable(solver: Solver, points: Array) -> Mask:
    """Return for which points (n,) a solver has an answer that a user would accept."""
    angles = solver.solve(points)
    if solver.rods is None:
        return np.asarray(np.isfinite(angles).all(-1))
    return np.asarray((rod_errors(solver.rods, points, angles) <= _BELIEVED).all(-1))
