"""`deltacharger doctor` on emulated hardware behind real pseudo-terminals, healthy and broken in every way it names."""

from __future__ import annotations

import errno
import grp
import json
import os
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from deltacharger_bringup.cli import main
from deltacharger_bringup.doctor.board import examine_board
from deltacharger_bringup.doctor.camera import examine_camera
from deltacharger_bringup.doctor.environment import RosProbe, examine_settings
from deltacharger_bringup.doctor.findings import Finding, checked, ok
from deltacharger_bringup.doctor.ports import examine_port, holders
from deltacharger_bringup.doctor.servos import examine_servos
from deltacharger_bringup.doctor.set_baud import set_baud
from deltacharger_driver.bench_arm import BenchArm
from deltacharger_driver.bench_plant import BenchPlant
from deltacharger_driver.board_emulator import BoardEmulator
from deltacharger_driver.board_link import BoardLink
from deltacharger_driver.board_protocol import Fault
from deltacharger_driver.mx64 import REGISTERS, WATCHDOG_TRIPPED
from deltacharger_driver.pseudo_terminal import PseudoTerminal
from deltacharger_driver.serial_open import open_serial
from deltacharger_driver.servo_emulator import ServoBusEmulator, terminal_speed

from .conftest import new_namespace

IDS = (1, 2, 3)


class Silence:
    """A cable with nothing behind it."""

    def receive(self, data: bytes, now: float) -> bytes:
        return b""

    def poll(self, now: float) -> bytes:
        return b""

    def next_event(self, now: float) -> float:
        return 1.0


@pytest.fixture
def servos() -> ServoBusEmulator:
    return ServoBusEmulator(BenchArm())


@pytest.fixture
def servo_port(servos: ServoBusEmulator) -> Iterator[str]:
    with PseudoTerminal(servos) as terminal:
        servos.line_speed = lambda: terminal_speed(terminal.path)
        yield terminal.path


@pytest.fixture
def board() -> BoardEmulator:
    return BoardEmulator(BenchPlant())


@pytest.fixture
def board_port(board: BoardEmulator) -> Iterator[str]:
    with PseudoTerminal(board) as terminal:
        yield terminal.path


@pytest.fixture
def silent_port() -> Iterator[str]:
    with PseudoTerminal(Silence()) as terminal:
        yield terminal.path


def servo_findings(port: str) -> list[Finding]:
    return list(examine_servos(port, 1_000_000, IDS, 3.0))


def board_findings(port: str) -> list[Finding]:
    return list(examine_board(port, 1_000_000))


def only(findings: Iterable[Finding], level: str) -> list[Finding]:
    return [finding for finding in findings if finding.level == level]


def one(findings: Iterable[Finding], level: str, part: str) -> Finding:
    matching = [finding for finding in findings if (finding.level, finding.part) == (level, part)]
    assert len(matching) == 1, list(findings)
    return matching[0]


def registers(servos: ServoBusEmulator) -> dict[tuple[int, str], int]:
    """Everything that a host could have written, of each servo."""
    return {
        (servo, name): servos.servo(servo).table.get(name)
        for servo in IDS
        for name, register in REGISTERS.items()
        if register.writable
    }


# Servos


def test_healthy_servos_are_ok_and_nothing_is_written(servos: ServoBusEmulator, servo_port: str) -> None:
    before = registers(servos)
    found = servo_findings(servo_port)
    assert {finding.level for finding in found} == {"ok"}
    assert {finding.part for finding in found} == {"servo 1", "servo 2", "servo 3", "servo line"}
    assert registers(servos) == before


def test_a_servo_as_from_the_factory_is_named_with_the_command_that_mends_it(
    servos: ServoBusEmulator, servo_port: str
) -> None:
    servos.set_speed(2, 1)
    finding = one(servo_findings(servo_port), "wrong", "servo 2")
    assert "57600" in finding.message
    assert f"doctor --servo-port {servo_port} --set-baud 1000000 --ids 2" in finding.remedy


