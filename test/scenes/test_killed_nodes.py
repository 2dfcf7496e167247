# SPDX-License-Identifier: Apache-2.0
"""Nodes as processes, killed (SIGKILL) and stopped (SIGSTOP, then SIGCONT) during the dockings of one charger.

Each node is struck in the phases in which it matters; behaviour common to all phases is tested in virtual time in
test/docking/test_silent_nodes.py. One simulated charger with a recording world serves all tests. Only killed nodes are
restarted, and every following goal confirms that this is enough. With DELTACHARGER_WHOLE_MATRIX=1 every node is struck
in every phase.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest
from deltacharger.msg import DockingState

from deltacharger_ros.messages import CODES

from ..chargers import new_namespace, wait_until
from .killed import NODE_NAMES, OLDEST, Rig

pytestmark = pytest.mark.ros

KILL, STOP = signal.SIGKILL, signal.SIGSTOP
PHASES = ("locate", "approach", "contact", "measure", "align", "energise", "charging", "retract")
LIMITS = {"servo_node": 0.35, "tactile_node": 0.1, "docking_node": 0.35}  # s until the contactor is open
SLACK = 0.1  # s: an opening's ramp (0.05) and its confirmation, the power stage's cycle and the world's step
STOPPED = 1.0  # s
SETTLING = 0.003  # m, settling of a loaded arm after a stop
ENDS = {
    "servo_node": {"SERVO_FAULT"},
    "tactile_node": {"TACTILE_STALE", "POWER_STALE", "CONTACTOR_WELDED"},
    "misalignment_node": {"TACTILE_STALE"},
    "mock_detector_node": {"ELECTRODES_NOT_FOUND"},
    "docking_node": {"POWER_STALE", "SERVO_FAULT", "TACTILE_STALE"},  # what it finds stale or open when it continues
    "kinematics_node": set(),
}
CELLS = [
    ("mock_detector_node", KILL, "locate"),
    ("docking_node", KILL, "approach"),
    ("docking_node", STOP, "approach"),
    ("tactile_node", KILL, "approach"),
    ("servo_node", STOP, "contact"),
    ("misalignment_node", KILL, "measure"),
    ("docking_node", STOP, "align"),
    ("kinematics_node", KILL, "energise"),
    ("tactile_node", KILL, "charging"),
    ("servo_node", KILL, "charging"),
    ("docking_node", KILL, "charging"),
    ("docking_node", KILL, "retract"),
]
if "DELTACHARGER_WHOLE_MATRIX" in os.environ:
    struck = [(name, number) for name in NODE_NAMES for number in (KILL, STOP)]
    CELLS = [(name, number, phase) for phase in PHASES for name, number in struck]
    CELLS += [("mock_detector_node", number, "locate") for number in (KILL, STOP)]
_CHILD = "DELTACHARGER_STRIKES_NODES"
in_a_child = pytest.mark.skipif(_CHILD not in os.environ, reason="run by test_nodes_are_struck")


@pytest.mark.rest
@pytest.mark.timeout(3600 if "DELTACHARGER_WHOLE_MATRIX" in os.environ else 600)
@pytest.mark.skipif(_CHILD in os.environ, reason="this is the child")
def test_nodes_are_struck() -> None:
    """Run the tests below in a separate process: rclpy has crashed in a client whose action server was killed."""
    command = [sys.executable, "-m", "pytest", "-q", "--durations=0", __file__]
    for _ in range(2):
        child = subprocess.run(command, env=os.environ | {_CHILD: "1"}, capture_output=True, text=True, check=False)
        if child.returncode >= 0:  # else a signal ended it, not a failed test
            break
    assert child.returncode == 0, child.stdout[-6000:] + child.stderr[-2000:]
    print(child.stdout[-6000:])


@pytest.fixture(scope="module")
def rig(context: Any) -> Iterator[Rig]:
    rig = Rig(context, new_namespace())
    yield rig
    rig.close()


@in_a_child
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    ("name", "number", "phase"), CELLS, ids=lambda value: value.name if isinstance(value, signal.Signals) else value
)
def test_a_node_is_struck(rig: Rig, name: str, number: int, phase: str) -> None:
    rig.pulse.attempt(lambda: strike(rig, name, number, phase), lambda: recover(rig, name))


def strike(rig: Rig, name: str, number: int, phase: str) -> None:
    rig.begin(phase)
    before = rig.charger.world.time  # an opening in progress may end between the next lines
    closed, start = rig.charger.world.circuit.closed, rig.place
    rig.send(name, number)
    if closed and name in LIMITS:
        after = rig.opened(before)
        print(f"{name} {signal.Signals(number).name} {phase}: open after {1e3 * after:.0f} ms")
        assert after <= LIMITS[name] + SLACK
    if name in ("docking_node", "servo_node"):
        rig.wait(0.6)
        place = rig.place
        rig.wait(1.0)
        assert max(abs(a - b) for a, b in zip(place, rig.place, strict=True)) < SETTLING, "nothing keeps moving"
        assert rig.place[2] - start[2] < 0.02
    elif (name, phase) == ("tactile_node", "approach"):
        rig.wait(OLDEST + 0.2)
        place = rig.place
        rig.wait(1.0)
        assert rig.place[2] - place[2] < SETTLING, "without touch only retraction is possible"
    if number == STOP:
        rig.wait(STOPPED)
        rig.restart(name)
    ends(rig, name, number, phase)
    recover(rig, name)
    rig.assert_never_hurt()


def ends(rig: Rig, name: str, number: int, phase: str) -> None:
    """Wait for the end of the goal, or of supervision after its success, and check it."""
    if name == "docking_node" and number == KILL:
        rig.reap(name)
        wait_until(lambda: not rig.client.answers(), "the client to see that the server is gone")
        rig.give_up()
        return
    if phase == "charging":
        if name in LIMITS:
            wait_until(lambda: rig.state.error_code, "a code in docking_state")
            wait_until(lambda: rig.state.state == DockingState.STATE_IDLE, "the way back")
            assert CODES[rig.state.error_code] in ENDS[name], rig.state.error_message
        return
    wait_until(lambda: rig.outcome or rig.error, "the goal's end")
    assert rig.outcome is not None, rig.error
    if not rig.outcome.success:
        assert rig.outcome.error_name in ENDS[name], rig.outcome
        assert rig.outcome.error_message


def recover(rig: Rig, name: str) -> None:
    rig.restart(name)
    rig.ready()
    rig.go_home()


@in_a_child
@pytest.mark.timeout(300)
def test_all_nodes_are_stopped_at_once_and_continue(rig: Rig) -> None:
    """Like a suspended computer: no node notices the time, and nothing that opened closes again."""
    rig.begin("charging")
    at = [rig.send(name, STOP) for name in NODE_NAMES][-1]
    assert rig.opened(at) <= LIMITS["tactile_node"] + SLACK
    rig.wait(3.0)
    for name in reversed(NODE_NAMES):
        rig.restart(name)
    wait_until(lambda: rig.state.error_code, "a code in docking_state")
    assert CODES[rig.state.error_code] in ("SERVO_FAULT", "POWER_STALE"), rig.state.error_message
    wait_until(lambda: rig.state.state == DockingState.STATE_IDLE, "the way back")
    assert not [event for event in rig.charger.world.since(0, 0, True) if event.time > at]
    rig.go_home()
    rig.assert_never_hurt()


@in_a_child
@pytest.mark.timeout(300)
def test_after_all_cases_it_docks(rig: Rig) -> None:
    rig.begin("charging")
    rig.go_home()
    rig.assert_never_hurt()
