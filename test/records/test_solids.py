# SPDX-License-Identifier: Apache-2.0
"""Boxes and bars as faces seen from afar."""

from __future__ import annotations

import math

import numpy as np
import pytest

from deltacharger_records.view.shapes import Boxes
from deltacharger_records.view.solids import Solids

RED, BLUE = (255, 0, 0), (0, 0, 255)


def _box(centre: tuple[float, float, float], colour: tuple[int, int, int], about_z: float = 0.0) -> Boxes:
    boxes = Boxes()
    boxes.add(centre, (0.2, 0.4, 0.6), colour, about_z)
    return boxes


@pytest.mark.parametrize(
    ("eye", "up", "size"),
    [((0, 0, 1), (0, 1, 0), (0.2, 0.4)), ((1, 0, 0), (0, 1, 0), (0.6, 0.4)), ((0, 1, 0), (0, 0, 1), (0.2, 0.6))],
)
def test_a_box_is_as_large_as_its_sides_seen_along_an_axis(
    eye: tuple[float, ...], up: tuple[float, ...], size: tuple[float, float]
) -> None:
    solids = Solids()
    solids.add(_box((1.0, 2.0, 3.0), RED))
    faces, _ = solids.seen(eye, up)
    assert faces.shape == (6, 4, 2)
    assert np.ptp(faces.reshape(-1, 2), axis=0) == pytest.approx(size)


def test_a_box_turns_about_its_own_axis_and_with_its_frame() -> None:
    both, frame = Solids(), Solids()
    both.add(_box((0.0, 0.0, 0.0), RED, about_z=0.3), turn=0.4)
    frame.add(_box((0.0, 0.0, 0.0), RED, about_z=0.7))
    assert both.corners == pytest.approx(frame.corners)
    placed = Solids()
    placed.add(_box((1.0, 0.0, 0.0), RED), (0.0, 0.0, 5.0), math.pi / 2)
    assert placed.corners.reshape(-1, 3).mean(axis=0) == pytest.approx((0.0, 1.0, 5.0))


def test_a_bar_reaches_from_its_first_to_its_last_point() -> None:
    ends = np.array([[(0.0, 0.0, 0.0), (3.0, 4.0, 12.0)]])
    solids = Solids()
    solids.add_bars(ends, 0.1, RED)
    along = solids.corners.reshape(-1, 3) @ (ends[0, 1] / 13.0)
    assert (along.min(), along.max()) == pytest.approx((0.0, 13.0))
    aside = np.linalg.norm(solids.corners.reshape(-1, 3) - along[:, None] * ends[0, 1] / 13.0, axis=1)
    assert aside == pytest.approx(np.full(len(aside), 0.1 * math.sqrt(2.0)))


@pytest.mark.parametrize("eye", [(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_nearer_faces_come_last(eye: tuple[float, float, float]) -> None:
    solids = Solids()
    solids.add(_box((0.0, 0.0, eye[2] * 2.0), BLUE))
    solids.add(_box((0.0, 0.0, 0.0), RED))
    _, colours = solids.seen(eye, (0.0, 1.0, 0.0))
    assert colours[0, 0] > colours[0, 2]
    assert colours[-1, 2] > colours[-1, 0]
