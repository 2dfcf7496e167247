"""What the servos do from cycle to cycle, against emulated servos on a real pseudo-terminal."""

from __future__ import annotations

import math
import time

import pytest

from deltacharger_driver.bench_arm import BenchArm
from deltacharger_driver.errors import PortMissing, TrajectoryRefused
from deltacharger_driver.mx64 import CURRENT_UNIT, TICK, TORQUE_CONSTANT
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servo_controller import OPENING_TIME, STOP_TIME, ServoController
from deltacharger_driver.servo_emulator import ServoBusEmulator
from deltacharger_driver.servo_report import Phase
from deltacharger_driver.servo_snapshot import BusSettings
from deltacharger_driver.trajectory import JointLimits, Waypoint, check

START = (-0.7, -0.5, 0.2)
NAMES = ("a", "b", "c")
LIMITS = JointLimits(NAMES, -1.2, 1.3, 4.4)
DEFAULT = 0.83
OVERLOAD = 1 << 5


class Contactor:
    """A contactor that opens `delay` s after it is asked to, and what was on the arm then."""

    def __init__(self, arm):
        self.arm = arm
        self.delay = 0.0
        self.asked = []
        self.opened_at = 0.0
        self.torque_when_opened = None

    def ask_open(self):
        self.asked.append(time.monotonic())
        self.opened_at = self.asked[0] + self.delay

    def is_open(self):
        if not self.asked or time.monotonic() < self.opened_at:
            return False
        if self.torque_when_opened is None:
            self.torque_when_opened = self.arm.torque_enabled()
        return True


class Rig:
    """A controller that cycles at 100 Hz while it waits for something."""

    def __init__(self, path):
        self.arm = BenchArm(START)
        self.emulator = ServoBusEmulator(self.arm)
        self.terminal = PseudoTerminal(self.emulator, path).start()
        self.events = []
        self.controller = ServoController(
            BusSettings(self.terminal.path), DEFAULT, TORQUE_CONSTANT, lambda *event: self.events.append(event)
        )
        self.contactor = Contactor(self.arm)
        self.report = None

    def cycle(self):
        self.report = self.controller.cycle()
        time.sleep(0.005)
        return self.report

    def until(self, condition, seconds=4.0):
        deadline = time.monotonic() + seconds
        while not (result := condition(self.cycle())):
            assert time.monotonic() < deadline, f"it did not come to pass; {self.report}"
        return result

    def ask(self, action):
        request = self.controller.request(action)
        self.until(lambda report: request.wait(0.0))
        return request

    def wire_contactor(self):
        """Let the controller have a contactor."""
        self.controller._contactor = self.contactor

    def torque_on(self):
        request = self.ask("torque_on")
        assert request.success, request.message

    def send(self, *rows):
        self.controller.submit(check(NAMES, [Waypoint(*row) for row in rows], LIMITS))

    def references(self):
        return [command[1] for command in self.arm.commands]

    def bounds(self):
        return [command[2] for command in self.arm.commands]

    def close(self):
        self.controller.close()
        self.terminal.stop()


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path / "servo")
    rig.controller.open()
    yield rig
    rig.close()


def test_it_starts_without_torque_and_reports_everything(rig):
    report = rig.cycle()
    assert report.phase is Phase.OFF
    assert report.valid == (True, True, True)
    assert report.angle == pytest.approx(START, abs=TICK)
    assert report.thermal_reserve == (math.inf,) * 3
    assert report.faults == ()
    assert rig.arm.torque_enabled() == [False] * 3


def test_a_trajectory_without_torque_is_refused(rig):
    rig.cycle()
    with pytest.raises(TrajectoryRefused, match="set_torque"):
        rig.send((0.1, START))


def test_torque_on_holds_and_off_releases(rig):
    rig.torque_on()
    rig.cycle()
    assert rig.arm.torque_enabled() == [True] * 3
    assert rig.references() == pytest.approx(list(START), abs=TICK)
    assert rig.ask("torque_on").message == "torque is already on"
    assert rig.ask("torque_off").success
    assert rig.arm.torque_enabled() == [False] * 3
    assert rig.cycle().phase is Phase.OFF


def test_a_trajectory_is_followed_in_time_and_takes_effect_in_the_next_cycle(rig):
    rig.torque_on()
    goal = tuple(angle + 0.1 for angle in START)
    rig.send((0.0, goal))
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)
    begin = time.monotonic()
    rig.send((0.5, START))
    middle = []

    def done(report):
        middle.append(rig.references()[0])
        return rig.references() == pytest.approx(list(START), abs=TICK)

    rig.until(done)
    assert 0.45 <= time.monotonic() - begin <= 1.5
    assert middle == sorted(middle, reverse=True)
    assert len(set(middle)) > 15


