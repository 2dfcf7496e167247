# SPDX-License-Identifier: Apache-2.0
"""Every node killed, and stopped for a second, in every phase, in virtual time.

With any node silent: an energised contactor opens within its limit, the goal ends with a code that names what is
missing (or continues if it needed nothing), nothing keeps moving, nothing is released or pulled apart while it is
live. After the node is back the next goal succeeds on the same charger, which lifts off first if it was pressing.
Real processes are tested in test/scenes/test_killed_nodes.py.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from deltacharger_docking.codes import Code, State

from ..marks import rest
from .silences import OPEN_WITHIN, Faulty

NONE = Code.NONE
PHASES = (
    State.LOCATE,
    State.APPROACH,
    State.CONTACT,
    State.MEASURE,
    State.ALIGN,
    State.ENERGISE,
    State.CHARGING,
    State.RETRACT,
)
TOUCHING = (State.LOCATE, State.APPROACH, State.CONTACT, State.MEASURE, State.ALIGN)
NODES = ("servo_node", "tactile_node", "misalignment_node", "electrode_detector_node", "docking_node")
QUICK = (State.CONTACT, State.ENERGISE, State.CHARGING, State.RETRACT)
STOPPED = 1.0  # s
NOTICED = 0.3  # s after which no line continues
SETTLING = 0.003  # m: settling of a loaded arm where it was stopped


def allowed(node: str, phase: State, killed: bool) -> set[Code]:
    """Return the codes with which the goal, or supervision after its success, may end; NONE = it is not disturbed."""
    if node == "servo_node":
        return {Code.SERVO_FAULT}
    if node == "tactile_node":
        if phase in TOUCHING:
            return {Code.TACTILE_STALE}
        if phase is State.RETRACT:  # the contactor may be closed: the arm stays
            return {Code.CONTACTOR_WELDED}
        return {Code.POWER_STALE} if killed or phase is State.CHARGING else {Code.POWER_STALE, NONE}
    if node == "misalignment_node":
        return {Code.TACTILE_STALE} if killed and phase in (*TOUCHING, State.CHARGING) else {NONE}
    if node == "electrode_detector_node":
        return {Code.ELECTRODES_NOT_FOUND} if killed and phase is State.LOCATE else {NONE}
    return {Code.POWER_STALE} if phase is State.CHARGING else {NONE}


@pytest.fixture(scope="module")
def shared() -> list[Faulty]:
    return []


@pytest.fixture
def run(shared: list[Faulty]) -> Iterator[Faulty]:
    """One charger for all cells, which shows recovery. After a failed cell there is a new one."""
    charger = shared.pop() if shared else Faulty()
    yield charger
    if charger.machine.status.state is State.IDLE and not (charger.silent or charger.has_torque):
        shared.append(charger)


def stays_away(run: Faulty, node: str, phase: State, seconds: float) -> None:
    """Let a node be silent for this time; a closed contactor opens, and nothing keeps moving."""
    closed, start, z = run.closed, run.now, run.world.snapshot().position[2]
    run.silence(node)
    if closed and node in OPEN_WITHIN:
        run.until(lambda: not run.closed, 2.0)
        assert run.now - start <= OPEN_WITHIN[node] + 0.02
    run.run(max(NOTICED - (run.now - start), 0.0))
    place = run.world.snapshot().position
    advanced = moved = 0.0
    while run.now - start < seconds:
        run.tick()
        advanced = max(advanced, run.world.snapshot().position[2] - max(z, place[2]))
        moved = max(moved, run.distance(place))
        if closed and node in OPEN_WITHIN:
            assert not run.closed, "nothing closes it again"
    if node in ("servo_node", "docking_node"):
        assert moved < SETTLING
    elif node == "tactile_node":
        assert advanced < SETTLING, "without touch only the way back is open"


def cells() -> list[tuple[str, State]]:
    """Return the relevant phases: docking calls the detector only in LOCATE; one later phase represents the others."""
    detector = (State.LOCATE, State.CHARGING)
    return [(node, phase) for phase in PHASES for node in NODES if node != NODES[3] or phase in detector]


@pytest.mark.parametrize(("node", "phase"), cells(), ids=lambda value: getattr(value, "name", value))
def test_a_node_that_is_killed(run: Faulty, node: str, phase: State) -> None:
    run.reach(phase)
    stays_away(run, node, phase, 2.0)
    expected = allowed(node, phase, True)
    if node == "docking_node":
        run.restart()  # its client knows that the server is gone
    else:
        code = run.end(phase, expected)
        assert code in expected, run.machine.status.message
        assert bool(run.machine.status.message) == (code is not NONE)
        run.restart()
    run.assert_never_hurt()
    run.go_home()


@pytest.mark.parametrize(
    ("node", "phase"),
    [cell if cell[1] in QUICK else rest(*cell) for cell in cells()],
    ids=lambda value: getattr(value, "name", value),
)
def test_a_node_that_is_stopped_for_a_second(run: Faulty, node: str, phase: State) -> None:
    """Its late answers arrive together, the trajectories it missed do not; an opened contactor does not close again."""
    run.reach(phase)
    stays_away(run, node, phase, STOPPED)
    run.resume()
    expected = allowed(node, phase, False)
    assert run.end(phase, expected) in expected, run.machine.status.message
    run.run(0.3)
    if run.machine.status.code is not NONE:
        assert not run.has_torque, "what asked for it to go off came late, but came"
        assert not run.closed
    run.assert_never_hurt()
    run.go_home()


def test_backing_off_ends_with_the_code_of_the_silent_node() -> None:
    """The paper's first push backs off if the target is nearer than given."""
    run = Faulty(nearer=0.006, approach="paper")
    for node, code in (("servo_node", Code.SERVO_FAULT), ("tactile_node", Code.TACTILE_STALE)):
        run.reach(State.BACK_OFF)
        stays_away(run, node, State.BACK_OFF, 2.0)
        assert run.end(State.BACK_OFF, {code}) is code
        run.restart()
        run.go_home()
    run.reach(State.BACK_OFF)
    stays_away(run, "docking_node", State.BACK_OFF, 2.0)
    run.restart()
    run.go_home()
    run.assert_never_hurt()
