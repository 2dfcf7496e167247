# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
import pytest

from deltacharger_vision.errors import CameraInfoError
from deltacharger_vision.projection import distort, undistort

from .views import DISTORTIONS

GRID = np.stack(np.meshgrid(np.linspace(-0.73, 0.73, 21), np.linspace(-0.46, 0.46, 15)), axis=-1)


@pytest.mark.parametrize("distortion", DISTORTIONS)
def test_distorting_and_undistorting_cancel(distortion: tuple[float, ...]) -> None:
    np.testing.assert_allclose(distort(undistort(GRID, distortion), distortion), GRID, atol=1e-9)
    np.testing.assert_allclose(undistort(distort(GRID, distortion), distortion), GRID, atol=1e-8)


@pytest.mark.parametrize("distortion", DISTORTIONS[1:])
def test_the_distortion_matches_opencv(distortion: tuple[float, ...]) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed (extra vision)")
    points = np.concatenate([GRID, np.ones((*GRID.shape[:2], 1))], axis=-1).reshape(-1, 1, 3)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), np.eye(3), np.array(distortion))
    np.testing.assert_allclose(distort(GRID, distortion), theirs.reshape(GRID.shape), atol=1e-12)


def test_a_lens_that_folds_the_image_is_refused() -> None:
    with pytest.raises(CameraInfoError, match="calibrate"):
        undistort(GRID, (-3.0, 0.0, 0.0, 0.0, 0.0))
