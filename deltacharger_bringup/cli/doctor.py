# SPDX-License-Identifier: Apache-2.0
"""`deltacharger doctor`: find problems of this charger and this computer, and print the remedies.

It starts without ROS, driver libraries or a valid scene: each check reports what is missing.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from deltacharger_bringup.cli import arguments, output
from deltacharger_bringup.doctor.environment import (
    RosProbe,
    candidates,
    examine_camera,
    examine_port,
    examine_settings,
    examine_versions,
    same_device,
)
from deltacharger_bringup.doctor.findings import Finding, checked, hint, install, ok, wrong
from deltacharger_core import environment
from deltacharger_core.machine import BAUD_RATE, BEHIND_BOARD, SERVO_IDS

if TYPE_CHECKING:
    from deltacharger_bringup.scenes.scene import Scene


def add_doctor(parser: argparse.ArgumentParser) -> None:
    """Add the options of `doctor`."""
    add = parser.add_argument
    arguments.scene_option(parser)
    add("--servo-port", metavar="PORT", help=f"port of the servos, instead of the scene's, or {BEHIND_BOARD}")
    add("--board-port", metavar="PORT", help="port of the board, instead of the scene's")
    text = "clear a latched weld (fault 7), only after the contactor was replaced; refused while something is live"
    add("--clear-weld", action="store_true", help=text)


@dataclass
class _Hardware:
    """Hardware to examine, from the scene or the command line; an empty port is not examined."""

    scene: str = ""
    simulated: Scene | None = None
    servo_port: str = ""
    board_port: str = ""
    servo_speed: int = BAUD_RATE
    ids: tuple[int, ...] = SERVO_IDS
    wired: bool = False  # the electrodes are wired to the battery
    current_max: float | None = None
    clear_weld: bool = False
    problems: list[Finding] = field(default_factory=list)


def doctor(options: argparse.Namespace) -> output.Result:
    """Examine everything; print the findings."""
    hardware = _hardware(options)
    hardware.clear_weld = options.clear_weld
    environment.prepare()
    if hardware.simulated is not None:
        environment.isolate()
    found: list[Finding] = list(hardware.problems)
    probe = RosProbe()
    try:
        output.log_line("checking this computer and ROS ...")
        found += checked("versions", examine_versions)
        found += checked("ros settings", examine_settings)
        with contextlib.ExitStack() as stack:
            found += _start_emulators(hardware, stack)
            found += _examine_ports(hardware)
        found += checked("rclpy", probe.examine)
        found += checked("camera", lambda: examine_camera(probe.images))
    finally:
        probe.close()
    return _report(found, hardware)


def _hardware(options: argparse.Namespace) -> _Hardware:
    """Return what to examine; only the ports of the command line if no scene is given.

    Raises:
        CommandError: the scene is refused, or it is simulated and ports are given; exit code 2.
    """
    given = bool(options.servo_port or options.board_port)
    hardware = _Hardware(servo_port=options.servo_port or "", board_port=options.board_port or "")
    if given and options.scene is None:
        return hardware
    try:
        from deltacharger_bringup.cli.scene import load_for_command

        scene = load_for_command(options.scene or arguments.DEFAULT_SCENE)
    except ImportError as error:
        hardware.problems.append(wrong("scene", f"cannot be read: {error}", install(error.name or "")))
        return hardware
    hardware.scene = scene.name
    hardware.wired = scene.node_parameters("docking_node", {}).get("power") == "none"
    if scene.simulation is not None:
        if given:
            raise output.WrongInput(f"scene '{scene.name}' has its own ports; leave out --servo-port and --board-port")
        hardware.simulated = scene
        return hardware
    environment.reach(scene.network)  # as in the command that starts it
    if "servo_node" in scene.nodes:
        values = scene.node_parameters("servo_node", {})
        hardware.servo_port = hardware.servo_port or str(values.get("port", ""))
        hardware.servo_speed = int(values.get("baud_rate", BAUD_RATE))
        hardware.ids = tuple(values.get("ids", hardware.ids))
        hardware.current_max = values.get("current_max")
    if "tactile_node" in scene.nodes:
        values = scene.node_parameters("tactile_node", {})
        hardware.board_port = hardware.board_port or str(values.get("port", ""))
    return hardware


def _start_emulators(hardware: _Hardware, stack: contextlib.ExitStack) -> list[Finding]:
    """Run the emulators of a simulated scene until `stack` closes, and set `hardware` to their ports."""
    scene = hardware.simulated
    if scene is None or scene.simulation is None:
        return []
    simulation = scene.simulation

    def start() -> Iterator[Finding]:
        from deltacharger_sim.charger.simulated_charger import SimulatedCharger

        charger = stack.enter_context(SimulatedCharger(simulation))
        hardware.servo_port, hardware.board_port = charger.servo_port, charger.board_port
        ports = ", ".join(candidates()) or "none"
        remedy = f"for a real charger: --scene bench, or --servo-port and --board-port; ports of this machine: {ports}"
        yield hint("scene", f"'{scene.name}' is simulated: the ports, servos and board below are emulators", remedy)

    return checked("scene", start)


def _examine_ports(hardware: _Hardware) -> list[Finding]:
    """Return the findings for both ports."""
    servo, board = hardware.servo_port, hardware.board_port
    if servo and board and same_device(servo, board):
        return [wrong("ports", f"{servo} and {board} are one device", "give two different ports")]
    found = _examine_servos(hardware) if servo else []

    def check() -> Iterator[Finding]:
        from deltacharger_bringup.doctor.board import examine_board

        return examine_board(board, wired=hardware.wired, clear_weld=hardware.clear_weld)

    return found + (_examine("board", board, check) if board else [])


def _examine_servos(hardware: _Hardware) -> list[Finding]:
    """Return the findings for the servos and their port, also for servos connected to the board."""
    port, board = hardware.servo_port, hardware.board_port

    def look(port: str) -> Iterator[Finding]:
        from deltacharger_bringup.doctor.servos import examine_servos

        return examine_servos(port, hardware.servo_speed, hardware.ids, hardware.current_max)

    def behind() -> Iterator[Finding]:
        from deltacharger_driver.board.keeper import servos_behind

        with servos_behind(board) as path:
            yield ok("servo port", f"the servos are on the board at {board}")
            yield from look(path)

    if port != BEHIND_BOARD:
        return _examine("servos", port, lambda: look(port))
    if not board:
        return [wrong("servo port", "the servos are on the board, and its port is not given", "give --board-port")]
    output.log_line(f"checking the servos behind the board on {board} ...")
    return checked("servo port", behind)


def _examine(device: str, path: str, check: Callable[[], Iterable[Finding]]) -> list[Finding]:
    """Return the findings for a port and, if it opens, for its device."""
    part = f"{device.removesuffix('s')} port"
    found = checked(part, lambda: examine_port(part, path))
    if not any(finding.level == "wrong" for finding in found):
        output.log_line(f"checking the {device} on {path} ...")
        found += checked(device, check)
    return found


def _report(found: list[Finding], hardware: _Hardware) -> output.Result:
    counts = {level: sum(finding.level == level for finding in found) for level in ("ok", "hint", "wrong")}
    width = max((len(finding.part) for finding in found), default=0)
    lines = []
    for finding in found:
        lines.append(f"{finding.level:<5}  {finding.part:<{width}}  {finding.message}")
        if finding.remedy:
            lines.append(f"{'':<7}{'':<{width}}  -> {finding.remedy}")
    lines.append(f"\n{counts['wrong']} wrong, {counts['hint']} hints, {counts['ok']} ok")
    details = {
        "scene": hardware.scene or None,
        "servo_port": hardware.servo_port or None,
        "board_port": hardware.board_port or None,
        "counts": counts,
        "findings": [asdict(finding) for finding in found],
    }
    return output.Result("\n".join(lines), details, output.FAILED if counts["wrong"] else output.DONE)
