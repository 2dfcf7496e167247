# SPDX-License-Identifier: Apache-2.0
"""Laws of three healthy MX-64 without torque; no test moves them."""

import math
import statistics
import time
from dataclasses import replace

import pytest

from deltacharger_core.servo_types import ServoType
from deltacharger_driver import errors, port_identity
from deltacharger_driver.servos import registers
from deltacharger_driver.servos.bus import ServoBus, ServoReport, configure, motion_registers, restart_watchdog
from deltacharger_driver.servos.link import ServoLink
from deltacharger_driver.servos.registers import REGISTERS, has_restarted

from ...marks import rest
from ...waiting import wait_until
from .sites import ServoSite

OLDEST_FIRMWARE = 39
CYCLES = 60
RATE = 100.0  # Hz, of servo_node
SET_UP = {"torque_enable": 0, "drive_mode": 0, "homing_offset": 0, "hardware_error": 0, "secondary_id": 255}
JITTER = {"present_current": 30, "present_velocity": 5, "present_position": 4, "input_voltage": 3, "temperature": 1}
"""Counts by which a measured register may differ between two readings at rest; 0 for any other register."""


def test_the_port_is_identified_as_the_three_servos(servo_site: ServoSite) -> None:
    settings = servo_site.settings

    found = port_identity.identify(servo_site.path, speeds=(settings.baud_rate,), ids=settings.ids)
    assert found.kind == "servos", found.details
    assert {servo.servo for servo in found.servos} == set(settings.ids), found.details


def set_up_of(kind: ServoType) -> dict[str, int]:
    gains = dict(zip(registers.GAINS, kind.gains, strict=True))
    return {**SET_UP, "status_return_level": 2, **motion_registers(kind), **gains}


def test_each_servo_is_of_the_type_with_protocol_2(link: ServoLink, servo_site: ServoSite) -> None:
    for servo in servo_site.settings.ids:
        assert link.ping(servo, attempts=2) == link.read(servo, "model") == servo_site.kind.model
        assert link.read(servo, "firmware") >= OLDEST_FIRMWARE
        assert link.read(servo, "id") == servo


def test_the_configuration_is_in_the_registers(link: ServoLink, servo_site: ServoSite) -> None:
    wanted = set_up_of(servo_site.kind)
    for servo in servo_site.settings.ids:
        assert {name: link.read(servo, name) for name in wanted} == wanted, f"servo {servo}"
        assert link.read(servo, "bus_watchdog") in (
            registers.WATCHDOG,
            registers.WATCHDOG_TRIPPED,
        )  # a pause of this computer trips it


def test_the_block_of_the_cycle_matches_the_registers(link: ServoLink, servo_site: ServoSite) -> None:
    for servo in servo_site.settings.ids:
        data = link.read_bytes(servo, registers.READ_ADDRESS, registers.READ_LENGTH)
        for name in registers.READ_BLOCK:
            size = REGISTERS[name].size
            in_block, data = REGISTERS[name].from_bytes(data[:size]), data[size:]
            difference = abs(in_block - link.read(servo, name))
            assert difference <= JITTER.get(name, 0), f"servo {servo}: {name} differs by {difference}"


def test_goals_written_to_the_block_of_the_cycle_reach_their_registers(link: ServoLink, servo_site: ServoSite) -> None:
    goals = {servo: (10 + servo, link.read(servo, "present_position") + servo) for servo in servo_site.settings.ids}
    for servo in goals:
        restart_watchdog(link, servo)  # a tripped one would lock them
    current, position = REGISTERS["goal_current"], REGISTERS["goal_position"]
    for servo, (amount, ticks) in goals.items():
        link.write_bytes(servo, registers.WRITE_ADDRESS, current.to_bytes(amount) + position.to_bytes(ticks))
    found = {servo: (link.read(servo, "goal_current"), link.read(servo, "goal_position")) for servo in goals}
    assert found == goals


