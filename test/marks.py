# SPDX-License-Identifier: Apache-2.0
"""Marks cases of a parametrised test that run outside `make test`."""

from typing import Any

import pytest


def rest(*values: Any) -> Any:
    """Return one case for `make test-rest`."""
    return pytest.param(*values, marks=pytest.mark.rest)


def night(*values: Any) -> Any:
    """Return one case for `make test-night`."""
    return pytest.param(*values, marks=pytest.mark.night)
