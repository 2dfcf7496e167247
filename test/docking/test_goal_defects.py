# SPDX-License-Identifier: Apache-2.0
"""An internal error at the beginning of a goal: the client gets INTERNAL, and nothing continues unserved."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from deltacharger_scenes.scene import Scene

from ..chargers import wait_until
from .hostile import Hostile

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def hostile(quick_scene: Scene, context: Any) -> Iterator[Hostile]:
    hostile = Hostile(quick_scene, context)
    yield hostile
    hostile.close()


def fail_once(patch: pytest.MonkeyPatch, owner: Any, name: str) -> None:
    """Let the next call of a method raise after its work."""
    works = getattr(owner, name)

    def fail(*words: Any, **options: Any) -> Any:
        patch.undo()
        works(*words, **options)
        raise RuntimeError("a defect at the beginning")

    patch.setattr(owner, name, fail)


@pytest.mark.parametrize(("part", "does"), [("_machine", "_record_goal"), ("_goals", "_begun")])
def test_a_defect_at_the_beginning_of_a_goal_ends_it_and_leaves_the_charger_free(
    hostile: Hostile, part: str, does: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile.heal()
    with monkeypatch.context() as patch:
        fail_once(patch, getattr(hostile.docking, part), does)
        outcome = hostile.dock()
    assert (outcome.success, outcome.error_name) == (False, "INTERNAL"), outcome
    assert "a defect at the beginning" in outcome.error_message
    assert not hostile.docking._machine.busy, "the machine continues without a client"
    wait_until(lambda: hostile.is_idle() and not hostile.servos.torque_enabled, "an arm at rest")
    assert not hostile.is_closed
    hostile.charge()


def test_a_defect_at_the_beginning_of_undock_opens_the_contactor(
    hostile: Hostile, monkeypatch: pytest.MonkeyPatch
) -> None:
    hostile.heal()
    hostile.charge()
    with monkeypatch.context() as patch:
        fail_once(patch, hostile.docking._goals, "_begun")
        outcome = hostile.client.undock(deadline=20.0)
    assert outcome.error_name == "INTERNAL", outcome
    assert hostile.opens_after() < 1.0
    assert not hostile.docking._machine.busy
    hostile.heal()