def test_cycles_follow_each_other_without_a_missed_reply(bus: ServoBus, servo_site: ServoSite) -> None:
    where = wait_until(lambda: (s := bus.read()).complete and s, "the first snapshot").angle

    before = replace(bus.counters)
    snapshots, took = [], []
    for _ in range(CYCLES):
        begin = time.monotonic()
        snapshots.append(bus.exchange(where, (0.0, 0.0, 0.0)))
        took.append(time.monotonic() - begin)
        assert begin < snapshots[-1].time <= time.monotonic()
    assert all(snapshot.complete for snapshot in snapshots), f"{bus.counters}"
    assert bus.counters == before
    times = [snapshot.time for snapshot in snapshots]
    assert times == sorted(set(times))
    for snapshot in snapshots:
        check_values(snapshot, servo_site)
    median = statistics.median(took)
    assert not servo_site.real or median < 1.0 / RATE, (
        f"a cycle takes {median * 1e3:.1f} ms, more than {RATE:g} Hz allow; look at the adapter's latency timer"
    )


def check_values(snapshot: ServoReport, site: ServoSite) -> None:
    """Fail if a value is impossible for a servo at rest at 12 V."""
    kind = site.kind
    for index, servo in enumerate(site.settings.ids):
        about = f"servo {servo}: {snapshot}"
        assert -math.pi <= snapshot.angle[index] <= math.pi, about
        assert abs(snapshot.velocity[index]) <= REGISTERS["velocity_limit"].high * kind.velocity_unit, about
        assert abs(snapshot.current[index]) <= JITTER["present_current"] * kind.current_unit, about
        low, high = kind.voltage_min * kind.voltage_unit, kind.voltage_max * kind.voltage_unit
        assert low <= snapshot.voltage[index] <= high, about
        assert 0.0 <= snapshot.temperature[index] < kind.temperature_limit, about
        assert snapshot.hardware_error[index] == 0, about
        assert snapshot.torque_enabled[index] is False, about


def test_forbidden_accesses_are_refused_by_name(link: ServoLink, servo_site: ServoSite) -> None:
    for servo in servo_site.settings.ids:
        with pytest.raises(errors.ServoFault, match=f"servo {servo}.*700"):
            link.read_bytes(servo, 700, 2)  # the last register is 661
        restart_watchdog(link, servo)
        for name in ("present_position", "model", "goal_current"):
            before = link.read(servo, name)
            value = link.read(servo, "current_limit") + 1 if name == "goal_current" else before
            with pytest.raises(errors.ServoFault, match=f"servo {servo}.*{name}"):
                link.write(servo, name, value)
            assert abs(link.read(servo, name) - before) <= JITTER.get(name, 0)


@pytest.mark.parametrize("index", [0, rest(1), rest(2)])
def test_a_restart_loses_the_configuration_but_keeps_eeprom(link: ServoLink, servo_site: ServoSite, index: int) -> None:
    settings = servo_site.settings
    servo = settings.ids[index]
    link.reboot(servo)

    def back() -> bool:
        try:
            return link.ping(servo) == servo_site.kind.model
        except errors.DriverError:
            return False

    wait_until(back, f"servo {servo} to come back from its restart")
    assert has_restarted(link.read_bytes(servo, registers.READ_ADDRESS, registers.READ_LENGTH))
    assert (link.read(servo, "torque_enable"), link.read(servo, "bus_watchdog")) == (0, 0)
    assert link.read(servo, "operating_mode") == registers.MODE_CURRENT_POSITION
    assert link.read(servo, "position_p_gain") == servo_site.kind.position_p_gain
    assert not configure(link, servo, settings.drive(servo_site.kind))
    wanted = set_up_of(servo_site.kind)
    assert {name: link.read(servo, name) for name in wanted} == wanted


def test_a_restart_in_the_cycle_is_detected_and_repaired(bus: ServoBus) -> None:
    bus.read()
    bus.reboot(1)
    noticed = wait_until(lambda: (s := bus.read()).rebooted[1] and s, "the restart to be detected")
    assert not noticed.valid[1]
    assert math.isnan(noticed.angle[1])
    assert noticed.rebooted == (False, True, False)
    bus.configure(1)
    after = wait_until(lambda: (s := bus.read()).complete and s, "all servos to answer again")
    assert after.rebooted == after.torque_enabled == (False, False, False)
