# SPDX-License-Identifier: Apache-2.0
"""Without nav2_msgs, a node that needs it ends with one line and 2, as a process and in a charger."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from deltacharger_scenes.scene import load_scene

from ..chargers import Process
from ..running_charger import node_command

pytestmark = [pytest.mark.ros, pytest.mark.rest]


@pytest.mark.parametrize("what", ["mock_navigator_node", "mission_node", "up"])
def test_a_process_that_needs_nav2_msgs_ends_with_2_and_names_it(
    start: Callable[..., Process],
    deltacharger: tuple[str, ...],
    namespace: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    what: str,
) -> None:
    text = "raise ModuleNotFoundError(\"No module named 'nav2_msgs'\", name='nav2_msgs')\n"
    (tmp_path / "nav2_msgs.py").write_text(text, encoding="utf-8")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    if what == "up":
        process = start(*deltacharger, "up", "--scene", "mission", "--namespace", namespace)
    else:
        process = start(*node_command(load_scene("mission"), what, namespace))
    assert process.end() == 2
    assert "needs the package nav2_msgs" in process.err[-1]
    assert not any("Traceback" in line for line in process.err)
