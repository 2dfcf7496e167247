# SPDX-License-Identifier: Apache-2.0
"""Single cases of a parametrised test that show by more what the others show: part of `make test-rest`."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """Return one case that is marked slow."""
    return pytest.param(*values, marks=pytest.mark.slow)
