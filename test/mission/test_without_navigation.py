# SPDX-License-Identifier: Apache-2.0
"""Without nav2_msgs, a node that needs it ends with one line and 2, as a process and in a charger."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from deltacharger_scenes.scene import load_scene

from ..chargers import Process
from ..scenes.test_processes import arguments

pytestmark = pytest.mark.ros


@pytest.fixture(autouse=True)
def without_navigation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "shadow"
    folder.mkdir()
    text = "raise ModuleNotFoundError(\"No module named 'nav2_msgs'\", name='nav2_msgs')\n"
    (folder / "nav2_msgs.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")


@pytest.mark.parametrize("name", ["mock_navigator_node", "mission_node"])
def test_a_node_that_needs_nav2_msgs_ends_with_2_and_one_line(
    start: Callable[..., Process], namespace: str, name: str
) -> None:
    process = start(*arguments(load_scene("mission"), name, namespace))
    assert process.end() == 2
    assert len(process.err) == 1, process.err
    assert "needs the package nav2_msgs" in process.err[0]


def test_a_charger_that_needs_nav2_msgs_ends_with_2(
    start: Callable[..., Process], deltacharger: tuple[str, ...], namespace: str
) -> None:
    process = start(*deltacharger, "up", "--scene", "mission", "--namespace", namespace)
    assert process.end() == 2
    assert "needs the package nav2_msgs" in process.err[-1]
    assert not any("Traceback" in line for line in process.err)
