# SPDX-License-Identifier: Apache-2.0
"""What reads a whole report is slow: the report runs first, as a command."""

from __future__ import annotations

from pathlib import Path

import pytest

HERE = Path(__file__).parent


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if (
            item.path.parent == HERE
            and item.path.name.startswith("test_report_")
            and "quick" in getattr(item, "fixturenames", ())
        ):
            item.add_marker(pytest.mark.slow)
