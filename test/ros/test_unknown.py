# SPDX-License-Identifier: Apache-2.0
"""Answers without a measurement contain no number."""

from __future__ import annotations

import math
from typing import Any

import pytest
from deltacharger.msg import Misalignment
from deltacharger.srv import DetectElectrodes, PredictMisalignment, Probe

from deltacharger_ros.unknown import unknown, unknown_misalignment

from ..nodes import numbers


@pytest.mark.parametrize(
    ("kind", "count"),
    [(PredictMisalignment.Response, 14), (DetectElectrodes.Response, 7 + 36 + 3), (Probe.Response, 2)],
)
def test_every_float_of_an_answer_without_measurement_is_nan(kind: Any, count: int) -> None:
    assert 0.0 in list(numbers(kind()))
    found = list(numbers(unknown(kind())))
    assert len(found) == count
    assert all(map(math.isnan, found))


def test_an_unknown_misalignment_has_a_frame_and_no_contact() -> None:
    message = unknown_misalignment()
    assert message.header.frame_id == "end_effector"
    assert (message.contact, message.sure, message.in_range) == (False, False, False)
    assert not len(message.angle_probability)
    assert message.header.stamp == Misalignment().header.stamp
