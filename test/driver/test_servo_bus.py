"""The servo bus against emulated servos on a real pseudo-terminal: set-up, snapshots, and what it does with faults."""

from __future__ import annotations

import math
import struct
import time

import pytest

from deltacharger_driver.bench_arm import BenchArm
from deltacharger_driver.control_table import ControlTable
from deltacharger_driver.errors import DriverError, HandshakeError, NoAnswer, PortGone, RangeError, ServoFault
from deltacharger_driver.mx64 import CURRENT_UNIT, TICK
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.servo_bus import UNKNOWN_AFTER, ServoBus
from deltacharger_driver.servo_emulator import ServoBusEmulator, terminal_speed
from deltacharger_driver.servo_packets import status
from deltacharger_driver.servo_snapshot import READ_LENGTH, BusSettings, decode_block, has_restarted

OVERLOAD = 1 << 5
BOUND = (0.83, 0.83, 0.83)


def until(condition, seconds=3.0):
    """Wait for a condition with a deadline and return what it gave."""
    deadline = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.002)
    return result


@pytest.fixture
def arm():
    return BenchArm((-0.7, -0.5, 0.2))


@pytest.fixture
def emulator(arm):
    return ServoBusEmulator(arm)


@pytest.fixture
def terminal(emulator):
    with PseudoTerminal(emulator) as terminal:
        yield terminal


@pytest.fixture
def closed(terminal):
    bus = ServoBus(BusSettings(terminal.path))
    yield bus
    bus.close()


@pytest.fixture
def bus(closed):
    closed.open()
    return closed


def test_after_opening_torque_is_off_and_every_register_is_as_it_should(bus, emulator):
    for servo in (1, 2, 3):
        table = emulator.servo(servo).table
        assert table.get("torque_enable") == 0
        assert table.get("return_delay") == 0
        assert table.get("operating_mode") == 5
        assert table.get("bus_watchdog") == 6
        assert table.get("homing_offset") == 0
    snapshot = bus.read()
    assert snapshot.complete
    assert snapshot.angle == pytest.approx((-0.7, -0.5, 0.2), abs=TICK)
    assert snapshot.velocity == (0.0, 0.0, 0.0)
    assert snapshot.voltage == pytest.approx((12.0, 12.0, 12.0))
    assert snapshot.temperature == (30.0, 30.0, 30.0)
    assert snapshot.hardware_error == (0, 0, 0)
    assert snapshot.torque_enabled == (False, False, False)
    assert time.monotonic() - snapshot.time < 1.0


def test_id_speed_and_offset_are_never_written_and_eeprom_only_once(closed, emulator, monkeypatch):
    written = []
    write = ControlTable.write

    def spy(table, address, data):
        written.extend(range(address, address + len(data)))
        return write(table, address, data)

    monkeypatch.setattr(ControlTable, "write", spy)
    closed.open()
    closed.read()
    assert not {7, 8, 12, 13, 20, 21, 22, 23} & set(written)
    closed.close()
    written.clear()
    closed.open()
    assert not [address for address in written if address < 64]


def test_a_servo_left_with_torque_is_switched_off(closed, emulator, arm):
    table = emulator.servo(2).table
    table.set("operating_mode", 5)
    table.set("torque_enable", 1)
    closed.open()
    assert arm.torque_enabled() == [False, False, False]
    assert table.get("torque_enable") == 0


def test_all_faults_come_in_one_message(closed, emulator, terminal):
    emulator.line_speed = lambda: terminal_speed(terminal.path)
    emulator.set_speed(1, 1)
    emulator.faults.missing = {2}
    emulator.use_protocol_1(3)
    with pytest.raises(HandshakeError) as caught:
        closed.open()
    faults = caught.value.faults
    assert len(faults) == 3
    assert "servo 1 answers at 57600" in faults[0]
    assert "--set-baud" in faults[0]
    assert "servo 2 does not answer at any speed" in faults[1]
    assert "servo 3 speaks Protocol 1.0" in faults[2]
    assert "firmware" in faults[2]
    assert all(fault in str(caught.value) for fault in faults)
    assert isinstance(caught.value, ConnectionError)
    assert not closed.is_open


