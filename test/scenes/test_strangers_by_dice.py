# SPDX-License-Identifier: Apache-2.0
"""A foreign program with random messages, services and goals in a charger's namespace does no harm.

Beside a second source of what docking relies on no contactor closes. Elsewhere a docking may succeed or fail, with a
code and without an internal error. Current never flows where it must not. The next goal is served.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, TypeAlias

import pytest
from deltacharger.action import Dock, Undock
from deltacharger.msg import ChargerPower, ServoState, TactileFrame
from deltacharger.srv import PredictMisalignment, Probe, SetContactor, SolveForwardKinematics, SolveInverseKinematics
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from ..chargers import wait_until
from ..quick import quick_simulation
from ..running_charger import PATIENT, RunningCharger
from .strangers import Stranger

pytestmark = [pytest.mark.ros, pytest.mark.night]

Come: TypeAlias = Callable[[], Stranger]

ACTS = 100  # of a foreign node while electrodes are live
STEPS = {**PATIENT, "duplicate_source_timeout": 0.5}
TOPICS = {
    "servo_state": ServoState,
    "tactile_frame": TactileFrame,
    "charger_power": ChargerPower,
    "joint_trajectory": JointTrajectory,
}
SERVICES = {
    "predict_misalignment": PredictMisalignment,
    "probe": Probe,
    "set_contactor": SetContactor,
    "set_torque": SetBool,
    "tare": Trigger,
}
ASKED = {
    **SERVICES,
    "reboot_servos": Trigger,
    "solve_inverse_kinematics": SolveInverseKinematics,
    "solve_forward_kinematics": SolveForwardKinematics,
}
CASES = [
    *(("speaks", kind, name, True) for name, kind in TOPICS.items()),
    *(("answers", kind, name, True) for name, kind in SERVICES.items()),
    *(("asks", kind, name, False) for name, kind in ASKED.items()),
    ("sends_goals", Dock, "dock", False),
    ("sends_goals", Undock, "undock", False),
]


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    with RunningCharger(quick_simulation("simulated", STEPS), context) as charger:
        yield charger


@pytest.fixture
def come(charger: RunningCharger, context: Any, act: str, kind: Any, name: str) -> Iterator[Come]:
    """Add a foreign node with the case's behaviour; remaining ones are removed at the end."""
    came: list[Stranger] = []

    def come() -> Stranger:
        came.append(Stranger(context, charger.namespace, seed=len(came)))
        getattr(came[-1], act)(kind, name)
        return came[-1].begin()

    yield come
    for each in came:
        each.leave()


@pytest.mark.parametrize(("act", "kind", "name", "is_source"), CASES, ids=str)
def test_a_stranger_does_no_harm_and_no_contactor_closes_beside_a_second_source(
    charger: RunningCharger, come: Come, is_source: bool
) -> None:
    """Dock beside a foreign node, then without it, and add it again while current flows."""
    energised = charger.world.record.energised
    visitor = come()
    outcome = charger.dock()
    if is_source:
        assert not outcome.success
        assert charger.world.record.energised == energised
    assert outcome.error_name != "INTERNAL", outcome
    visitor.leave()
    charger.assert_unharmed()
    charger.wait_until_single()
    charger.go_home()
    charger.charge()
    visitor = come()
    wait_until(lambda: visitor.acts >= ACTS, "the stranger's acts")
    visitor.leave()
    charger.assert_unharmed()
    charger.wait_until_single()
    charger.go_home()
    assert Dock.Result.INTERNAL not in {state.error_code for state in charger.states}
    assert charger.composition is not None
    assert charger.composition.failed() == []
