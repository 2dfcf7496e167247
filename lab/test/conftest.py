# SPDX-License-Identifier: Apache-2.0
"""The laboratory's tests use the helpers of the product's tests, by the name `test`, also where they run alone."""

import sys
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType

if "test" not in sys.modules:
    sys.modules["test"] = ModuleType("test")
    sys.modules["test"].__path__ = [str(Path(__file__).parents[2] / "test")]

from test.conftest import context, namespace, start  # noqa: F401
from test.sim.conftest import arm  # noqa: F401

INSTALLED = find_spec("deltacharger_lab") is not None
collect_ignore_glob = [] if INSTALLED else ["test_*.py"]


def pytest_report_header() -> list[str]:
    """Say what is left out."""
    return [] if INSTALLED else ["the laboratory is not installed, so its tests are left out: `make lab`"]