def test_old_firmware_at_the_factory_speed_is_found_too(closed, emulator, terminal):
    emulator.line_speed = lambda: terminal_speed(terminal.path)
    for servo in (1, 2, 3):
        emulator.set_speed(servo, 1)
        emulator.use_protocol_1(servo)
    with pytest.raises(HandshakeError) as caught:
        closed.open()
    assert [("57600" in fault, "Protocol 1.0" in fault) for fault in caught.value.faults] == [(True, True)] * 3


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("model", 1020, "1020"),
        ("homing_offset", 12, "zero_ticks"),
        ("drive_mode", 1, "direction"),
        ("secondary_id", 5, "another servo"),
        ("temperature_limit", 100, "60 to 80"),
        ("temperature_limit", 40, "60 to 80"),
        ("min_voltage", 125, "95 to 110"),
        ("max_voltage", 120, "130 to 160"),
        ("pwm_limit", 400, "885"),
        ("current_limit", 297, "current_max"),
        ("shutdown", 32, "overheating.*52|overheating.*36"),
        ("shutdown", 4, "overload.*36"),
        ("shutdown", 0, "overheating and overload.*36"),
    ],
)
def test_a_servo_that_is_not_as_expected_is_named_and_left_as_it_is(closed, emulator, name, value, told):
    emulator.servo(2).table.set(name, value)
    with pytest.raises(HandshakeError, match=f"servo 2.*({told})") as caught:
        closed.open()
    assert len(caught.value.faults) == 1
    assert emulator.servo(2).table.get(name) == value
    assert not closed.is_open


@pytest.mark.parametrize(
    ("name", "value"),
    [("shutdown", 36), ("shutdown", 61), ("temperature_limit", 70), ("min_voltage", 110), ("current_limit", 1220)],
)
def test_harmless_choices_are_accepted(closed, emulator, name, value):
    emulator.servo(1).table.set(name, value)
    closed.open()
    assert closed.read().complete


def test_faults_of_all_servos_come_at_once_and_the_good_one_is_set_up(closed, emulator, arm):
    emulator.servo(1).table.set("homing_offset", 12)
    emulator.servo(1).table.set("shutdown", 0)
    emulator.servo(1).table.set("torque_enable", 1)
    emulator.servo(3).table.set("current_limit", 297)
    with pytest.raises(HandshakeError) as caught:
        closed.open()
    assert [fault[:7] for fault in caught.value.faults] == ["servo 1", "servo 1", "servo 3"]
    assert emulator.servo(1).table.get("torque_enable") == 0
    assert emulator.servo(2).table.get("bus_watchdog") in (6, 255)  # armed; it trips once the port is closed
    assert emulator.servo(3).table.get("operating_mode") == 3


def test_a_missing_servo_does_not_hide_the_settings_of_another(closed, emulator):
    emulator.faults.missing = {1}
    emulator.servo(2).table.set("drive_mode", 1)
    with pytest.raises(HandshakeError) as caught:
        closed.open(scan=False)
    assert ["does not answer" in fault for fault in caught.value.faults] == [True, False]


def test_one_refusal_does_not_hide_the_next(closed, emulator, monkeypatch):
    write = ControlTable.write

    def refuse(table, address, data):
        if table is emulator.servo(2).table and address in (9, 108):
            return 6, {}
        return write(table, address, data)

    monkeypatch.setattr(ControlTable, "write", refuse)
    with pytest.raises(HandshakeError) as caught:
        closed.open()
    assert ["return_delay" in fault for fault in caught.value.faults] == [True, False]
    assert "profile_acceleration" in caught.value.faults[1]


def test_a_waiting_registered_write_is_found_at_the_set_up(closed, emulator):
    emulator.servo(3).table.set("registered", 1)
    with pytest.raises(HandshakeError, match=r"servo 3.*registered = 1.*restart it"):
        closed.open()


def test_two_servos_with_one_id_are_suspected(closed, emulator):
    emulator.faults.servos = {2}
    emulator.faults.rate["corrupt"] = 1.0
    with pytest.raises(HandshakeError, match="two servos with this id"):
        closed.open(scan=False)


@pytest.mark.parametrize("level", [0, 1])
def test_a_servo_told_to_keep_quiet_is_told_to_answer(closed, emulator, level):
    emulator.servo(3).table.set("status_return_level", level)
    closed.open()
    assert emulator.servo(3).table.get("status_return_level") == 2


