# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes, killed (SIGKILL) and stopped (SIGSTOP, then SIGCONT) during a docking.

Behaviour in every phase is tested in virtual time in test/docking/test_machine_faults.py. Here the devices' side of the
wires shows that the contactor opens in time, that nothing keeps moving, and that a restart of the node is enough.
"""

import signal
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from deltacharger.msg import DockingState

from deltacharger_bringup.scenes.scene import parse_scene
from deltacharger_core.ros import client, messages, outcomes

from ..chargers import wait_until
from ..quick import QUICK
from ..running_charger import GOAL, RunningCharger
from ..waiting import host

pytestmark = pytest.mark.ros

KILL, STOP = signal.SIGKILL, signal.SIGSTOP
NODES = ("servo_node", "tactile_node", "misalignment_node", "kinematics_node", "docking_node")
PHASES = ("locate", "approach", "contact", "measure", "align", "energise", "charging", "retract")
LIMITS = {"servo_node": 0.35, "tactile_node": 0.1, "docking_node": 0.35}  # s until the contactor is open
SLACK = 0.1  # s: an opening's ramp (0.05) and its confirmation, the power stage's cycle and the world's step
SETTLING = 0.003  # m, settling of a loaded arm after a stop
OLDEST = 1.5  # s of permitted age
ENDS = {
    "servo_node": {"SERVO_STALE"},
    "tactile_node": {"TACTILE_STALE", "POWER_STALE", "CONTACTOR_WELDED"},
    "misalignment_node": {"TACTILE_STALE"},
    "mock_detector_node": {"ELECTRODES_NOT_FOUND"},
    # what it finds stale or open when it continues; an opening is not confirmed by stale power
    "docking_node": {"POWER_STALE", "SERVO_STALE", "TACTILE_STALE", "DETECTION_STALE", "CONTACTOR_WELDED"},
    "kinematics_node": set(),
}
CELLS = [(name, number, phase) for phase in PHASES for name in NODES for number in (KILL, STOP)]
CELLS += [("mock_detector_node", number, "locate") for number in (KILL, STOP)]
AGES = {"age_max": OLDEST}
SLOW = {  # quick, but a phase still lasts when it has been published; the target is aside, so that the arm must align
    "nodes": [*NODES, "mock_detector_node"],
    "simulation": {"seed": 1, "rig_seed": 1, "world": {"target": {"x": 10e-3, "y": 10e-3}}},
    "parameters": {
        "docking_node": QUICK["parameters"]["docking_node"]
        | {"home_z": 0.05, "travel_speed": 0.1, "charge_stable_time": 0.5, **AGES}
    },
}


@pytest.mark.witness
@pytest.mark.parametrize("name", ["docking_node", "servo_node"])
def test_the_contactor_opens_after_a_node_was_killed_while_charging(context: Any, name: str) -> None:
    with RunningCharger(parse_scene(QUICK, "killed"), context, apart=[name]) as charger:
        charger.charge()
        assert charger.opened(charger.signal(KILL, name)) <= host(LIMITS[name]) + SLACK
        charger.assert_unharmed()


@pytest.fixture(scope="module")
def charger(context: Any) -> Iterator[RunningCharger]:
    scene = parse_scene(SLOW, "struck")
    with RunningCharger(scene, context, apart=scene.nodes) as charger:
        yield charger


def begin(charger: RunningCharger, phase: str, then: Callable[[], None]) -> Any:
    """Dock or undock into a phase, then act; return the future of the goal's outcome, None if it has ended."""
    if charger.struck:  # a failed cell must not fail the next ones
        for name in list(charger.struck):
            charger.restart(name)
        charger.wait_until_ready()
    if charger.state.docked:
        charger.go_home()
    if phase in ("charging", "retract"):
        charger.charge()
    if phase == "charging":
        then()
        return None
    request = outcomes.DockRequest(None) if phase == "locate" else GOAL
    act = charger.undock if phase == "retract" else lambda: charger.dock(request)
    return charger.begin(phase, act, then)


def wait(charger: RunningCharger, seconds: float) -> None:
    """Wait for some seconds of the world."""
    end = charger.world.time + seconds
    wait_until(lambda: charger.world.time >= end, "the world to go on")


def assert_moves_little(charger: RunningCharger, after: float) -> None:
    """Check that after some seconds nothing keeps moving."""
    wait(charger, after)
    place = charger.world.snapshot().position
    wait(charger, 1.0)
    moved = [abs(a - b) for a, b in zip(place, charger.world.snapshot().position, strict=True)]
    assert max(moved) < SETTLING


def assert_ended(charger: RunningCharger, goal: Any, name: str) -> None:
    """Wait for the end of the goal, or of supervision after its success, and check it."""
    if goal is not None:
        outcome = goal.result()
        assert outcome.success or outcome.error_name in ENDS[name], outcome
    elif name in LIMITS:
        wait_until(lambda: charger.state.error_code, "a code in docking_state")
        wait_until(lambda: charger.state.state == DockingState.STATE_IDLE, "the way back")
        assert messages.CODES[charger.state.error_code] in ENDS[name], charger.state.error_message


@pytest.mark.night
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "number", "phase"), CELLS, ids=lambda value: value.name if isinstance(value, signal.Signals) else value
)
def test_a_struck_node_does_no_harm_and_a_restart_is_enough(
    charger: RunningCharger, name: str, number: int, phase: str
) -> None:
    was: list[tuple[bool, float]] = []  # whether the contactor was closed at which time, s of the world

    def strike() -> None:
        was.append((charger.world.circuit.closed, charger.signal(number, name)))

    goal = begin(charger, phase, strike)
    ((closed, at),) = was
    if closed and name in LIMITS:
        assert charger.opened(at) <= host(LIMITS[name]) + SLACK
    if name in ("docking_node", "servo_node"):
        assert_moves_little(charger, 0.6)
    elif (name, phase) == ("tactile_node", "approach"):
        assert_moves_little(charger, OLDEST + 0.2)  # without touch only retraction is possible
    if number == STOP:
        wait(charger, 1.0)
        charger.restart(name)
    if (name, number) != ("docking_node", KILL):
        assert_ended(charger, goal, name)
    elif goal is not None:
        with pytest.raises(client.ClientError):
            goal.result()
    if number == KILL:
        charger.restart(name)
    charger.wait_until_ready()
    charger.go_home()


@pytest.mark.night
@pytest.mark.timeout(300)
def test_all_nodes_are_stopped_at_once_and_continue(charger: RunningCharger) -> None:
    """Like a suspended computer: no node notices the time, and nothing that opened closes again."""
    charger.charge()
    at = charger.signal(STOP, *NODES)
    assert charger.opened(at) <= host(LIMITS["tactile_node"]) + SLACK
    wait(charger, 3.0)
    for name in reversed(NODES):
        charger.restart(name)
    wait_until(lambda: charger.state.error_code, "a code in docking_state")
    assert messages.CODES[charger.state.error_code] in ("SERVO_STALE", "POWER_STALE"), charger.state.error_message
    wait_until(lambda: charger.state.state == DockingState.STATE_IDLE, "the way back")
    assert not [event for event in charger.world.since(0, 0, True) if event.time > at]
    charger.go_home()
