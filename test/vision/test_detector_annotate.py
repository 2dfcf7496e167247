# SPDX-License-Identifier: Apache-2.0
"""The annotated picture."""

from __future__ import annotations

import numpy as np
import pytest

from deltacharger_vision.detector.annotate import annotated
from deltacharger_vision.detector.detector import ElectrodeDetector
from deltacharger_vision.rendering.scene import RenderedScene

from .detector_scenes import pose_at, render

pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")


def test_the_picture_is_an_annotated_copy() -> None:
    image = render(RenderedScene(), pose_at(0.3, roll=0.2), np.random.default_rng(7))
    before = image.color.copy()
    found = ElectrodeDetector().detect(image)
    assert found is not None
    picture = annotated(image, found)
    assert picture.shape == image.color.shape
    assert picture.dtype == np.uint8
    np.testing.assert_array_equal(image.color, before)
    changed = np.any(picture != before, axis=2)
    for x, y in found.bars.reshape(-1, 2):
        near = changed[int(y) - 1 : int(y) + 3, int(x) - 1 : int(x) + 3]
        assert near.any()


def test_a_picture_without_electrodes_is_annotated() -> None:
    image = render(RenderedScene(target=False), pose_at(0.3), np.random.default_rng(8))
    assert np.any(annotated(image, None) != image.color)