def test_torque_goes_on_where_the_arm_is(bus, arm, emulator):
    emulator.servo(1).table.set("goal_position", 3000)
    bus.enable_torque(BOUND)
    assert arm.torque_enabled() == [True, True, True]
    for _ in range(10):
        snapshot = bus.read()
    assert snapshot.torque_enabled == (True, True, True)
    assert arm.angles == pytest.approx((-0.7, -0.5, 0.2), abs=TICK)
    assert [command[2] for command in arm.commands] == pytest.approx([0.83] * 3, abs=CURRENT_UNIT)


def test_goal_and_bound_arrive_together(bus, arm):
    bus.enable_torque(BOUND)
    bus.write_goals((-0.6, -0.4, 0.3), (0.5, 0.6, 0.0))
    until(lambda: arm.commands[2][1] == pytest.approx(0.3, abs=TICK))
    assert [command[1] for command in arm.commands] == pytest.approx([-0.6, -0.4, 0.3], abs=TICK)
    assert [command[2] for command in arm.commands] == pytest.approx([0.5, 0.6, 0.0], abs=CURRENT_UNIT)


def test_the_arm_arrives_and_says_so(bus, arm):
    bus.enable_torque(BOUND)

    def arrived():
        bus.write_goals((-0.6, -0.6, 0.1), BOUND)
        return max(abs(a - b) for a, b in zip(bus.read().angle, (-0.6, -0.6, 0.1), strict=True)) < 2 * TICK

    until(arrived)


def test_signs_follow_the_mounting(terminal, arm):
    bus = ServoBus(BusSettings(terminal.path, zero_ticks=(2048, 2000, 2048), direction=(1, 1, -1)))
    bus.open()
    bus.enable_torque(BOUND)
    arm.load[2] = -0.7
    snapshot = until(lambda: (s := bus.read()).current[2] < -0.4 and s)
    bus.close()
    assert snapshot.angle[0] == pytest.approx(-0.7, abs=TICK)
    assert snapshot.angle[1] == pytest.approx(-0.5 + 48 * TICK, abs=TICK)
    assert snapshot.angle[2] == pytest.approx(-arm.angles[2], abs=0.02)


@pytest.mark.parametrize(
    ("angles", "currents"),
    [
        ((math.nan, 0, 0), BOUND),
        ((0, 0, 0), (0.1, math.nan, 0.1)),
        ((0, 0, 0), (-0.1, 0.1, 0.1)),
        ((0, 0, 0), (99.0, 0.1, 0.1)),
    ],
)
def test_nonsense_is_refused_before_anything_is_sent(bus, arm, angles, currents):
    bus.enable_torque(BOUND)
    before = list(arm.commands)
    with pytest.raises(RangeError):
        bus.write_goals(angles, currents)
    bus.read()
    assert arm.commands == before


def test_a_bound_above_the_largest_is_refused_and_the_largest_itself_arrives(terminal, emulator, arm):
    emulator.servo(2).table.set("current_limit", 833)  # 2.8 A
    bus = ServoBus(BusSettings(terminal.path, current_max=2.8))
    bus.open()
    bus.enable_torque(BOUND)
    with pytest.raises(RangeError, match=r"2\.81"):
        bus.write_goals((0.0, 0.0, 0.0), (2.8, 2.81, 2.8))
    with pytest.raises(RangeError):
        bus.enable_torque((2.8, 2.81, 2.8))
    bus.enable_torque(BOUND)
    bus.write_goals((-0.1, -0.1, -0.1), (2.8 * (1 + 1e-12),) * 3)
    until(lambda: arm.commands[1][1] == pytest.approx(-0.1, abs=TICK))
    assert [command[2] for command in arm.commands] == pytest.approx([2.8] * 3, abs=CURRENT_UNIT)
    bus.close()


GOOD_BLOCK = (1, 0, -119, 5, 2048, 120, 30, 2, 0)  # torque, error, current, velocity, ticks, voltage, temperature, …


def block(**changed):
    names = ("torque", "error", "current", "velocity", "ticks", "voltage", "temperature", "level", "registered")
    values = dict(zip(names, GOOD_BLOCK, strict=True)) | changed
    return struct.pack("<BBhiiHBBB", *values.values())


