# SPDX-License-Identifier: Apache-2.0
"""Type aliases of arrays. Docstrings state shapes, units and frames."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
