# SPDX-License-Identifier: Apache-2.0
"""The page of parameters is what the nodes declare."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deltacharger_lab.pages.parameters import document, every_node

pytestmark = pytest.mark.ros


def test_the_page_is_what_the_nodes_declare(context: Any, namespace: str) -> None:
    pytest.importorskip("cv2", reason="electrode_detector_node needs deltacharger[vision]")
    pytest.importorskip("mcap", reason="docking_recorder_node needs deltacharger[record]")
    page = Path(__file__).parents[2] / "docs" / "parameters.md"
    with every_node(context, namespace) as nodes:
        assert page.read_text(encoding="utf-8") == document(nodes)
