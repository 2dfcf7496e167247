# SPDX-License-Identifier: Apache-2.0
"""Two chargers side by side, distinguished by their namespaces only, one inside the other's.

Actions, faults and messages of one do not affect the other's arm, contactor, states and goals.
"""

from __future__ import annotations

from typing import Any

import pytest

from deltacharger_ros.messages import CODES
from deltacharger_scenes.scene import Scene, parse_scene

from ..chargers import new_namespace, wait_until
from ..running_charger import QUICK, RunningCharger, up

pytestmark = [pytest.mark.ros, pytest.mark.rest]


def assert_at_rest(charger: RunningCharger, since: int) -> None:
    """Check that an open charger has switched nothing on since a number of events."""
    assert charger.world.events[since:] == []
    assert max(map(abs, charger.world.mechanics.rates)) < 0.01


def test_actions_and_faults_of_one_do_not_affect_the_other(quick_scene: Scene, context: Any) -> None:
    """The one in this process is of mocks, whose faults are easy to set; two of one kind would starve each other."""
    name = new_namespace()
    with (
        RunningCharger(quick_scene, context, namespace=name) as outer,
        RunningCharger(parse_scene(QUICK, "inner"), context, command=up, namespace=f"{name}/inner") as inner,
    ):
        outer.charge()
        assert_at_rest(inner, 0)
        inner.charge()
        events, states = len(inner.world.events), len(inner.states)
        outer.set("mock_servo_node", fault="silence")
        wait_until(lambda: outer.state.error_code, "the outer to notice")
        assert CODES[outer.state.error_code] == "SERVO_FAULT"
        wait_until(lambda: outer.state.state == outer.state.STATE_IDLE, "the end of its retreat")
        outer.set("mock_servo_node", fault="none")
        outer.go_home()
        assert inner.is_closed
        assert (inner.world.events[events:], inner.states[states:]) == ([], [])
        states = len(outer.states)
        inner.go_home()
        assert outer.states[states:] == []
        assert not outer.is_closed