def test_the_block_is_read_by_layout():
    reading = decode_block(block())
    assert (reading.torque_enabled, reading.hardware_error, reading.current, reading.velocity) == (True, 0, -119, 5)
    assert (reading.ticks, reading.voltage, reading.temperature) == (2048, 120, 30)
    assert len(block()) == READ_LENGTH == 17


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"torque": 2}, "torque_enable"),
        ({"current": 2048}, "present_current"),
        ({"current": -32768}, "present_current"),
        ({"voltage": 39}, "input_voltage"),
        ({"voltage": 301}, "input_voltage"),
        ({"temperature": 126}, "temperature"),
        ({"level": 1}, "status_return_level"),
        ({"registered": 1}, "registered"),
    ],
)
def test_what_no_servo_reports_is_refused_by_name(changed, name):
    with pytest.raises(RangeError) as caught:
        decode_block(block(**changed))
    assert caught.value.name == name
    assert not has_restarted(block(**changed))


@pytest.mark.parametrize(
    "changed", [{"current": 2047}, {"current": -2047}, {"voltage": 40}, {"voltage": 300}, {"temperature": 125}]
)
def test_the_edges_of_what_servos_report_are_accepted(changed):
    assert decode_block(block(**changed))


def test_a_restarted_servo_is_told_by_its_lost_set_up_not_by_its_supply():
    assert has_restarted(bytes(READ_LENGTH))
    assert not has_restarted(block(voltage=0))


def test_a_burst_across_the_last_byte_and_the_checksum_does_not_reach_the_snapshot(bus, emulator, monkeypatch):
    def struck(*fields):
        reply = status(*fields)
        return reply[:-3] + bytes((reply[-3] ^ 0x03, reply[-2] ^ 0x0A, reply[-1]))

    monkeypatch.setattr("deltacharger_driver.servo_emulator.status", struck)
    assert bus._link.read(1, "temperature") == 30 ^ 0x03  # the checksum does not see it
    assert bus.read().valid == (False, False, False)
    assert bus.counters.implausible == 3
    assert bus.counters.corrupt == 0


@pytest.mark.parametrize(("register", "value"), [("temperature", 200), ("input_voltage", 0), ("present_current", 3000)])
def test_an_impossible_value_is_counted_and_nothing_of_its_reply_is_used(bus, emulator, register, value):
    servo = emulator.servo(2)
    measure = servo.measure

    def mistaken(now):
        angle = measure(now)
        servo.table.set(register, value)
        return angle

    servo.measure = mistaken
    snapshot = bus.read()
    assert snapshot.valid == (True, False, True)
    assert snapshot.rebooted == (False, False, False)
    assert bus.counters.implausible == 1
    for values in (snapshot.angle, snapshot.velocity, snapshot.current, snapshot.voltage, snapshot.temperature):
        assert math.isnan(values[1])
    until(lambda: bus.read().missing[1])
    servo.measure = measure
    until(lambda: bus.read().complete)


def test_a_lost_reply_is_nan_and_the_next_cycle_is_whole_again(bus, emulator):
    emulator.faults.next_reply("drop", 2)
    snapshot = bus.read()
    assert snapshot.valid == (True, False, True)
    assert math.isnan(snapshot.angle[1])
    assert math.isnan(snapshot.current[1])
    assert math.isnan(snapshot.voltage[1])
    assert snapshot.missed == (0, 1, 0)
    assert not math.isnan(sum(value for value in (snapshot.angle[0], snapshot.angle[2])))
    assert bus.read().complete


@pytest.mark.parametrize("missing", [1, 2, 3])
def test_a_missing_servo_is_the_only_one_that_is_not_valid(bus, emulator, missing):
    emulator.faults.missing = {missing}
    snapshots = [bus.read() for _ in range(UNKNOWN_AFTER + 2)]
    expected = tuple(servo != missing for servo in (1, 2, 3))
    assert [snapshot.valid for snapshot in snapshots[1:]] == [expected] * (UNKNOWN_AFTER + 1)
    assert snapshots[-1].missed[missing - 1] == UNKNOWN_AFTER + 2
    emulator.faults.missing = set()
    until(lambda: bus.read().complete)


def test_waiting_for_a_missing_servo_does_not_slow_the_others(bus, emulator):
    emulator.faults.missing = {2}
    until(lambda: bus.read().missing[1])
    begin = time.monotonic()
    for _ in range(50):
        bus.read()
    assert time.monotonic() - begin < 0.5  # the full wait in each cycle would take more than a second


