# SPDX-License-Identifier: Apache-2.0
"""Marks additional cases of a parametrised test for `make test-rest`."""

from __future__ import annotations

from typing import Any

import pytest


def slow(*values: Any) -> Any:
    """Return one case marked slow."""
    return pytest.param(*values, marks=pytest.mark.slow)