def test_missing_old_and_strange_servos_are_told_apart(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.use_protocol_1(1)
    servos.servo(3).table.set("id", 9)
    found = servo_findings(servo_port)
    assert "firmware" in one(found, "wrong", "servo 1").remedy
    assert "does not answer at any speed" in one(found, "wrong", "servo 3").message
    assert "id 9" in one(found, "hint", "servos").message
    assert only([f for f in found if f.part == "servo 2"], "wrong") == []


def test_two_servos_with_one_id_are_named() -> None:
    twins = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with PseudoTerminal(twins) as terminal:
        found = list(examine_servos(terminal.path, 1_000_000, IDS, 3.0))
    assert "two servos have this id" in one(found, "wrong", "servo 2").message


def test_what_a_servo_suffers_from_is_told(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.raise_hardware_error(1, 1 << 5)
    servos.servo(2).table.set("torque_enable", 1)
    servos.servo(1).table.set("bus_watchdog", WATCHDOG_TRIPPED)
    servos.servo(3).table.set("current_limit", 298)
    found = servo_findings(servo_port)
    assert "overload" in one(found, "wrong", "servo 1").message
    assert "watchdog has tripped" in one(found, "hint", "servo 1").message
    assert "torque is on" in one(found, "hint", "servo 2").message
    finding = one(found, "wrong", "servo 3")
    assert "current limit is 298" in finding.message
    assert "1941" in finding.remedy


def test_a_bad_line_is_told_from_a_good_one(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.faults.rate["drop"] = 0.15
    finding = one(servo_findings(servo_port), "wrong", "servo line")
    assert "silent" in finding.message
    assert "plugs" in finding.remedy


@pytest.mark.parametrize(
    ("fixture", "words"), [("board_port", "here is the board"), ("silent_port", "no servo answers")]
)
def test_where_the_servos_are_not(request: pytest.FixtureRequest, fixture: str, words: str) -> None:
    found = servo_findings(request.getfixturevalue(fixture))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message


# Board


def test_a_healthy_board_is_ok_and_left_as_it_was(board: BoardEmulator, board_port: str) -> None:
    found = board_findings(board_port)
    assert not only(found, "wrong")
    assert "0 of" in one(found, "ok", "tactile link").message
    assert {f.part for f in found} == {"board", "tactile link", "left pad", "right pad", "tare", "power", "probe"}
    assert not board.contactor_commanded
    assert "not done" in one(found, "ok", "tare").message


def test_dead_taxels_are_named_and_too_many_are_wrong(board: BoardEmulator, board_port: str) -> None:
    board.set_dead(0, 3, 7)
    for column in range(4):
        board.set_dead(1, 0, column)
    found = board_findings(board_port)
    assert "row 3 column 7" in one(found, "hint", "left pad").message
    assert "4 of 100" in one(found, "wrong", "right pad").message


def test_lost_frames_are_counted(board: BoardEmulator, board_port: str) -> None:
    board.faults.probability["drop"] = 0.1
    finding = one(board_findings(board_port), "wrong", "tactile link")
    assert " 0 of" not in finding.message
    assert "cables" in finding.remedy


def test_a_slow_board_is_hinted_at(board: BoardEmulator, board_port: str) -> None:
    board.faults.delay = 0.04
    assert "heartbeats" in one(board_findings(board_port), "hint", "board").message


def test_a_latched_fault_is_wrong(board: BoardEmulator, board_port: str) -> None:
    with BoardLink(board_port):  # it has booted, which would clear the fault
        board.trip(Fault.OVER_CURRENT)
    found = board_findings(board_port)
    assert "over current" in one(found, "wrong", "power").message


@pytest.mark.parametrize(
    ("resistance", "level", "words"), [(0.2, "wrong", "short circuit"), (25.0, "hint", "a target is connected")]
)
def test_the_probe_is_judged(resistance: float, level: str, words: str) -> None:
    plant = BenchPlant()
    plant.resistance = resistance
    with PseudoTerminal(BoardEmulator(plant)) as terminal:
        assert words in one(board_findings(terminal.path), level, "probe").message


@pytest.mark.parametrize(
    ("fixture", "words"), [("servo_port", "here are the servos"), ("silent_port", "no answer to HELLO")]
)
def test_where_the_board_is_not(request: pytest.FixtureRequest, fixture: str, words: str) -> None:
    found = board_findings(request.getfixturevalue(fixture))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message


# Ports


def test_a_busy_port_names_who_has_it(board_port: str) -> None:
    script = "import sys, serial; port = serial.Serial(sys.argv[1], exclusive=True); print('open', flush=True); input()"
    with subprocess.Popen(
        [sys.executable, "-c", script, board_port], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "open\n"
        found = list(examine_port("board port", board_port))
        named = holders(board_port)
        holder.communicate("\n")
    assert [finding.level for finding in found] == ["wrong"]
    assert f"process {holder.pid}" in found[0].message
    assert len(named) == 1  # the emulator's own end of the terminal holds nothing


def test_whoever_opened_a_port_without_a_lock_is_named_too(silent_port: str) -> None:
    with open(silent_port, "rb"):
        assert any(f"process {os.getpid()}" in name for name in holders(silent_port))


@pytest.mark.parametrize(
    ("path", "words"),
    [("/dev/does-not-exist", "no such port"), ("/dev", "a directory"), ("/dev/null", "no serial port")],
)
def test_what_is_no_port_is_wrong_with_a_remedy(path: str, words: str) -> None:
    found = list(examine_port("servo port", path))
    assert [finding.level for finding in found] == ["wrong"]
    assert words in found[0].message
    assert found[0].remedy


def test_a_forbidden_port_names_the_group(monkeypatch: pytest.MonkeyPatch, silent_port: str) -> None:
    def refuse(*arguments: object, **options: object) -> None:
        raise serial.SerialException(errno.EACCES, "Permission denied")

    monkeypatch.setattr(serial, "Serial", refuse)
    found = list(examine_port("servo port", silent_port))
    assert [finding.level for finding in found] == ["wrong"]
    assert "permission denied" in found[0].message
    assert f"usermod -aG {grp.getgrgid(os.stat(silent_port).st_gid).gr_name}" in found[0].remedy


def test_an_adapter_that_holds_bytes_back_is_hinted_at(monkeypatch: pytest.MonkeyPatch, silent_port: str) -> None:
    monkeypatch.setattr("deltacharger_driver.servo_port.latency_timer", lambda port: 16e-3)
    finding = one(examine_port("servo port", silent_port), "hint", "servo port")
    assert "16 ms" in finding.message
    assert "99-deltacharger.rules" in finding.remedy


def test_a_free_port_opens_and_is_free_afterwards(silent_port: str) -> None:
    assert [finding.level for finding in examine_port("servo port", silent_port)] == ["ok"]
    open_serial(silent_port, 1_000_000).close()


# Speed


def test_set_baud_writes_the_speed_and_torque_off_and_nothing_else(servos: ServoBusEmulator, servo_port: str) -> None:
    for servo in (1, 3):
        servos.set_speed(servo, 1)
    servos.servo(1).table.set("torque_enable", 1)
    before = registers(servos)
    found = list(set_baud(servo_port, 1_000_000, None))
    assert [finding.level for finding in found] == ["ok", "ok", "ok"]
    assert "from 57600 to 1000000" in found[0].message
    assert "already" in found[1].message
    changed = {key for key, value in registers(servos).items() if before[key] != value}
    assert changed == {(1, "baud"), (3, "baud"), (1, "torque_enable")}
    assert only(servo_findings(servo_port), "wrong") == []


def test_set_baud_leaves_those_that_were_not_named(servos: ServoBusEmulator, servo_port: str) -> None:
    for servo in IDS:
        servos.set_speed(servo, 2)
    found = list(set_baud(servo_port, 57600, [2, 2, 7]))
    assert [(finding.part, finding.level) for finding in found] == [("servo 2", "ok"), ("servo 7", "wrong")]
    assert [servos.servo(servo).table.get("baud") for servo in IDS] == [2, 1, 2]


def test_set_baud_refuses_what_it_cannot_tell_apart_or_does_not_know(servos: ServoBusEmulator, servo_port: str) -> None:
    servos.use_protocol_1(3)
    before = registers(servos)
    assert "nothing was written" in next(iter(set_baud(servo_port, 57600, [3]))).message
    assert registers(servos) == before
    twins = ServoBusEmulator(BenchArm(), ids=(1, 2, 2))
    with PseudoTerminal(twins) as terminal:
        found = list(set_baud(terminal.path, 57600, [2]))
    assert "two servos have this id" in found[0].message


def test_set_baud_on_the_board_writes_nothing(board_port: str) -> None:
    found = list(set_baud(board_port, 57600, None))
    assert [finding.level for finding in found] == ["wrong"]
    assert "here is the board" in found[0].message


# Computer


def test_a_check_that_breaks_off_is_a_finding_and_keeps_those_before_it() -> None:
    def broken() -> Iterator[Finding]:
        yield ok("first", "fine")
        raise ZeroDivisionError("nothing to divide")

    def lacking() -> Iterator[Finding]:
        yield ok("first", "fine")
        import a_module_that_nobody_has  # noqa: F401

    found = checked("second", broken)
    assert [finding.level for finding in found] == ["ok", "wrong"]
    assert "nothing to divide" in found[1].message
    found = checked("second", lacking)
    assert [finding.level for finding in found] == ["ok", "wrong"]
    assert "a_module_that_nobody_has" in found[1].remedy


@pytest.mark.parametrize(
    ("name", "value", "part"),
    [
        ("ROS_DOMAIN_ID", "500", "ros domain"),
        ("ROS_DOMAIN_ID", "home", "ros domain"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF", "ros discovery"),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "HERE", "ros discovery"),
        ("AMENT_PREFIX_PATH", "/usr", "ros prefix"),
        ("AMENT_PREFIX_PATH", "", "ros prefix"),
    ],
)
def test_settings_that_keep_ros_from_working(monkeypatch: pytest.MonkeyPatch, name: str, value: str, part: str) -> None:
    assert only(examine_settings(), "wrong") == []
    monkeypatch.setenv(name, value)
    assert one(examine_settings(), "wrong", part).remedy


def test_a_camera_is_never_wrong_and_what_is_absent_is_said(tmp_path: Path) -> None:
    absent = list(examine_camera(None, tmp_path))
    assert not only(absent, "wrong")
    assert any("no OAK camera is on USB" in finding.message for finding in absent)
    (tmp_path / "2-1").mkdir()
    (tmp_path / "2-1" / "idVendor").write_text("03e7\n")
    present = list(examine_camera(2, tmp_path))
    assert any("an OAK camera is on USB" in finding.message for finding in only(present, "ok"))
    assert any("2 publishers" in finding.message for finding in only(present, "ok"))


def test_a_charger_that_runs_is_named(context: Any) -> None:
    from deltacharger.msg import DockingState
    from rclpy.node import Node

    node = Node("docking_node", context=context, namespace=new_namespace())
    node.create_publisher(DockingState, "docking_state", 1)
    probe = RosProbe()
    try:
        found = list(probe.examine())
    finally:
        probe.close()
        namespace = node.get_namespace()
        node.destroy_node()
    assert not only(found, "wrong")
    assert namespace in one(found, "hint", "charger").message
    assert {finding.part for finding in found} >= {"rclpy", "interfaces", "numpy and ROS", "ros middleware"}


# The command


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    try:
        code = main(["doctor", *words, "--json"])
    except SystemExit as end:  # argparse ends the process itself
        code = int(end.code or 0)
    value = json.loads(capsys.readouterr().out)
    assert isinstance(value, dict)
    return code, value


def by_level(value: dict[str, Any], level: str) -> dict[str, str]:
    return {finding["part"]: finding["message"] for finding in value["findings"] if finding["level"] == level}


def test_nothing_is_wrong_with_the_simulated_scene(capsys: pytest.CaptureFixture[str]) -> None:
    code, value = run(capsys, "--scene", "simulated")
    assert by_level(value, "wrong") == {}
    assert (code, value["success"], value["scene"]) == (0, True, "simulated")
    assert set(by_level(value, "ok")) >= {"servo 1", "servo 2", "servo 3", "board", "tactile link", "power", "probe"}


def test_with_nothing_plugged_in_both_ports_are_wrong(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    scene = tmp_path / "robot.yaml"
    scene.write_text(f"ports: {{servo: {tmp_path}/ttyUSB0, board: {tmp_path}/ttyACM0}}\n")
    code, value = run(capsys, "--scene", str(scene))
    assert code == 1
    assert set(by_level(value, "wrong")) == {"servo port", "board port"}
    assert all(finding["remedy"] for finding in value["findings"] if finding["level"] != "ok")
    assert value["success"] is False


def test_people_read_levels_and_remedies_and_progress_goes_to_stderr(
    capsys: pytest.CaptureFixture[str], servo_port: str
) -> None:
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", servo_port]) == 0
    captured = capsys.readouterr()
    assert "ok     servo 2" in captured.out
    assert captured.out.rstrip().endswith("0 wrong, 0 worth a look, 4 as they should be")
    assert "looking for servos" in captured.err
    assert main(["doctor", "--set-baud", "1000000", "--servo-port", "/dev/nothing"]) == 1
    assert "-> plug" in capsys.readouterr().out


def test_a_scene_decides_speed_and_ids_and_the_command_line_the_ports(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, servos: ServoBusEmulator, servo_port: str, board_port: str
) -> None:
    for servo in IDS:
        servos.set_speed(servo, 4)
    scene = tmp_path / "robot.yaml"
    scene.write_text(
        f"ports: {{servo: /dev/nothing, board: {board_port}}}\nparameters: {{servo_node: {{baud_rate: 2000000}}}}\n"
    )
    code, value = run(capsys, "--scene", str(scene), "--servo-port", servo_port)
    assert (code, by_level(value, "wrong")) == (0, {})
    assert value["servo_port"] == servo_port
    assert "2000000" in next(f["message"] for f in value["findings"] if f["part"] == "servo 1")


def test_one_device_cannot_be_both(capsys: pytest.CaptureFixture[str], servo_port: str) -> None:
    code, value = run(capsys, "--servo-port", servo_port, "--board-port", servo_port)
    assert code == 1
    assert "are one device" in by_level(value, "wrong")["ports"]


def test_set_baud_from_the_command_line(
    capsys: pytest.CaptureFixture[str], servos: ServoBusEmulator, servo_port: str
) -> None:
    servos.set_speed(2, 1)
    code, value = run(capsys, "--set-baud", "1000000", "--servo-port", servo_port, "--ids", "1", "2", "3")
    assert (code, value["counts"]["wrong"]) == (0, 0)
    assert servos.servo(2).table.get("baud") == 3
    code, value = run(capsys, "--set-baud", "1000000", "--servo-port", "/dev/nothing")
    assert (code, list(by_level(value, "wrong"))) == (1, ["servo port"])


@pytest.mark.parametrize(
    "words",
    [
        ("--set-baud", "1000000"),
        ("--set-baud", "12345", "--servo-port", "/dev/null"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--ids", "300"),
        ("--set-baud", "57600", "--servo-port", "/dev/null", "--scene", "bench"),
        ("--ids", "1"),
        ("--scene", "nowhere"),
        ("--scene", "simulated", "--servo-port", "/dev/null"),
        ("--port", "/dev/null"),
    ],
)
def test_wrong_usage_is_2_with_one_object(capsys: pytest.CaptureFixture[str], words: tuple[str, ...]) -> None:
    code, value = run(capsys, *words)
    assert (code, value["success"]) == (2, False)
    assert value["error"]


@pytest.mark.parametrize(
    ("name", "value", "part", "remedy"),
    [
        ("RMW_IMPLEMENTATION", "rmw_that_nobody_has", "ros middleware", "unset RMW_IMPLEMENTATION"),
        ("AMENT_PREFIX_PATH", "/usr", "ros prefix", "setup.bash"),
        ("ROS_DOMAIN_ID", "500", "ros domain", "0 to 232"),
    ],
)
def test_ros_set_up_wrongly_is_one_thing_wrong(
    monkeypatch: pytest.MonkeyPatch, name: str, value: str, part: str, remedy: str
) -> None:
    monkeypatch.setenv(name, value)
    probe = RosProbe()
    try:
        found = [*examine_settings(), *probe.examine()]
    finally:
        probe.close()
    wrong = only(found, "wrong")
    assert [finding.part for finding in wrong] == [part]
    assert remedy in wrong[0].remedy


@pytest.mark.parametrize(
    ("module", "body", "part", "remedy"),
    [
        ("rclpy", "raise ImportError(\"No module named 'rclpy'\", name='rclpy')", "rclpy", "ros-rclpy"),
        ("rclpy", "import os; os._exit(11)", "rclpy", "one ROS installation"),
        ("dynamixel_sdk", "raise ImportError('no SDK', name='dynamixel_sdk')", "dynamixel-sdk", "dynamixel-sdk"),
        ("serial", "raise ImportError('no serial', name='serial')", "pyserial", "pyserial"),
        ("yaml", "raise ImportError('no yaml', name='yaml')", "PyYAML", "pyyaml"),
    ],
)
def test_it_works_without_what_it_looks_for(
    tmp_path: Path, deltacharger: tuple[str, ...], module: str, body: str, part: str, remedy: str
) -> None:
    (tmp_path / f"{module}.py").write_text(body)
    variables = {**os.environ, "PYTHONPATH": str(tmp_path)}
    ended = subprocess.run(
        [*deltacharger, "doctor", "--scene", "simulated", "--json"], env=variables, capture_output=True, text=True
    )
    value = json.loads(ended.stdout)
    assert ended.returncode == 1, ended.stderr
    assert "Traceback" not in ended.stderr
    wrong = [finding for finding in value["findings"] if finding["level"] == "wrong" and finding["part"] == part]
    assert len(wrong) == 1
    assert remedy in wrong[0]["remedy"]
    assert {"python", "ros domain"} <= set(by_level(value, "ok"))