def test_a_new_trajectory_starts_at_the_goal_where_the_old_one_was_cut(rig):
    rig.torque_on()
    rig.send((1.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.4)
    cut = rig.references()
    rig.send()
    rig.cycle()
    rig.cycle()
    held = rig.references()
    assert held == pytest.approx(cut, abs=0.1)
    rig.send((10.0, START))
    rig.cycle()
    assert rig.references() == pytest.approx(held, abs=0.02)


def test_effort_bounds_the_current_and_does_not_outlive_its_trajectory(rig):
    rig.torque_on()
    release = 2.8 * TORQUE_CONSTANT
    rig.send((0.0, START, (release, release, release)))
    rig.cycle()
    assert rig.bounds() == pytest.approx([2.8] * 3, abs=CURRENT_UNIT)
    rig.send()
    rig.cycle()
    assert rig.bounds() == pytest.approx([DEFAULT] * 3, abs=CURRENT_UNIT)
    rig.send((0.0, START, (0.3, 0.0, 0.3)))
    rig.cycle()
    assert rig.bounds() == pytest.approx([0.3 / TORQUE_CONSTANT, 0.0, 0.3 / TORQUE_CONSTANT], abs=CURRENT_UNIT)
    rig.send()
    rig.cycle()
    assert max(rig.bounds()) < 0.3  # a hold never presses harder
    rig.send((0.0, START))
    rig.cycle()
    assert rig.bounds() == pytest.approx([DEFAULT] * 3, abs=CURRENT_UNIT)


def test_a_load_shows_as_current_and_as_reserve(rig):
    rig.torque_on()
    rig.send((0.0, START, (4.0, 4.0, 4.0)))
    rig.arm.load[1] = -2.0 * TORQUE_CONSTANT
    report = rig.until(lambda report: report.thermal_reserve[1] < 400 and report)
    assert report.current[1] == pytest.approx(2.0, abs=0.1)
    assert report.thermal_reserve[0] == math.inf


@pytest.mark.parametrize(
    ("fail", "told"),
    [
        (lambda rig: rig.emulator.faults.missing.add(2), "servo 2 does not answer"),
        (lambda rig: rig.emulator.raise_hardware_error(2, OVERLOAD), "overload"),
        (lambda rig: rig.emulator.reboot(2, time.monotonic()), "servo 2"),
        (lambda rig: rig.arm.temperature.__setitem__(1, 85.0), "overheating"),
        (lambda rig: rig.arm.voltage.__setitem__(1, 9.0), "voltage"),
    ],
)
def test_one_servo_in_trouble_stops_all_where_they_are(rig, fail, told):
    rig.wire_contactor()
    rig.torque_on()
    rig.send((2.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.6)
    assert not rig.contactor.asked
    fail(rig)
    rig.until(lambda report: report.phase is Phase.STOPPING)
    assert rig.contactor.asked  # at once, not when the torque goes
    begin = time.monotonic()
    stopped = rig.references()[0]
    assert stopped == pytest.approx(rig.arm.angles[0], abs=0.1)
    assert rig.arm.torque_enabled()[0]
    with pytest.raises(TrajectoryRefused, match="stopping"):
        rig.send((1.0, START))
    assert not rig.ask("torque_on").success
    rig.until(lambda report: report.phase is Phase.OFF)
    assert STOP_TIME - 0.1 <= time.monotonic() - begin <= STOP_TIME + 0.5
    assert rig.references()[0] == stopped
    assert rig.arm.torque_enabled()[0] is rig.arm.torque_enabled()[2] is False
    assert any(severity == "error" and told in sentence for severity, sentence in rig.events)


def test_a_single_lost_reply_stops_nothing_and_the_last_values_stand(rig):
    rig.torque_on()
    before = rig.cycle()
    rig.emulator.faults.next_reply("drop", 1, 2)
    for _ in range(2):
        report = rig.cycle()
        assert report.valid == (False, True, True)
        assert report.angle[0] == before.angle[0]
    assert rig.cycle().valid == (True, True, True)
    rig.emulator.faults.missing = {1}
    reports = [rig.cycle() for _ in range(3)]
    assert [math.isnan(report.angle[0]) for report in reports] == [False, False, True]
    assert math.isnan(reports[2].voltage[0])
    assert reports[2].torque_enabled[0]  # the last known


def test_reboot_is_by_request_only_and_leaves_torque_off(rig):
    rig.torque_on()
    assert "set_torque" in rig.ask("reboot").message
    rig.emulator.raise_hardware_error(1, OVERLOAD)
    rig.until(lambda report: report.phase is Phase.OFF)
    assert not rig.ask("torque_on").success
    assert rig.cycle().hardware_error[0] == OVERLOAD
    request = rig.ask("reboot")
    assert request.success, request.message
    report = rig.until(lambda report: all(report.valid) and report)
    assert report.hardware_error == (0, 0, 0)
    assert rig.arm.torque_enabled() == [False] * 3
    rig.torque_on()


def test_a_cause_that_stays_is_told(rig):
    rig.arm.temperature[0] = 85.0
    rig.until(lambda report: report.hardware_error[0])
    request = rig.ask("reboot")
    assert not request.success
    assert "overheating" in request.message


def test_a_servo_that_restarts_by_itself_is_set_up_again_without_torque(rig):
    rig.emulator.reboot(3, time.monotonic())
    rig.until(lambda report: not report.valid[2])
    rig.until(lambda report: all(report.valid))
    assert rig.emulator.servo(3).table.get("bus_watchdog") == 6
    assert rig.arm.torque_enabled() == [False] * 3
    assert any("had restarted" in sentence for _, sentence in rig.events)


def test_the_cable_may_be_pulled_and_put_back(rig):
    rig.torque_on()
    rig.terminal.stop()
    report = rig.until(lambda report: report.phase is Phase.DISCONNECTED and report)
    assert not any(report.valid)
    assert all(map(math.isnan, report.angle))
    assert report.faults
    assert not rig.ask("torque_on").success
    rig.until(lambda report: "no such port" in report.faults[0])
    rig.terminal.start()
    rig.until(lambda report: report.phase is Phase.OFF)
    assert rig.controller.reconnections == 1
    assert rig.arm.torque_enabled() == [False] * 3
    assert all(rig.cycle().valid)
    rig.torque_on()


def test_after_a_silence_of_the_host_the_arm_goes_on_from_where_it_stopped(rig):
    rig.torque_on()
    rig.send((2.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.6)
    time.sleep(0.2)  # the host's thread starves
    rig.cycle()
    assert rig.controller.watchdog_trips == 1
    stopped = rig.arm.angles
    rig.cycle()
    assert rig.references() == pytest.approx(list(stopped), abs=0.05)
    assert rig.report.phase is Phase.ON
    rig.until(lambda report: report.angle == pytest.approx((0.3, 0.5, 1.2), abs=3 * TICK))


def test_a_silence_after_the_end_leaves_the_arm_where_it_is(rig):
    rig.torque_on()
    rig.send((0.0, (0.3, 0.5, 1.2), (0.3, 0.3, 0.3)))
    rig.cycle()
    time.sleep(0.2)
    for _ in range(5):
        rig.cycle()
    assert rig.references() == pytest.approx(list(rig.arm.angles), abs=0.05)
    assert rig.references()[0] < 0.0


def test_a_host_that_falls_silent_again_and_again_stops_the_arm(rig):
    rig.torque_on()
    for _ in range(3):
        assert rig.report.phase is Phase.ON
        time.sleep(0.2)
        rig.cycle()
    assert rig.report.phase is Phase.STOPPING
    assert any("overloaded" in sentence for _, sentence in rig.events)


def test_silence_without_torque_is_nobodys_business(rig):
    rig.cycle()
    time.sleep(0.2)
    rig.cycle()
    assert rig.events == []
    rig.torque_on()
    goal = tuple(angle + 0.1 for angle in START)
    rig.send((0.0, goal))
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def test_closing_switches_torque_off_whatever_happens(rig):
    rig.torque_on()
    pending = rig.controller.request("reboot")
    rig.controller.close()
    rig.controller.close()
    assert rig.arm.torque_enabled() == [False] * 3
    assert pending.wait(0.0)
    assert not pending.success


def test_a_port_that_is_not_there_is_named(tmp_path):
    controller = ServoController(BusSettings(str(tmp_path / "nothing")), DEFAULT, TORQUE_CONSTANT)
    with pytest.raises(PortMissing):
        controller.open()
    controller.close()


def test_torque_goes_off_as_soon_as_the_contactor_is_open_and_not_before(rig):
    rig.wire_contactor()
    rig.contactor.delay = 0.15
    rig.torque_on()
    rig.send((2.0, (0.3, 0.5, 1.2)))
    rig.until(lambda report: rig.references()[0] > -0.6)
    begin = time.monotonic()
    request = rig.controller.request("torque_off")
    rig.cycle()
    held = rig.references()
    with pytest.raises(TrajectoryRefused, match="switched off"):
        rig.send((1.0, START))
    rig.until(lambda report: request.wait(0.0))
    assert request.success
    assert request.message == "torque is off"
    assert rig.contactor.torque_when_opened == [True] * 3
    assert rig.references() == held
    assert rig.arm.torque_enabled() == [False] * 3
    assert time.monotonic() - begin >= 0.15
    assert not any(severity in ("error", "warning") for severity, _ in rig.events)


def test_a_contactor_that_stays_closed_does_not_keep_the_torque_on(rig):
    rig.wire_contactor()
    rig.contactor.delay = math.inf
    rig.torque_on()
    begin = time.monotonic()
    request = rig.ask("torque_off")
    assert request.success
    assert "not seen open" in request.message
    assert time.monotonic() - begin >= OPENING_TIME
    assert rig.arm.torque_enabled() == [False] * 3
    assert any("not seen open" in sentence for _, sentence in rig.events)


def test_torque_off_by_request_cuts_a_stop_short_once_the_contactor_is_open(rig):
    rig.wire_contactor()
    rig.torque_on()
    rig.controller.stop("a test")
    begin = time.monotonic()
    assert rig.ask("torque_off").success
    assert time.monotonic() - begin < STOP_TIME
    assert rig.cycle().phase is Phase.OFF


def test_a_pulled_cable_and_closing_ask_for_the_contactor_too(rig):
    rig.wire_contactor()
    rig.torque_on()
    rig.terminal.stop()
    rig.until(lambda report: report.phase is Phase.DISCONNECTED)
    assert len(rig.contactor.asked) == 1
    rig.terminal.start()
    rig.until(lambda report: report.phase is Phase.OFF)
    rig.contactor.asked.clear()
    rig.contactor.delay = 0.1
    rig.torque_on()
    rig.controller.close()
    assert rig.contactor.torque_when_opened == [True] * 3
    assert rig.arm.torque_enabled() == [False] * 3


def test_a_replugged_port_is_back_within_two_seconds(rig):
    rig.cycle()
    rig.terminal.stop()
    rig.until(lambda report: report.phase is Phase.DISCONNECTED)
    away = time.monotonic() + 2.0  # long enough for the longest pause between two attempts
    rig.until(lambda report: time.monotonic() > away)
    begin = time.monotonic()
    rig.terminal.start()
    rig.until(lambda report: report.phase is Phase.OFF and all(report.valid))
    assert time.monotonic() - begin < 2.0


def line(begin, end, seconds, at):
    """Return the angles `at` s along a straight line that lasts `seconds`."""
    share = min(max(at / seconds, 0.0), 1.0)
    return tuple(a + share * (b - a) for a, b in zip(begin, end, strict=True))


def test_a_line_sent_piece_by_piece_is_followed_as_if_sent_whole(rig):
    rig.torque_on()
    goal = tuple(angle + 0.5 for angle in START)
    begin = time.monotonic()
    errors = []

    def feed(report):
        now = time.monotonic() - begin
        ahead = [now + step * 0.02 for step in range(1, 7)]
        points = [Waypoint(at, line(START, goal, 0.6, at)) for at in ahead]
        rig.controller.submit(check(NAMES, points, LIMITS), begin)
        if report.phase is Phase.ON and rig.references()[0] != pytest.approx(START[0]):
            errors.append(abs(rig.references()[0] - line(START, goal, 0.6, now)[0]))
        return now > 0.7

    rig.until(feed)
    assert len(errors) > 30
    late = 0.06 / 0.6 * 0.5  # what the line covers in 60 ms: a pause of this computer, never the feeding itself
    assert sorted(errors)[len(errors) // 2] < 0.02
    assert max(errors) < late
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def test_a_feed_that_ends_leaves_the_arm_at_its_last_point(rig):
    rig.torque_on()
    goal = tuple(angle + 0.5 for angle in START)
    begin = time.monotonic()
    points = [Waypoint(at, line(START, goal, 2.0, at)) for at in (0.04, 0.08, 0.12)]
    rig.controller.submit(check(NAMES, points, LIMITS), begin)
    rig.until(lambda report: time.monotonic() - begin > 0.5)
    assert rig.references() == pytest.approx(list(line(START, goal, 2.0, 0.12)), abs=TICK)


def test_a_piece_that_has_passed_already_holds_at_its_last_point(rig):
    rig.torque_on()
    goal = tuple(angle + 0.05 for angle in START)
    rig.controller.submit(check(NAMES, [Waypoint(0.1, START), Waypoint(0.2, goal)], LIMITS), time.monotonic() - 0.3)
    rig.cycle()
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)


def test_a_point_that_is_due_is_reached_at_once_though_the_message_took_its_time(rig):
    rig.torque_on()
    goal = tuple(angle + 0.05 for angle in START)
    rig.controller.submit(check(NAMES, [Waypoint(0.0, goal), Waypoint(2.0, goal)], LIMITS), time.monotonic() - 0.01)
    rig.cycle()
    assert rig.references() == pytest.approx(list(goal), abs=TICK)