@pytest.mark.parametrize("fault", ["corrupt", "truncate", "garbage", "duplicate", "drop"])
def test_under_any_noise_a_value_is_right_or_not_there(bus, emulator, fault):
    emulator.faults.rate[fault] = 0.3
    for _ in range(40):
        snapshot = bus.read()
        for valid, voltage, temperature in zip(snapshot.valid, snapshot.voltage, snapshot.temperature, strict=True):
            assert not valid or (voltage == pytest.approx(12.0) and temperature == 30.0)
            assert valid or math.isnan(voltage)
    emulator.faults.rate.clear()
    until(lambda: bus.read().complete)


def test_a_hardware_error_shows_and_forbids_torque(bus, emulator, arm):
    emulator.raise_hardware_error(3, OVERLOAD)
    assert bus.read().hardware_error == (0, 0, OVERLOAD)
    with pytest.raises(ServoFault, match=r"servo 3.*overload") as caught:
        bus.enable_torque(BOUND)
    assert caught.value.code == OVERLOAD
    assert arm.torque_enabled() == [False, False, False]


def test_a_missing_servo_forbids_torque(bus, emulator, arm):
    emulator.faults.missing = {1}
    with pytest.raises(NoAnswer, match="servo 1"):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled() == [False, False, False]


def test_one_that_refuses_takes_the_torque_of_all(bus, emulator, arm):
    bus.read()
    emulator.faults.next_reply("drop", 3, 5)
    emulator.servo(3).write = lambda *request: 1
    with pytest.raises(DriverError):
        bus.enable_torque(BOUND)
    assert arm.torque_enabled()[:2] == [False, False]


def test_a_servo_that_restarted_is_noticed_and_never_taken_for_a_position(bus, emulator, arm):
    bus.enable_torque(BOUND)
    emulator.reboot(2, time.monotonic())
    snapshot = until(lambda: (s := bus.read()).rebooted[1] and s)
    assert not snapshot.valid[1]
    assert math.isnan(snapshot.angle[1])
    assert not arm.torque_enabled()[1]
    bus.configure(1)
    snapshot = until(lambda: (s := bus.read()).complete and s)
    assert snapshot.torque_enabled[1] is False
    assert snapshot.rebooted == (False, False, False)


def test_a_reboot_clears_what_is_latched(bus, emulator):
    emulator.raise_hardware_error(1, OVERLOAD)
    bus.read()
    bus.reboot(0)
    until(lambda: bus.read().rebooted[0])
    bus.configure(0)
    snapshot = until(lambda: (s := bus.read()).complete and s)
    assert snapshot.hardware_error == (0, 0, 0)


def test_the_servos_stop_by_themselves_when_the_host_is_silent(bus, emulator, arm):
    bus.enable_torque(BOUND)
    bus.write_goals((0.0, 0.0, 0.0), (0.2, 0.2, 0.2))
    until(lambda: emulator.servo(1).table.get("bus_watchdog") == 255)
    bus.read()
    assert bus.tripped_watchdogs() == (1, 2, 3)
    where = arm.commands[0][1]
    bus.write_goals((0.0, 0.0, 0.0), BOUND)
    bus.read()
    assert arm.commands[0][1] == where  # goals are locked until the watchdog is cleared
    bus.restart_watchdogs()
    bus.write_goals((0.0, 0.0, 0.0), BOUND)
    bus.read()
    assert arm.commands[0][1] == 0.0
    assert bus.tripped_watchdogs() == ()


def test_a_pulled_cable_is_told_and_the_bus_opens_again(bus, terminal, arm):
    bus.enable_torque(BOUND)
    terminal.stop()
    with pytest.raises(PortGone):
        bus.read()
    with pytest.raises(PortGone):
        bus.write_goals((0.0, 0.0, 0.0), BOUND)
    bus.close()
    terminal.start()
    again = ServoBus(BusSettings(terminal.path))
    again.open()
    assert again.read().complete
    assert arm.torque_enabled() == [False, False, False]
    again.close()


def test_torque_off_reaches_the_servos_that_answer(bus, emulator, arm):
    bus.enable_torque(BOUND)
    emulator.faults.missing = {1}
    bus.disable_torque()
    assert arm.torque_enabled() == [True, False, False]


@pytest.mark.parametrize(
    "settings", [{"ids": (1, 1, 2)}, {"ids": (1, 2)}, {"direction": (1, 0, 1)}, {"watchdog": 7}, {"watchdog": 0}]
)
def test_impossible_settings_are_refused(settings):
    with pytest.raises(DriverError):
        BusSettings("/dev/null", **settings)
