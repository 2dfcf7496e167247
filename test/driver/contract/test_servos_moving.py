# SPDX-License-Identifier: Apache-2.0
"""Laws of three healthy servos with torque on, moved by a few degrees. On real ones only with --move."""

import contextlib
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace

import pytest

from deltacharger_driver.errors import DriverError, ServoFault
from deltacharger_driver.servos.bus import ServoBus, ServoReport
from deltacharger_driver.servos.controller import ServoController
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.registers import WATCHDOG, WATCHDOG_UNIT

from ...waiting import wait_until
from .sites import ServoSite

pytestmark = pytest.mark.usefixtures("may_move")

STEP = math.radians(5.0)
BOUND = 0.5  # A, less than in docking; 0.7 N·m
NOISE = 0.1  # A that a servo's sensor may read beyond the bound
PERIOD = 0.01  # s
BOUNDS = (BOUND, BOUND, BOUND)

Angles = tuple[float, ...]


@pytest.fixture
def start(bus: ServoBus) -> Angles:
    """Present angles of the arm, torque off."""
    return wait_until(lambda: (s := bus.read()).complete and s, "the first snapshot").angle


@pytest.fixture
def step(start: Angles) -> float:
    """A step toward the middle of the arms' range, rad."""
    return -STEP if sum(start) > 0.0 else STEP


@pytest.fixture
def held(bus: ServoBus, start: Angles) -> Iterator[ServoBus]:
    """The servos holding their present angles."""
    bus.enable_torque(BOUNDS)
    yield bus
    with contextlib.suppress(DriverError):
        bus.disable_torque()


def toward(start: Angles, step: float) -> Angles:
    return tuple(angle + step for angle in start)


def moved(snapshot: ServoReport, start: Angles, step: float) -> list[float]:
    """How far each servo has come, as a share of `step`."""
    return [(angle - begin) / step for angle, begin in zip(snapshot.angle, start, strict=True)]


def cycles(bus: ServoBus, goal: Angles | None, restart: bool = True) -> Iterator[ServoReport]:
    """Exchange goal and state 100 times a second; restart watchdogs that a pause of this computer tripped."""
    while True:
        begin = time.monotonic()
        snapshot = bus.read() if goal is None else bus.exchange(goal, BOUNDS)
        if restart and any(snapshot.watchdog_tripped):
            bus.restart_watchdogs()
        if snapshot.complete:
            yield snapshot
        time.sleep(max(begin + PERIOD - time.monotonic(), 0.0))


def follow(bus: ServoBus, goal: Angles, condition: Callable[[ServoReport], bool], what: str) -> list[ServoReport]:
    """Cycle until a snapshot fulfils the condition, and return all."""
    snapshots = cycles(bus, goal)
    seen: list[ServoReport] = []

    def come() -> bool:
        seen.append(next(snapshots))
        return condition(seen[-1])

    wait_until(come, what)
    return seen


def test_torque_goes_on_at_the_present_angle_whatever_the_goal(bus: ServoBus, start: Angles, step: float) -> None:
    bus.write_goals(toward(start, step), BOUNDS)
    bus.enable_torque(BOUNDS)
    for snapshot, _ in zip(cycles(bus, None, restart=False), range(20), strict=False):
        assert snapshot.torque_enabled == (True, True, True)
        assert max(map(abs, moved(snapshot, start, step))) < 0.5, "the arm moved toward an old goal"


def test_a_goal_is_reached_within_its_current_bound(held: ServoBus, start: Angles, step: float) -> None:
    for goal, far in ((toward(start, step), True), (start, False)):

        def arrived(snapshot: ServoReport, far: bool = far) -> bool:
            return all(share > 0.5 if far else share < 0.5 for share in moved(snapshot, start, step))

        seen = follow(held, goal, arrived, f"each servo to go half of {math.degrees(STEP):g}° with {BOUND:g} A")
        assert max(abs(current) for snapshot in seen for current in snapshot.current) <= BOUND + NOISE
        assert all(-0.5 < share < 1.5 for snapshot in seen for share in moved(snapshot, start, step))
        assert not any(any(snapshot.hardware_error) for snapshot in seen)


def test_silence_locks_the_goals_until_the_watchdogs_are_restarted(held: ServoBus, start: Angles, step: float) -> None:
    time.sleep(2.0 * WATCHDOG * WATCHDOG_UNIT)  # no packets
    assert wait_until(lambda: (s := held.read()).complete and s, "a snapshot").watchdog_tripped == (True, True, True)
    goal = toward(start, step)
    for snapshot, _ in zip(cycles(held, goal, restart=False), range(20), strict=False):
        assert max(moved(snapshot, start, step)) < 0.5, "a servo accepted a goal although its watchdog had tripped"
    held.restart_watchdogs()
    follow(held, goal, lambda snapshot: min(moved(snapshot, start, step)) > 0.5, "the goals to be accepted again")


def test_eeprom_is_locked_while_torque_is_on(link: ServoLink, servo_site: ServoSite) -> None:
    for servo in servo_site.settings.ids:
        threshold = link.read(servo, "moving_threshold")
        link.write(servo, "bus_watchdog", 0)
        link.write(servo, "goal_current", 0)
        link.write(servo, "goal_position", link.read(servo, "present_position"))
        link.write(servo, "torque_enable", 1)
        with pytest.raises(ServoFault, match=f"servo {servo}: write moving_threshold.*locked while torque is on"):
            link.write(servo, "moving_threshold", threshold)
        link.write(servo, "torque_enable", 0)
        link.write(servo, "moving_threshold", threshold)


def torque(site: ServoSite) -> list[int]:
    """Return the servos' torque registers, read over a new connection that changes nothing."""
    link = ServoLink(site.path, site.settings.baud_rate, site.settings.reply_margin)
    link.open()
    try:
        return [link.read(servo, "torque_enable") for servo in site.settings.ids]
    finally:
        link.close()


def test_torque_is_off_after_the_controller_was_closed(servo_site: ServoSite) -> None:
    controller = ServoController(replace(servo_site.settings, current_max=BOUND))
    controller.open()
    try:
        request = controller.request("torque_on")

        def answered() -> bool:
            controller.cycle()
            return request.wait(0.0)

        wait_until(answered, "torque to go on")
        assert request.success, request.message
    finally:
        controller.close()
    assert torque(servo_site) == [0, 0, 0]


def test_opening_switches_off_remaining_torque(held: ServoBus, servo_site: ServoSite) -> None:
    held.close()
    before = torque(servo_site)
    again = ServoBus(servo_site.settings)
    again.open()
    again.close()
    assert before == [1, 1, 1]
    assert torque(servo_site) == [0, 0, 0]
